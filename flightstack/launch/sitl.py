"""One run of ``sitl``: it starts and watches vehicles, robots, onboard processes and recorder."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from flightstack.common.options import shared
from flightstack.common.strict_toml import ConfigError, dumps
from flightstack.config import load as load_config
from flightstack.config.options import OnboardOptions
from flightstack.core.parameters.filters import short_name
from flightstack.core.parameters.flight import FlightConfig
from flightstack.launch.launcher import Followed, Launcher
from flightstack.launch.result import Flown
from flightstack.launch.run_options import RunOptions
from flightstack.launch.vehicles import (
    VEHICLES,
    Flying,
    around_the_start,
    longest_s,
    others_s,
    plugged,
    to_the_floor_m,
)
from flightstack.onboard import process  # noqa: F401  # forked onboard processes then need not load it
from flightstack.onboard.recording import Described, describe, log_in, new_folder
from flightstack.verify.certificate import refuse
from logs.schema import NO_PAD, SCENARIO, Names
from sim.options import TargetOptions
from sim.robot import try_out
from sim.scenarios.scenario import Scenario, load, path_of, text
from sim.vehicle.declared import not_proven, outside

GRACE_S = 60.0  # wall time after the scenario's duration at which a run is stopped, s
LOCKSTEP_SLOWEST = 0.05  # ratio of simulated to wall time below which a lockstep run is stopped


def prepare(options: RunOptions) -> Scenario:
    """Return the checked scenario, with the configuration for the chosen autopilot."""
    scenario = load(options.scenario)
    for each in scenario.members:
        try_out(each.target)
    number, requested = len(scenario.members), options.members
    options.check(number)
    if any(not 1 <= n <= number for n in requested) or len(requested) == number:
        raise ConfigError(
            f"--member: found {', '.join(map(str, requested))}; allowed are 1 to {number}, and one at least "
            "is simulated here"
        )
    members = tuple(adapted(options, each) for each in scenario.members)
    if VEHICLES[options.flies].own_physics:
        members = tuple(map(around_the_start, members))
    for n, each in enumerate(members, 1):
        neighbours, known = {*range(1, number + 1)} - {n}, set(each.onboard.fleet.others)
        if neighbours and not known:
            raise ConfigError(
                f"{options.scenario}: member {n}: onboard.fleet: missing; vehicles that share a room need "
                "it to keep clear of each other (docs/how_it_works/fleet.md)"
            )
        if known and not neighbours and options.lockstep:
            raise ConfigError(
                "[fleet]: in lockstep all members are flown by one command: --scenario with a team's (see "
                "`scenarios`), or fly in real time"
            )
    return Scenario.of(members)


def adapted(options: RunOptions, scenario: Scenario) -> Scenario:
    """Return a scenario with the options applied. Raises ConfigError: it must not fly."""
    name = options.config_file or VEHICLES[options.flies].configuration(scenario, options.program)
    if name is not None:
        scenario = replace(scenario, onboard=_begun_as(scenario, load_config(name)))
    if options.filter is not None:
        scenario = scenario.with_filter(options.filter)
    if options.duration_s is not None:
        if options.duration_s <= 0.0:
            raise ConfigError(
                f"--duration: found {options.duration_s:g}, a positive number of seconds is needed"
            )
        scenario = replace(scenario, duration_max_s=options.duration_s)
    refuse([scenario.onboard], name or options.scenario)
    return scenario


def _begun_as(scenario: Scenario, config: FlightConfig) -> FlightConfig:
    """Return a configuration with the scenario's start point and fleet, unless it sets them itself."""
    start_offset_m = config.takeoff.start_offset_m or scenario.onboard.takeoff.start_offset_m
    takeoff = replace(config.takeoff, start_offset_m=start_offset_m)
    fleet = config.fleet if config.fleet.others else scenario.onboard.fleet
    return replace(config, takeoff=takeoff, fleet=fleet)


@dataclass(frozen=True)
class _Vehicle:
    """A simulated vehicle of the run: its names, scenario, seed and endpoints."""

    number: int  # number in the scenario, from 1
    name: str  # namespace of the vehicle
    scenario: Scenario
    seed: int
    endpoint: str  # Zenoh endpoint of the vehicle's onboard process
    config: Path  # configuration file of the vehicle's onboard process


def run(options: RunOptions, console: Console) -> Flown:
    """Fly a scenario with a process for each part."""
    scenario = prepare(options)
    name = short_name(scenario.onboard.filter)
    folder = options.out or new_folder(f"{scenario.name}-seed{options.seed}-{name}")
    log = log_in(folder)
    (folder / SCENARIO).write_text(text(scenario), encoding="utf-8")
    with Launcher(folder, console, tells=not options.as_json) as launcher:
        if line := not_proven(scenario):
            launcher.hint(line)
        return _Run(launcher, options, scenario).fly(log)


class _Run:
    """Processes of a run, which are started in the order of their connections."""

    def __init__(self, launcher: Launcher, options: RunOptions, scenario: Scenario) -> None:
        self._launcher, self._options, self._scenario = launcher, options, scenario
        names = scenario.namespaces()
        self._vehicles: list[_Vehicle] = []
        for number, (member, seed) in enumerate(scenario.singles(options.seed), 1):
            name, config = names[number], launcher.folder / f"onboard-{names[number]}.toml"
            config.write_text(dumps(member.onboard), encoding="utf-8")
            vehicle = _Vehicle(number, name, member, seed, launcher.endpoint(), config)
            self._vehicles.append(vehicle)
        self._robots_at = launcher.endpoint()  # Zenoh endpoint of the robots

    def fly(self, log: Path) -> Flown:
        """Start all processes, then watch until all flights have ended."""
        launcher, options, scenario, vehicles = self._launcher, self._options, self._scenario, self._vehicles
        launcher.record(log)
        if options.view is not None:
            first = vehicles[0]
            launcher.view(options.view, first.endpoint, first.config, first.name)
        self._describe()
        kind = VEHICLES[options.flies]
        flying = kind.start(launcher, options, scenario, self._robots_at)
        if not kind.with_robots:
            own = plugged(
                TargetOptions, launcher, options, **flying.clock,
                duration_s=others_s(scenario), listen=(self._robots_at,), connect=(vehicles[0].endpoint,),
            )  # fmt: skip
            launcher.start("target", own).wait_ready()
        flights = tuple(self._start(each, flying) for each in vehicles)
        if options.members:
            launcher.hint(f"robots: {self._robots_at}")
        speed = LOCKSTEP_SLOWEST / len(vehicles) if options.lockstep else min(1.0, options.speed)
        filters = ", ".join(sorted({each.scenario.onboard.filter for each in vehicles}))
        title = f"{scenario.name}  seed {options.seed}  filter {filters}"
        live = not options.as_json and launcher.console.is_terminal and not options.lockstep
        problem, wall_s = launcher.fly(
            flights, title if live else None, longest_s(scenario) / speed + GRACE_S, flying.teller,
            lockstep=options.lockstep,
        )  # fmt: skip
        about = {"scenario": scenario.name, "seed": options.seed, "filter": filters}
        return Flown(about, launcher.folder, log, wall_s, flights, problem)

    def _start(self, vehicle: _Vehicle, flying: Flying) -> Followed:
        """Start the onboard process of a vehicle; in real time, each one connects to all earlier ones."""
        options, n = self._options, vehicle.number - 1
        earlier = () if options.lockstep else self._vehicles[:n]
        own = {"system_id": vehicle.number, **flying.clock, **flying.options[n]}
        if VEHICLES[options.flies].own_physics:
            own["target_offset_m"] = to_the_floor_m(vehicle.scenario)
        onboard = shared(
            options, OnboardOptions, **own, target_key=f"{vehicle.name}/target/odom",
            connect=(self._robots_at, *(each.endpoint for each in earlier)), namespace=vehicle.name,
            listen=(vehicle.endpoint, *options.listen), config_file=vehicle.config,
            duration_s=vehicle.scenario.duration_max_s, recorder=self._launcher.socket,
            unproven=True,  # a simulated vehicle may fly an unproven configuration
        )  # fmt: skip
        child = self._launcher.start("onboard", onboard, of=vehicle.name)
        return Followed(child, vehicle.name, (vehicle.endpoint, *options.listen))

    def _describe(self) -> None:
        """Write scenario, configuration and options of the run to the log."""
        options = self._options
        pad = {"pad": NO_PAD} if VEHICLES[options.flies].own_physics else {}
        flights = []
        for each in self._vehicles:
            member = each.scenario
            run = {
                **self._about(member, each.seed),
                "judge_alpha_1_m": repr(member.judged_by.alpha_1_m),
                "judge_beta_m": repr(member.judged_by.beta_m),
                "outside_envelope": outside([member]),
                "pad_radius_m": repr(member.target.pad_radius_m),
                **pad,
            }
            flights.append(Described(member.onboard, run, Names(each.name, each.number)))
        source = {SCENARIO.replace(".", "_source."): path_of(options.scenario).read_bytes()}
        files = {SCENARIO: text(self._scenario).encode(), **source}
        fleet = self._about(self._scenario, options.seed)
        describe(self._launcher.socket, *flights, fleet=fleet, attachments=files)

    def _about(self, scenario: Scenario, seed: int) -> dict[str, str]:
        return {
            "scenario": scenario.name,
            "description": scenario.description,
            "seed": str(seed),
            "mode": "lockstep" if self._options.lockstep else "real-time",
            **self._options.described(),
        }
