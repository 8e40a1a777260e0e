"""One run of ``sitl``: it starts and watches vehicles, robots, onboard processes and recorder."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from bridge.mavlink.transport.address import PORT_MAX
from bridge.zenoh.zenoh_link import check_endpoint
from flightstack.common.options import shared
from flightstack.common.strict_toml import ConfigError, dumps
from flightstack.common.terminal import Terminal
from flightstack.config import load as load_config
from flightstack.config.options import OnboardOptions
from flightstack.core.parameters.fleet import ALONE
from flightstack.launch.launcher import Followed, Launcher
from flightstack.launch.result import Flown
from flightstack.launch.run_options import RunOptions
from flightstack.launch.vehicles import VEHICLES, Run, around_the_start, to_the_floor_m
from flightstack.onboard import process  # noqa: F401  # forked onboard processes then need not load it
from flightstack.onboard.recording import Described, describe, log_in, new_folder
from flightstack.verify.certificate import refuse
from logs.schema import NO_PAD, SCENARIO, Names
from sim.options import TargetOptions
from sim.robot import try_out
from sim.scenarios.scenario import Scenario, load, path_of, text
from sim.vehicle.declared import not_proven, outside

GRACE_S = 60.0  # wall time after the end of the longest flight at which a run is stopped, s
_PORT = re.compile(r"(\w+/[^?#]*:)(\d+)((?:[?#].*)?)")  # Zenoh endpoint with a port: tcp/HOST:PORT#options
LOCKSTEP_SLOWEST = 0.05  # ratio of simulated to wall time below which one vehicle in lockstep is stopped


def prepare(options: RunOptions) -> Scenario:
    """Return the checked scenario, with the configuration for the chosen autopilot."""
    scenario = load(options.scenario)
    for each in scenario.members:
        try_out(each.target)
    number, requested = len(scenario.members), options.members
    options.check()
    if number > (most := VEHICLES[options.flies].vehicles_max):
        raise ConfigError(
            f"{options.flies.value} with a scenario of {number} vehicles: it flies at most {most}; the "
            "vehicles of a team are simulated together: leave it out"
        )
    if any(not 1 <= n <= number for n in requested) or len(requested) == number:
        raise ConfigError(
            f"--member: found {_ids(requested)}; allowed are 1 to {number}, and one at least "
            "is simulated here"
        )
    members = tuple(adapted(options, each) for each in scenario.members)
    if VEHICLES[options.flies].own_physics:
        members = tuple(map(around_the_start, members))
    fleets = [each.onboard.fleet for each in members]
    if len({fleet.id for fleet in fleets}) != len(fleets):
        raise ConfigError(
            f"{options.scenario}: onboard.fleet.id: found {_ids(fleet.id for fleet in fleets)}; each member "
            "needs its own id, and the ids of all in onboard.fleet.members, so that vehicles which share a "
            "room keep clear of each other (docs/how_it_works/fleet.md)"
        )
    for n, fleet in enumerate(fleets):
        neighbours, known = {each.id for each in (*fleets[:n], *fleets[n + 1 :])}, {*fleet.others}
        if missing := neighbours - known:
            raise ConfigError(
                f"{options.scenario}: member {n + 1}: onboard.fleet.members: {_ids(missing)} missing; "
                "vehicles that share a room need them to keep clear of each other "
                "(docs/how_it_works/fleet.md)"
            )
        if options.lockstep and (absent := known - neighbours):
            raise ConfigError(
                f"[fleet]: found members {_ids(absent)}, which this command does not fly; in lockstep all "
                "members are flown by one command: --scenario with a team's (see `scenarios`), or fly in "
                "real time"
            )
    return Scenario.of(members)


def _ids(found: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(found)))


def adapted(options: RunOptions, scenario: Scenario) -> Scenario:
    """Return a scenario with the options applied. Raises ConfigError: the certificate refuses the flight."""
    name = options.config_file or VEHICLES[options.flies].configuration(scenario, options.program)
    if name is not None:  # start point and fleet come from the scenario unless the configuration sets them
        config, own = load_config(name), scenario.onboard
        start_offset_m = config.takeoff.start_offset_m or own.takeoff.start_offset_m
        takeoff = replace(config.takeoff, start_offset_m=start_offset_m)
        fleet = config.fleet if config.fleet != ALONE else own.fleet
        scenario = replace(scenario, onboard=replace(config, takeoff=takeoff, fleet=fleet))
    if options.filter is not None:
        scenario = scenario.with_filter(options.filter)
    if options.duration_s is not None:
        scenario = replace(scenario, duration_max_s=options.duration_s)
    refuse([scenario.onboard], name or options.scenario)
    return scenario


class _Vehicle(NamedTuple):
    """A simulated vehicle of the run."""

    names: Names  # namespace of the vehicle, and its number in the scenario, from 1
    scenario: Scenario
    seed: int
    endpoint: str  # Zenoh endpoint of the vehicle's onboard process
    watched_at: tuple[str, ...]  # further endpoints of this process, from --listen
    config: Path  # configuration file of the vehicle's onboard process


def run(options: RunOptions, console: Terminal) -> Flown:
    """Fly a scenario in several processes, and watch them until all flights have ended."""
    scenario, kind = prepare(options), VEHICLES[options.flies]
    listen = endpoints(options.listen, len(scenario.members))
    filter_name = scenario.onboard.filter.rpartition(":")[2]
    folder = options.out or new_folder(f"{scenario.name}-seed{options.seed}-{filter_name}")
    log = log_in(folder)
    (folder / SCENARIO).write_text(text(scenario), encoding="utf-8")
    with Launcher(folder, console, tells=not options.as_json) as launcher:
        if line := not_proven(scenario):
            launcher.hint(line)
        vehicles = _vehicles(scenario, options.seed, launcher, listen)
        run = Run(launcher, options, scenario, launcher.endpoint())
        launcher.record(log)
        if options.view is not None:
            flown = [(each.names.member, each.endpoint, each.config) for each in vehicles]
            launcher.view(options.view, flown)
        _describe(run, vehicles)
        flying = kind.start(run)
        if not kind.with_robots:
            run.start(
                "target", TargetOptions, **flying.clock, duration_s=run.others_s, listen=(run.robots_at,),
                connect=(vehicles[0].endpoint,),
            ).wait_ready()  # fmt: skip
        flights = []
        for n, vehicle in enumerate(vehicles):  # in real time each process connects to all earlier ones
            earlier = [] if options.lockstep else [each.endpoint for each in vehicles[:n]]
            flights.append(_fly(run, vehicle, {**flying.clock, **flying.options[n]}, earlier))
        if options.members:
            launcher.hint(f"robots: {run.robots_at}")
        speed = LOCKSTEP_SLOWEST / len(vehicles) if options.lockstep else min(1.0, options.speed)
        filters = ", ".join(sorted({each.scenario.onboard.filter for each in vehicles}))
        live = not options.as_json and console.is_terminal and not options.lockstep
        problem, wall_s = launcher.fly(
            flights, f"{scenario.name}  seed {options.seed}  filter {filters}" if live else None,
            run.longest_s / speed + GRACE_S, flying.teller, lockstep=options.lockstep,
        )  # fmt: skip
    about = {"scenario": scenario.name, "seed": options.seed, "filter": filters}
    return Flown(about, folder, log, wall_s, flights, problem)


def _vehicles(
    scenario: Scenario, seed: int, launcher: Launcher, listen: Sequence[tuple[str, ...]]
) -> list[_Vehicle]:
    """Write the configuration files of the vehicles of a scenario; return these vehicles."""
    vehicles = []
    for (number, name), (member, own_seed) in zip(
        scenario.namespaces().items(), scenario.singles(seed), strict=True
    ):
        config = launcher.folder / f"onboard-{name}.toml"
        config.write_text(dumps(member.onboard), encoding="utf-8")
        names, endpoint = Names(name, number), launcher.endpoint()
        vehicles.append(_Vehicle(names, member, own_seed, endpoint, listen[number - 1], config))
    return vehicles


def _fly(run: Run, vehicle: _Vehicle, own: Mapping[str, Any], connect: Sequence[str]) -> Followed:
    """Start the onboard process of a vehicle; ``own``: options for this kind of vehicle."""
    options, name = run.options, vehicle.names.member
    if VEHICLES[options.flies].own_physics:
        own = {**own, "target_offset_m": to_the_floor_m(vehicle.scenario)}
    onboard = shared(
        options, OnboardOptions, **{"system_id": vehicle.names.system_id, **own},
        target_key=f"{name}/target/odom", connect=(run.robots_at, *connect), namespace=name,
        listen=(vehicle.endpoint, *vehicle.watched_at), config_file=vehicle.config,
        duration_s=vehicle.scenario.duration_max_s, recorder=run.launcher.socket,
        unproven=True,  # in simulation, a configuration without proof is allowed
    )  # fmt: skip
    return Followed(run.launcher.start("onboard", onboard, of=name), name, onboard.listen)


def endpoints(listen: Sequence[str], vehicles: int) -> list[tuple[str, ...]]:
    """Return the endpoints from --listen of each vehicle: each has the next port; 0 is any free port.

    Raises ConfigError: malformed endpoint, no allowed port for a vehicle, or an address that is used twice.
    """
    rows = [_at_ports(each, vehicles) for each in listen]
    addresses = [re.split("[?#]", each)[0] for row in rows for each in row]
    if twice := {each for each in addresses if addresses.count(each) > 1 and not each.endswith(":0")}:
        raise ConfigError(
            f"--listen: found {', '.join(listen)}; used twice: {', '.join(sorted(twice))}; the port of "
            f"vehicle n is n - 1 higher, so ports of one host must be at least {vehicles} apart"
        )
    return list(zip(*rows, strict=True)) if rows else [()] * vehicles


def _at_ports(endpoint: str, vehicles: int) -> list[str]:
    """Return the endpoints of all vehicles for one --listen. Raises ConfigError."""
    try:
        found = _PORT.fullmatch(check_endpoint(endpoint))
    except ValueError as error:
        raise ConfigError(f"--listen: {error}") from error
    if vehicles == 1:
        return [endpoint]
    if found is None:
        raise ConfigError(
            f"--listen: found {endpoint} for {vehicles} vehicles; allowed is an endpoint with a port, for "
            "example tcp/127.0.0.1:7448, because each vehicle needs its own"
        )
    first = int(found[2])
    ports = [first + n if first else 0 for n in range(vehicles)]
    if ports[-1] > PORT_MAX:
        raise ConfigError(
            f"--listen: found {endpoint}; the {vehicles} vehicles need the ports {first} to {ports[-1]}, "
            f"allowed is up to {PORT_MAX}"
        )
    return [f"{found[1]}{port}{found[3]}" for port in ports]


def _describe(run: Run, vehicles: Sequence[_Vehicle]) -> None:
    """Write scenario, configuration and options of the run to the log."""
    options = run.options

    def about(scenario: Scenario, seed: int) -> dict[str, str]:
        mode = "lockstep" if options.lockstep else "real-time"
        names = {"scenario": scenario.name, "description": scenario.description}
        return {**names, "seed": str(seed), "mode": mode, **options.described()}

    flights = []
    for each in vehicles:
        member = each.scenario
        judged = {
            "judge_alpha_1_m": repr(member.judged_by.alpha_1_m),
            "judge_beta_m": repr(member.judged_by.beta_m),
            "outside_envelope": outside([member]),
            "pad_radius_m": repr(member.target.pad_radius_m),
            **({"pad": NO_PAD} if VEHICLES[options.flies].own_physics else {}),
        }
        flights.append(Described(member.onboard, {**about(member, each.seed), **judged}, each.names))
    source = {SCENARIO.replace(".", "_source."): path_of(options.scenario).read_bytes()}
    describe(
        run.launcher.socket, *flights, fleet=about(run.scenario, options.seed),
        attachments={SCENARIO: text(run.scenario).encode(), **source},
    )  # fmt: skip
