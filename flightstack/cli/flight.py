"""Commands that fly or show a flight: ``sitl``, ``fly``, ``watch``, and the processes of a flight."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NoReturn

import click

from flightstack.common.hangup import Stop, reader_gone, say
from flightstack.common.options import takes
from flightstack.config.options import WATCHED, OnboardOptions, WatchOptions
from flightstack.launch.run_options import FlyOptions, RunOptions
from sim.options import Px4SimOptions, TargetOptions, VehicleOptions, WorldOptions

if TYPE_CHECKING:
    from flightstack.common.terminal import Terminal
    from flightstack.launch.result import Flown
    from logs.view.live import LiveRecording


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
    """Run the simulated Crazyflie as a MAVLink vehicle; the simulated pad follows the target's true pose.

    With a scenario of several vehicles the command runs all of them, each with its own port and namespace, or
    with --member one of them.
    """
    _run_world(options)


def _run_world(options: VehicleOptions) -> None:
    from logs.schema import member_name
    from sim.runners import world_process
    from sim.scenarios.scenario import load

    scenario = load(options.scenario)
    if options.member is not None:
        name = member_name(options.member)
        scenario, seed = scenario.one(options.seed, options.member)
        options = replace(options, seed=seed, namespace=name, system_id=options.member)
    sys.exit(world_process.world_main(scenario, options))


@click.command()
@takes(TargetOptions)
def target(options: TargetOptions) -> None:
    """Run the simulated ground robot: it drives the scenario's path and publishes its odometry on Zenoh.

    With a scenario of several vehicles the command runs the robots of all vehicles.
    """
    from flightstack.compiled.jit import OFF

    # The robot needs only 100 short steps per second: loading numba would take longer than numba saves.
    if "numba" not in sys.modules:
        os.environ.setdefault(OFF, "1")
    from sim.runners.world_process import target_main
    from sim.scenarios.scenario import load

    sys.exit(target_main(load(options.scenario), options))


@click.command("px4-sim")
@takes(Px4SimOptions)
def px4_sim(options: Px4SimOptions) -> None:
    """Simulate body, rotors, wind and moving pad for PX4, which runs as the autopilot (SITL).

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


FRESH, NOTHING = 0, 1
LOOK_S = 0.05  # time between two polls of --once, s
DRAW_S = 0.1  # time between two updates of the 3-D view, s
PRINT_S = 0.5  # time between two lines of JSON, s
NICER = 10  # niceness of a 3-D view, so that the processes of the flight have priority


@click.command()
@takes(WatchOptions)
def watch(options: WatchOptions) -> None:
    """Show running flights: phase, h, set-points, ages, battery, loop timing. Ctrl-C ends it.

    The command only receives data. Exit status: 0 normal end, 1 with --once if a vehicle sent no recent
    data, 2 wrong input.
    """
    from rich.live import Live

    from bridge.zenoh import zenoh_link
    from flightstack.common.terminal import Terminal
    from flightstack.watch import REFRESH_HZ, Watch, draw, snapshot

    if options.view is not None and (options.once or options.as_json):
        raise click.UsageError("--view draws until it is ended; --once and --json print: give one of them")
    names = options.namespaces or ("cf1",)
    if len(set(names)) < len(names):
        raise click.UsageError(f"--namespace: found {', '.join(names)}; each vehicle is given once")
    recording = _recording(options, options.view, names) if options.view is not None else None
    stop = Stop().install()
    connect = options.connect or ((WATCHED,) if options.zenoh_config is None else ())
    session = zenoh_link.open_session([], connect, config_file=options.zenoh_config)
    try:
        role, dialled = zenoh_link.dialled(connect, config_file=options.zenoh_config)
        title = ", ".join(names)
        flights = {name: Watch(session, name, role=role) for name in names}

        def polls(period_s: float) -> Iterator[None]:
            """Poll all flights until a signal or the end of the output's reader; yield after each poll."""
            while not stop.is_set and not reader_gone():
                time.sleep(period_s)
                for flight in flights.values():
                    flight.poll()
                yield

        def print_all() -> None:
            for flight in flights.values():
                click.echo(json.dumps(snapshot(flight)))

        if options.once:
            until_s = time.monotonic() + options.timeout_s
            for _ in polls(LOOK_S):
                complete = all(flight.fresh and flight.health is not None for flight in flights.values())
                if complete or time.monotonic() >= until_s:
                    break
            if options.as_json:
                print_all()
            else:
                Terminal().print(draw(flights, title, dialled))
            sys.exit(FRESH if all(flight.fresh for flight in flights.values()) else NOTHING)
        elif recording is not None:
            for _ in polls(DRAW_S):
                if recording.closed:
                    break
                for name, flight in flights.items():
                    reason = flight.health.reason if flight.health else ""
                    recording.add(name, flight.new_steps, flight.new_timings, reason)
        elif options.as_json:
            for _ in polls(PRINT_S):
                print_all()
        else:
            with Live(console=Terminal(), auto_refresh=False) as view:
                for _ in polls(1.0 / REFRESH_HZ):
                    view.update(draw(flights, f"{title} at {', '.join(dialled)}", dialled), refresh=True)
    finally:
        session.close()
        if recording is not None:
            recording.close()


def _recording(options: WatchOptions, where: str, names: Sequence[str]) -> LiveRecording:
    """Open the 3-D view at ``where``, the value of ``--view``, of the vehicles with these namespaces."""
    from flightstack.config import load
    from logs.view.live import LiveRecording

    files = options.config_files
    if len(files) not in (0, len(names)):
        raise click.UsageError(
            f"--config: found {len(files)}; none, or one for each --namespace is needed, here {len(names)}"
        )
    configs = dict(zip(names, map(load, files), strict=True)) if files else dict.fromkeys(names)
    if not files:
        click.echo(
            "flightstack: without --config there is no barrier, and the pad is drawn in a Crazyflie's size",
            err=True,
        )
    os.nice(NICER)  # the viewer that Rerun starts inherits this niceness
    recording = LiveRecording(where, configs)
    click.echo(f"ready {recording.address}")
    return recording
