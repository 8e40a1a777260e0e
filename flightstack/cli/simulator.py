"""Commands of the simulator: ``world``, ``vehicle``, ``target``, ``px4-sim`` and ``scenarios``."""

from __future__ import annotations

import os
import shutil
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import click

from flightstack.cli.options import takes
from sim.options import Px4SimOptions, TargetOptions, VehicleOptions, WorldOptions


@click.command()
@takes(WorldOptions)
def world(options: WorldOptions) -> None:
    """Run the simulated vehicles and ground robots of a scenario, as `sitl` does.

    A client controls a vehicle over MAVLink; a robot drives the scenario's path and sends odometry on Zenoh.
    """
    _run_world(options)


@click.command()
@takes(VehicleOptions)
def vehicle(options: VehicleOptions) -> None:
    """Run the simulated Crazyflie as a MAVLink vehicle; its deck follows the target's true pose on Zenoh.

    With a scenario of several vehicles the command runs all of them, each with its own port and namespace, or
    with --member one of them.
    """
    _run_world(options)


def _run_world(options: VehicleOptions) -> None:
    from logs.schema.names import member_name
    from sim.runners import world_process
    from sim.scenarios.team import alone, load

    team = load(options.scenario)
    if options.member is not None:
        single, seed = team.one(options.seed, options.member)
        name = member_name(options.member)
        team, options = alone(single), replace(options, seed=seed, namespace=name, system_id=options.member)
    sys.exit(world_process.world_main(team, options))


@click.command()
@takes(TargetOptions)
def target(options: TargetOptions) -> None:
    """Run the simulated ground robot: it drives the scenario's path and publishes its odometry on Zenoh.

    With a scenario of several vehicles the command runs the robots of all.
    """
    from flightstack.compiled.jit import OFF

    # The robot computes only a hundred short steps a second: loading numba would take longer than it saves.
    if "numba" not in sys.modules:
        os.environ.setdefault(OFF, "1")
    from sim.runners.published_robot import target_main
    from sim.scenarios.team import load

    sys.exit(target_main(load(options.scenario), options))


@click.command("px4-sim")
@takes(Px4SimOptions)
def px4_sim(options: Px4SimOptions) -> None:
    """Simulate body, rotors, wind and moving deck for PX4, which runs as the autopilot (SITL).

    PX4 connects over TCP, and both run in lockstep. Exit status: 0 normal end, 1 PX4 no longer replies, 2
    wrong input.
    """
    from logs.schema.names import member_name
    from sim.plant import params
    from sim.px4 import process
    from sim.px4.airframe import parameter_text
    from sim.scenarios.team import load

    loaded, seed = load(options.scenario).one(options.seed, options.member)
    if options.form is not None:
        poses = loaded.vehicle.mocap if options.mocap else None
        click.echo(parameter_text(params.load(loaded.vehicle.airframe), options.form, poses))
        return
    namespace = options.namespace if options.member is None else member_name(options.member)
    sys.exit(process.px4_sim_main(loaded, replace(options, seed=seed, namespace=namespace)))


@click.command()
@click.argument("what", type=click.Choice(["scenario"]))
@click.argument("name")
@click.option("--base", default="lab", show_default=True, help="Name of the scenario from which it starts.")
def new(what: str, name: str, base: str) -> None:
    """Write NAME.toml to this folder: a scenario based on another one, with a comment for each key.

    Exit status: 0 written, 2 wrong name, or the file exists.
    """
    del what
    from flightstack.common.strict_toml import ConfigError
    from sim.scenarios.keys import commented

    file, text = Path(f"{name}.toml"), commented(name, base)
    try:
        with file.open("x", encoding="utf-8") as out:
            out.write(text)
    except FileExistsError:
        raise ConfigError(f"{file}: exists and is not overwritten; choose another name") from None
    except OSError as error:
        file.unlink(missing_ok=True)
        raise ConfigError(f"{file}: cannot be written: {error.strerror}") from None
    click.echo(f"{file}: fly it with `flightstack sitl --scenario {file} --lockstep`")


@click.command()
@click.argument("name", required=False)
def scenarios(name: str | None) -> None:
    """List the scenarios of the simulator, or print the one with the given NAME.

    Scenarios of several vehicles are listed last.
    """
    from flightstack.common.strict_toml import decoded
    from sim.scenarios import scenario, team

    if name is not None:
        click.echo(decoded(team.path_of(name).read_bytes()), nl=False)
        return
    listed = {known: scenario.load(known).description for known in scenario.names()}
    listed |= {known: team.load(known).description for known in team.names()}
    wide = max(map(len, listed)) + 2
    columns = max(shutil.get_terminal_size().columns, wide + 40)
    for known, description in listed.items():
        lines = textwrap.wrap(description, columns - wide)
        click.echo("\n".join([f"{known:{wide}}{lines[0]}", *(" " * wide + line for line in lines[1:])]))
