"""Commands that fly: ``sitl``, ``fly``, and the processes of a flight: ``onboard``, ``world``, ``target``."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NoReturn

import click

from flightstack.common.hangup import say
from flightstack.common.options import takes
from flightstack.config.options import OnboardOptions
from flightstack.launch.run_options import FlyOptions, RunOptions
from sim.options import Px4SimOptions, TargetOptions, VehicleOptions, WorldOptions

if TYPE_CHECKING:
    from flightstack.common.terminal import Terminal
    from flightstack.launch.result import Flown


@click.command()
@takes(RunOptions)
def sitl(options: RunOptions) -> None:
    """Fly a scenario in software: vehicle, target, onboard process and recorder, over MAVLink and Zenoh.

    In a scenario of several vehicles (`scenarios` lists them) each vehicle has its own onboard process.

    Exit status: 0 landed, 1 flown but not landed, 2 wrong input, or your own code failed in flight.
    """
    from flightstack.launch.sitl import run

    _concluded(run, options)


@click.command()
@takes(FlyOptions)
def fly(options: FlyOptions) -> None:
    r"""Fly a real vehicle onto a real target: check it, record, show the flight, land, write a report.

    Ctrl-C, or closing the terminal, aborts: the vehicle flies clear and lands. A second Ctrl-C requests a
    landing at its position and ends the onboard process. Ctrl-\ stops the motors.

    Exit status: 0 landed, 1 not landed, 2 wrong input, or your own code failed in flight.
    """
    from flightstack.launch.fly import run

    _concluded(run, options)


def _concluded(run: Callable[[Any, Terminal], Flown], options: RunOptions | FlyOptions) -> NoReturn:
    """Fly, judge the flight, print its result and exit with its status."""
    from flightstack.common.terminal import Terminal
    from flightstack.launch.result import conclude

    console = Terminal(stderr=options.as_json)
    flown = run(options, console)
    sys.exit(conclude(flown, console, as_json=options.as_json, with_report=options.with_report))


@click.command()
@takes(OnboardOptions)
def onboard(options: OnboardOptions) -> None:
    """Run the onboard process with any vehicle and target; `fly` adds a live view and a report.

    The log is in runs/ unless --recorder or --no-record is given. Ctrl-C, or closing the terminal, aborts:
    the vehicle flies clear and lands. A second Ctrl-C requests an immediate landing and ends the process.
    """
    from flightstack.common.processes import LaunchError
    from flightstack.config import load
    from flightstack.onboard import process

    try:
        ended = process.run(load(options.config_file), options, say)
    except LaunchError as error:
        raise LaunchError(f"{error}; --no-record flies without a log") from error
    say(f"{ended.phase.name}: {ended.reason}")
    sys.exit(ended.exit_code)


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
    from logs.schema import member_name
    from sim.runners import world_process
    from sim.scenarios.scenario import load

    team = load(options.scenario)
    if options.member is not None:
        single, seed = team.one(options.seed, options.member)
        name, team = member_name(options.member), single
        options = replace(options, seed=seed, namespace=name, system_id=options.member)
    sys.exit(world_process.world_main(team, options))


@click.command()
@takes(TargetOptions)
def target(options: TargetOptions) -> None:
    """Run the simulated ground robot: it drives the scenario's path and publishes its odometry on Zenoh.

    With a scenario of several vehicles the command runs the robots of all.
    """
    from flightstack.compiled.jit import OFF

    # The robot computes only 100 short steps per second: loading numba would take longer than it saves.
    if "numba" not in sys.modules:
        os.environ.setdefault(OFF, "1")
    from sim.runners.published_robot import target_main
    from sim.scenarios.scenario import load

    sys.exit(target_main(load(options.scenario), options))


@click.command("px4-sim")
@takes(Px4SimOptions)
def px4_sim(options: Px4SimOptions) -> None:
    """Simulate body, rotors, wind and moving deck for PX4, which runs as the autopilot (SITL).

    PX4 connects over TCP, and both run in lockstep. Exit status: 0 normal end, 1 PX4 no longer replies, 2
    wrong input.
    """
    from logs.schema import member_name
    from sim.plant import params
    from sim.px4 import process
    from sim.px4.airframe import parameter_text
    from sim.scenarios.scenario import load

    loaded, seed = load(options.scenario).one(options.seed, options.member)
    if options.form is not None:
        poses = loaded.vehicle.mocap if options.mocap else None
        click.echo(parameter_text(params.load(loaded.vehicle.airframe), options.form, poses))
        return
    namespace = options.namespace if options.member is None else member_name(options.member)
    sys.exit(process.px4_sim_main(loaded, replace(options, seed=seed, namespace=namespace)))
