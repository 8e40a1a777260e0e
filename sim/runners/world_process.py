"""The world process: the simulated vehicles of a scenario and their robots, in lockstep or in real time.

Each vehicle has a MAVLink endpoint, and each robot has its keys on Zenoh. All share one process, because
decks, jets and collisions need all states together. ``flightstack vehicle`` starts a world without robots:
in real time its decks follow the true poses of robots in another process.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from itertools import zip_longest

from bridge.mavlink.endpoint import Endpoint, open_endpoint
from bridge.mavlink.server.server import COMPONENT_ID
from bridge.mavlink.transport.address import parse_udp_url
from bridge.zenoh import zenoh_link
from flightstack.common.hangup import Stop
from flightstack.common.pacing import EPOCH_NS, quiet_garbage_collector
from logs.recorder.feed import Feed
from logs.schema import Names
from sim.autopilot.autopilot import Autopilot
from sim.clock import TickGrid, run_process
from sim.options import VehicleOptions, WorldOptions
from sim.runners.lockstep import LockstepVehicle, LockstepWorld
from sim.runners.log import VehicleLog
from sim.runners.published_robot import LockstepRobot, RealTimeRobot, robots_of
from sim.runners.real_time import RealTimeVehicle, RealTimeWorld
from sim.runners.robot import RealTimeDeck
from sim.runners.room import MemberWords, Room, Words, warm_up_room
from sim.runners.vehicle_node import VehicleNode
from sim.scenarios.scenario import Scenario
from sim.vehicle.vehicle import VehicleSim

_PAUSE_S = 0.1  # wall time between two checks for signals when all flights are over, s


def world_main(team: Scenario, options: VehicleOptions) -> int:
    """Run the vehicles until SIGTERM, SIGINT or ``duration_s``; print ``ready URL ...``, cf1's first.

    It also prints ``armed`` and ``disarmed`` on each change, with the vehicle's name.

    ``team``: the scenario; ``options``: with ``WorldOptions`` the robots run, too. Port (if not 0), system
    id and namespace apply to the first vehicle. The next vehicles have the next ports and system ids, and
    the namespaces cf2, cf3 and so on.

    Returns the exit status.
    """
    verb = "world" if isinstance(options, WorldOptions) else "vehicle"
    return run_process(verb, partial(_fly, team, options))


def _fly(team: Scenario, options: VehicleOptions, stop: Stop, stack: ExitStack) -> None:
    lockstep, grid, here = options.lockstep, TickGrid(options.rate_hz), _here(team, options)
    ids = {number: options.system_id + number - 1 for number in here}
    endpoints = [_opened(options, number, ids[number], stack) for number in here]
    session = _session(team, options, stack)
    warm_up_room(team)
    singles = dict(enumerate(team.singles(options.seed), 1))
    simulated = [VehicleSim(*singles[number]) for number in here]
    epoch_ns = EPOCH_NS if lockstep else time.time_ns()
    feed = Feed.connect(options.recorder, "vehicle", lossless=lockstep, vehicles=len(here))
    stack.callback(feed.close)
    nodes = []
    for number, (endpoint, _), vehicle in zip(here, endpoints, simulated, strict=True):
        name = team.namespaces(options.namespace)[number]
        log = VehicleLog(feed, epoch_ns, Names(name, ids[number]))
        autopilot = Autopilot(vehicle, options.rate_hz, system_id=ids[number], epoch_ns=epoch_ns)
        for parameter, value in options.parameters.items():
            autopilot.parameters.preset(parameter, value)
        nodes.append(VehicleNode(number, name, vehicle, autopilot, endpoint, log, partial(_tell, name)))
    room, ticks = Room(nodes, grid, feed), grid.count(options.duration_s)
    words = Words(team, options.seed) if lockstep and team.exchanges else None
    if lockstep:
        ahead: dict[int, LockstepRobot] = {}
        if isinstance(options, WorldOptions):
            ahead = robots_of(team, options, feed, partial(LockstepRobot, grid, session, stop), stack)
        members = [MemberWords(session, each.name) for each in nodes if words is not None]
        radio_s = {number: scenario.vehicle.setpoint_delay_s for number, (scenario, _) in singles.items()}
        loops = [
            LockstepVehicle(node, ahead.get(node.number), grid, stop, radio_s[node.number], end)
            for node, end in zip_longest(nodes, members)
        ]
        _ready(endpoints, stop)
        for each in members:
            each.await_listener(stop)
        LockstepWorld(loops, room, words and words.pass_on, stop, epoch_ns).run(ticks)
        feed.flush()
        while words is not None and not stop.is_set:  # continue until the parent process ends this process
            time.sleep(_PAUSE_S)
        return
    robots: dict[int, RealTimeRobot] = {}
    if isinstance(options, WorldOptions):
        robots = robots_of(team, options, feed, partial(RealTimeRobot, grid, session, stop), stack)
        for number in options.leave_out:
            robots[number].be_followed()
    followed: Mapping[int, RealTimeRobot | RealTimeDeck] = robots
    if session is not None and not robots:
        followed = {each.number: RealTimeDeck(session, each.name) for each in nodes}
    vehicles = [RealTimeVehicle(each, followed.get(each.number), grid) for each in nodes]
    _ready(endpoints, stop)
    RealTimeWorld(vehicles, list(robots.values()), room, grid, stop).run(ticks)


def _here(team: Scenario, options: VehicleOptions) -> list[int]:
    """Return the numbers of the vehicles that this process simulates."""
    if options.leave_out and options.lockstep:
        raise ValueError(
            "--leave-out is for real time: a vehicle from elsewhere does not wait for the others"
        )
    number = len(team.members)
    if unknown := [n for n in options.leave_out if n > number]:
        raise ValueError(f"--leave-out: found {unknown[0]}; allowed are 1 to {number}")
    here = [n for n in range(1, number + 1) if n not in options.leave_out]
    if not here:
        raise ValueError("--leave-out leaves no vehicle; the scenario of one of them simulates it alone")
    return here


def _ready(endpoints: Sequence[tuple[Endpoint, str]], stop: Stop) -> None:
    stop.install()
    print("ready", *(url for _, url in endpoints), flush=True)
    quiet_garbage_collector()


def _opened(options: VehicleOptions, number: int, system_id: int, stack: ExitStack) -> tuple[Endpoint, str]:
    """Open the MAVLink endpoint of a vehicle; return the endpoint, and its URL with the actual port."""
    kind, host, port = parse_udp_url(options.url, "the simulated vehicle")
    port += number - 1 if port else 0
    if options.lockstep and options.peers:
        raise ValueError("--peer is for real time: in lockstep the companion calls first")
    mine = f"{kind}:{host}:{port}"
    endpoint = open_endpoint("vehicle", mine, system_id, COMPONENT_ID, options, options.peers)
    stack.callback(_close, endpoint)
    return endpoint, f"{kind}:{host}:{endpoint.local_port if kind == 'udpin' else port}"


def _session(team: Scenario, options: VehicleOptions, stack: ExitStack) -> zenoh_link.Session | None:
    """Open the Zenoh session of robots and onboard processes; return None if no endpoint is configured."""
    with_robots = isinstance(options, WorldOptions)
    if not (options.connect or options.listen or options.zenoh_config is not None):
        if not (with_robots or (options.lockstep and team.exchanges)):
            return None
        raise ValueError(
            "robots and messages between vehicles are on Zenoh: give --connect, --listen or --zenoh-config"
        )
    if options.lockstep and not with_robots:
        raise ValueError(
            "in lockstep a vehicle follows no robot of another process; `flightstack world` simulates both"
        )
    session = zenoh_link.open_session(
        options.listen,
        options.connect,
        config_file=options.zenoh_config,
        prompt=not options.lockstep,
        lockstep=options.lockstep,
    )
    stack.callback(session.close)
    return session


def _tell(name: str, armed: bool) -> None:
    """Print a change of arming for the parent process, which may then end this process."""
    print(f"{'armed' if armed else 'disarmed'} {name}", flush=True)


def _close(endpoint: Endpoint) -> None:
    dropped = endpoint.counters.dropped()
    if dropped:
        print(f"vehicle: MAVLink frames rejected: {dropped}", file=sys.stderr)
    endpoint.close()
