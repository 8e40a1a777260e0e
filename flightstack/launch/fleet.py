"""One flight of a fleet by ``sitl``: all vehicles, all robots, an onboard process each, one log."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from bridge.mavlink.profiles.autopilots import AUTO, OWN_SITL
from flightstack.common.processes import Child
from flightstack.common.strict_toml import ConfigError, dumps
from flightstack.core.parameters.filters import short_name
from flightstack.launch.launcher import Followed, Launcher, Shown
from flightstack.launch.run_options import Flies, RunOptions
from flightstack.launch.sitl import GRACE_S, LOCKSTEP_SLOWEST, adapted, run_metadata
from flightstack.launch.vehicles import longest_s, others_s
from flightstack.onboard.options import OnboardOptions
from flightstack.onboard.recording import Described, describe_all, log_in, new_folder
from logs.schema.names import TEAM, Names, member_name
from sim.chance import name as seed_name
from sim.runners.options import TargetOptions, VehicleOptions
from sim.scenarios import team as teams
from sim.scenarios.scenario import Scenario
from sim.scenarios.team import TeamScenario
from sim.vehicle.vehicle import compile_first

RECORDER_YIELDS = 10  # steps of nice, shared by the members: each of them is work for it


@dataclass(frozen=True)
class FleetFlown:
    """What remains of a flight of a fleet.

    Attributes:
        about: what was flown, the first keys of ``--json``.
        folder: where everything is.
        log: the flight log.
        wall_s: wall time from the first tick to the end.
        flights: the onboard processes.
        problem: a process that failed.
        interrupted: whether the operator ended it.
    """

    about: Mapping[str, object]
    folder: Path
    log: Path
    wall_s: float
    flights: tuple[Followed, ...]
    problem: str | None
    interrupted: bool


def check(options: RunOptions) -> None:
    """Refuse options that several vehicles do not have.

    Raises:
        ConfigError: which option, and why.
    """
    own = "the vehicles of a team are simulated together, in one process"
    for name, given, why in (
        (options.flies.value, options.flies is not Flies.OWN, own),
        ("--speed", options.speed != 1.0, "works with PX4 and ArduPilot only; --lockstep is faster"),
        ("--mocap", options.mocap, "works with --px4 only"),
        ("--instance", options.instance is not None, "works with PX4 and ArduPilot only"),
        ("--ros2", options.ros2_where is not None, "shows one vehicle"),
        ("--view", options.view is not None, "shows one vehicle; open the log in a viewer after the flight"),
        ("--listen", bool(options.listen), "each vehicle has an endpoint of its own, which is printed"),
    ):
        if given:
            raise ConfigError(f"{name} with a scenario of several vehicles: {why}; leave it out")
    if options.lockstep and options.members:
        raise ConfigError(
            "--lockstep with --member: a vehicle from elsewhere waits for nobody; leave one out"
        )


def prepare(options: RunOptions) -> TeamScenario:
    """Load and check the team.

    Raises:
        ConfigError: it must not fly.
    """
    check(options)
    team = teams.load(options.scenario)
    number = len(team.member)
    if any(not 1 <= n <= number for n in options.members) or len(options.members) == number:
        found = ", ".join(map(str, options.members))
        raise ConfigError(
            f"--member: found {found}; allowed are 1 to {number}, and one at least is simulated here"
        )
    alone = [number for number, each in enumerate(team.member, 1) if each.onboard.fleet is None]
    if len(team.member) > 1 and alone:
        raise ConfigError(
            f"{options.scenario}: member {alone[0]}: onboard.fleet: missing; vehicles that share a room need "
            "it, to keep clear of each other (docs/how_it_works/fleet.md)"
        )
    return replace(team, member=tuple(adapted(options, each) for each in team.member))


def run(options: RunOptions, console: Console) -> FleetFlown:
    """Fly a team with processes of its own.

    Raises:
        ConfigError: wrong input.
        LaunchError: a process did not start.
    """
    team = prepare(options)
    name = short_name(team.member[0].onboard.filter)
    folder = options.out or new_folder(f"{team.name}-seed{seed_name(options.seed)}-{name}")
    log = log_in(folder)
    (folder / TEAM).write_text(teams.text(team))
    with Launcher(folder, console, tells=options.live) as launcher:
        return _fly(launcher, options, team, log)


@dataclass(frozen=True)
class _Member:
    """A vehicle of the team.

    Attributes:
        number: its MAVLink system id, from 1.
        scenario: of it alone.
        seed: of it alone.
        endpoint: of its onboard process.
        config: file of its onboard process.
    """

    number: int
    scenario: Scenario
    seed: int
    endpoint: str
    config: Path

    @property
    def name(self) -> str:
        """Its namespace."""
        return member_name(self.number)


def _fly(launcher: Launcher, options: RunOptions, team: TeamScenario, log: Path) -> FleetFlown:
    """Start each process after those it connects to; then watch until all flights have ended."""
    folder, rate_hz = launcher.folder, team.rate_hz
    members = [
        _Member(number, scenario, seed, launcher.endpoint(), folder / f"onboard-cf{number}.toml")
        for number, (scenario, seed) in enumerate(team.singles(options.seed), 1)
    ]
    for member in members:
        member.config.write_text(dumps(member.scenario.onboard))
    target_at, vehicle_at, urls = launcher.endpoint(), launcher.endpoint(), dict(options.members)
    recorder = launcher.record(log)
    _describe(launcher.socket, options, team, members)
    common: Mapping[str, Any] = {
        "scenario": folder / TEAM, "seed": options.seed, "recorder": launcher.socket,
        "lockstep": options.lockstep, "rate_hz": rate_hz,
        "duration_s": max(others_s(member.scenario) for member in members),
    }  # fmt: skip
    compile_first(team.member[0])
    vehicle = launcher.start(
        "vehicle",
        VehicleOptions(
            **common, leave_out=tuple(urls), url="udpin:127.0.0.1:0",
            listen=(vehicle_at,), connect=(target_at,), signing_key=options.signing_key,
        ),
    )  # fmt: skip
    here = [member.number for member in members if member.number not in urls]
    urls |= dict(zip(here, vehicle.wait_ready().replace("udpin", "udpout").split(), strict=True))
    target = launcher.start("target", TargetOptions(**common, listen=(target_at,)))
    onboards = [
        _start(launcher, options, member, urls[member.number], [target_at, vehicle_at], members)
        for member in members
    ]
    target.wait_ready()
    for child in onboards:
        child.wait_ready()
    if not options.lockstep:
        recorder.yield_to_others(RECORDER_YIELDS // len(members))  # starved, it would lose records
    for member in members:
        command = f"flightstack watch --connect {member.endpoint} --namespace {member.name}"
        launcher.console.print(f"to watch: {command}", style="dim", soft_wrap=True)
    if options.members:
        launcher.console.print(f"robots: {target_at}", style="dim", soft_wrap=True)
    slowest = LOCKSTEP_SLOWEST / len(members) if options.lockstep else 1.0
    limit_s = max(longest_s(member.scenario) for member in members) / slowest + GRACE_S
    filters = ", ".join(sorted({member.scenario.onboard.filter for member in members}))
    title = f"{team.name}  seed {seed_name(options.seed)}  filter {filters}"
    live = options.live and launcher.console.is_terminal and not options.lockstep
    names = [member.name for member in members]
    shown = Shown([member.endpoint for member in members], title, names) if live else None
    flights = tuple(Followed(child, name) for child, name in zip(onboards, names, strict=True))
    started = time.monotonic()
    problem = launcher.watch(flights, [vehicle, target, recorder], limit_s, shown, vehicle)
    wall_s = time.monotonic() - started
    launcher.end_all()
    if problem is None and recorder.process.returncode != 0:  # it may end after the flight
        problem = f"record did not end in order: {recorder.errors() or 'no reason given'}"
    about = {"scenario": team.name, "seed": options.seed, "filter": filters}
    return FleetFlown(about, folder, log, wall_s, flights, problem, launcher.interrupted)


def _start(
    launcher: Launcher,
    options: RunOptions,
    member: _Member,
    url: str,
    simulator: list[str],
    members: list[_Member],
) -> Child:
    """Start the onboard process of a member; in real time each two are connected, by the later one."""
    before = [] if options.lockstep else [each.endpoint for each in members[: member.number - 1]]
    # the heartbeat of the simulated vehicle is PX4's
    simulated = member.number not in options.members
    own = simulated and options.autopilot == AUTO
    plugged = OnboardOptions(
        vehicle_url=url, signing_key=options.signing_key if simulated else None,
        autopilot=OWN_SITL.name if own else options.autopilot, lockstep=options.lockstep,
        target_key=f"{member.name}/target/odom", connect=(*simulator, *before), listen=(member.endpoint,),
        config_file=member.config, duration_s=member.scenario.duration_max_s, recorder=launcher.socket,
        zenoh_config=options.zenoh_config, namespace=member.name, system_id=member.number, shared_log=True,
        accept_release=options.accept_release,
    )  # fmt: skip
    return launcher.start("onboard", plugged, of=member.name)


def _describe(recorder: Path, options: RunOptions, team: TeamScenario, members: list[_Member]) -> None:
    flights = [
        Described(
            member.scenario.onboard,
            run_metadata(options, member.scenario, member.seed),
            {"scenario.toml": dumps(member.scenario).encode()},
            Names(member.name, member.number),
        )
        for member in members
    ]
    fleet = {
        "members": ",".join(member.name for member in members),
        "scenario": team.name,
        "description": team.description,
        "seed": str(options.seed),
        "mode": "lockstep" if options.lockstep else "real-time",
        **options.told,
    }
    source = teams.path_of(options.scenario).read_bytes()
    describe_all(recorder, flights, fleet, {TEAM: teams.text(team).encode(), "team_source.toml": source})
