"""The world process: the simulated vehicles of a scenario and their robots, in lockstep or in real time.

Each vehicle has a MAVLink endpoint, and each robot has its keys on Zenoh. All share one process, because
decks, jets and collisions need all states together. ``flightstack vehicle`` starts a world without robots:
in real time its decks follow the true poses of robots in another process. ``flightstack target`` starts these
robots without vehicles. In real time, vehicles handle messages on arrival and send at each tick.
"""

from __future__ import annotations

import select
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.endpoint import Endpoint, open_endpoint
from bridge.mavlink.server.server import COMPONENT_ID
from bridge.mavlink.transport.address import PORT_MAX, parse_url
from bridge.mavlink.transport.transport import dropped
from bridge.zenoh import zenoh_link
from flightstack.common.hangup import Stop
from flightstack.common.pacing import (
    EPOCH_NS,
    Clock,
    FastClock,
    Follower,
    chosen_clock,
    give_up_priority,
    quiet_garbage_collector,
    run_promptly,
)
from logs.recorder.feed import Feed
from logs.schema import Names
from sim.autopilot.autopilot import Autopilot
from sim.clock import TickGrid, run_process
from sim.options import TargetOptions, VehicleOptions, WorldOptions
from sim.runners.lockstep import LockstepVehicle, fly_in_lockstep
from sim.runners.log import EventLog, VehicleLog
from sim.runners.published_robot import LockstepRobot, R, RealTimeDeck, RealTimeRobot, robots_of
from sim.runners.room import FleetEnd, MemberWords, Room, Words, warm_up_room
from sim.runners.vehicle_node import VehicleNode
from sim.scenarios.scenario import Scenario
from sim.vehicle.vehicle import VehicleSim

_BEHIND_MAX_S = 0.1  # delay up to which simulated time catches up, s; a longer delay shifts the clock
_MS = 1e-3
_NS_PER_MS = 1_000_000


@dataclass(slots=True, kw_only=True)
class RealTimeVehicle(VehicleNode):
    """A simulated vehicle that follows the wall clock."""

    # a robot of this process, or true poses from another process; None: the deck does not move
    robot: RealTimeRobot | RealTimeDeck | None
    grid: TickGrid
    _ms: int = field(default=0, init=False)  # simulated time, ms

    def tick(self, tick: int) -> None:
        """Send messages and write the log for a tick; the vehicle has been simulated up to it."""
        now_ns, robot = self.grid.ns(tick), self.robot
        now_s = now_ns / 1e9
        self.receive()
        self.control(now_s)
        self.wire.send(self.autopilot.telemetry(now_s), now_ns)
        if isinstance(robot, RealTimeDeck):
            robot.move(self.vehicle, now_s, partial(self.log.target, now_ns), self.warn)
        elif robot is not None:
            self.carry(robot, tick, now_ns)
        self.write_log(tick, now_ns)
        self.log.feed.flush()

    def receive(self) -> None:
        """Handle the messages that have arrived."""
        now_s, now_ns = self._ms * _MS, self._ms * _NS_PER_MS
        frames = self.wire.late(now_ns)
        for received in self.endpoint.receive():
            frames += self.wire.receive(received, now_ns)
        for received in frames:
            if replies := self.answer(received, now_s):
                self.wire.send(replies, now_ns, received.peer)
        if frames:
            self.control(now_s)

    def advance_to(self, ms: int) -> None:
        """Simulate up to this time, ms; do nothing if it is already reached."""
        if ms > self._ms:
            self.vehicle.advance(ms - self._ms)
            self._ms = ms

    def warn(self, text: str) -> None:
        """Send a warning to the clients as a status text of the autopilot."""
        self.report(dialect.MAV_SEVERITY_WARNING, text)


def fly_in_real_time(
    vehicles: Sequence[RealTimeVehicle],
    robots: Sequence[RealTimeRobot],
    room: Room,
    grid: TickGrid,
    stop: Stop,
    clock: Clock,
    ticks: int | None,
) -> None:
    """Run the ticks of vehicles and robots in real time, or at the speed of ``clock``.

    ``robots``: all robots of this process; those without a vehicle here serve vehicles of other processes;
    ``stop``: ends the process; ``ticks``: number of ticks; None: no end.
    """
    loose = [robot for robot in robots if robot not in [each.robot for each in vehicles]]
    logs: list[EventLog] = [*(each.log for each in vehicles), *(each.log for each in robots)]
    run_promptly()  # the physics must not wait for other programs, as in a real vehicle
    start_s = clock.monotonic()
    epoch_ns = _set_epoch(logs, clock.unix_ns())  # set now, because the creation of the vehicles took time
    for robot in robots:
        robot.begin()
    tick = 0
    while not stop.is_set and tick != ticks:
        deadline_s = start_s + grid.ns(tick) / 1e9
        while (left_s := deadline_s - clock.monotonic()) > 0.0 and not stop.is_set:
            if not vehicles:
                clock.sleep(left_s)
            for vehicle in _heard(vehicles, left_s):
                since_start_ms = int((clock.monotonic() - start_s) / _MS)
                vehicle.advance_to(min(since_start_ms, grid.ms(tick)))
                vehicle.receive()
        late_s = clock.monotonic() - deadline_s
        if late_s > _BEHIND_MAX_S:  # a long pause shifts the log's clock; simulated time does not catch up
            give_up_priority()
            start_s += late_s
            epoch_ns = _set_epoch(logs, epoch_ns + round(late_s * 1e9))
            for vehicle in vehicles:
                vehicle.warn(f"Machine paused {late_s:.2f} s: simulation too")
        for vehicle in vehicles:
            vehicle.advance_to(grid.ms(tick))
        if tick > 0:
            room.end(tick - 1, epoch_ns)
        room.begin()
        for vehicle in vehicles:
            vehicle.tick(tick)
        for robot in loose:
            robot.take(tick)
            robot.log.feed.flush()
        tick += 1
    if tick > 1:
        room.write(tick - 2, epoch_ns)


def _heard(vehicles: Sequence[RealTimeVehicle], within_s: float) -> list[RealTimeVehicle]:
    """Wait at most ``within_s`` for frames; return the vehicles that received some."""
    by_number = {vehicle.endpoint.fileno(): vehicle for vehicle in vehicles}
    ready = select.select(list(by_number), (), (), within_s)[0] if by_number else ()
    return [by_number[number] for number in ready]


def _set_epoch(logs: Sequence[EventLog], epoch_ns: int) -> int:
    for log in logs:
        log.epoch_ns = epoch_ns
    return epoch_ns


_PAUSE_S = 0.1  # wall time between two checks for signals when all flights are over, s


def target_main(team: Scenario, options: TargetOptions) -> int:
    """Run the robots until SIGTERM, SIGINT or ``duration_s``; print ``ready`` when they can be reached.

    Returns the exit status.
    """
    return run_process("target", partial(_drive, team, options))


def _drive(team: Scenario, options: TargetOptions, stop: Stop, stack: ExitStack) -> None:
    clock = chosen_clock(options.speed, options.clock, Follower.TARGET, lambda: stop.is_set)
    grid = TickGrid(team.rate_hz)
    session = zenoh_link.open_session(
        options.listen, options.connect, config_file=options.zenoh_config, prompt=True
    )
    stack.callback(session.close)
    feed = Feed.connect(options.recorder, "target", lossless=False, vehicles=len(team.members))
    stack.callback(feed.close)
    robots = robots_of(team, options, feed, partial(RealTimeRobot, grid, session, stop), stack)
    _ready((), stop)
    room, ticks = Room((), grid, feed), grid.count(options.duration_s)
    fly_in_real_time((), list(robots.values()), room, grid, stop, clock, ticks)


def world_main(team: Scenario, options: VehicleOptions) -> int:
    """Run the vehicles until SIGTERM, SIGINT or ``duration_s``; print ``ready`` and their URLs, cf1 first.

    It also prints ``armed`` and ``disarmed`` on each change, with the vehicle's name.

    ``team``: the scenario; ``options``: with ``WorldOptions`` the robots run, too. Port (if not 0), system
    id and namespace apply to the first vehicle. The next vehicles have the next ports and system ids, and
    the namespaces cf2, cf3 and so on.

    Returns the exit status.
    """
    verb = "world" if isinstance(options, WorldOptions) else "vehicle"
    return run_process(verb, partial(_fly, team, options))


def _fly(team: Scenario, options: VehicleOptions, stop: Stop, stack: ExitStack) -> None:
    lockstep, grid, here = options.lockstep, TickGrid(team.rate_hz), _here(team, options)
    names, ids = team.namespaces(options.namespace), {n: options.system_id + n - 1 for n in here}
    endpoints = {n: _opened(options, n, ids[n], stack) for n in here}
    session = _session(team, options, stack)
    warm_up_room(team)
    singles = dict(enumerate(team.singles(options.seed), 1))
    simulated = {n: VehicleSim(*singles[n]) for n in here}
    epoch_ns, ticks = EPOCH_NS if lockstep else time.time_ns(), grid.count(options.duration_s)
    feed = Feed.connect(options.recorder, "vehicle", lossless=lockstep, vehicles=len(here))
    stack.callback(feed.close)

    def parts(n: int) -> tuple[int, str, VehicleSim, Autopilot, Endpoint, VehicleLog, Callable[[bool], None]]:
        """Return the arguments of a ``VehicleNode``."""
        log = VehicleLog(feed, epoch_ns, Names(names[n], ids[n]))
        autopilot = Autopilot(simulated[n], team.rate_hz, system_id=ids[n], epoch_ns=epoch_ns)
        for parameter, value in options.parameters.items():
            autopilot.parameters.preset(parameter, value)
        return n, names[n], simulated[n], autopilot, endpoints[n][0], log, partial(_tell, names[n])

    def robots(kind: type[R]) -> dict[int, R]:
        """Return the robots of this process by number."""
        if not isinstance(options, WorldOptions):
            return {}
        return robots_of(team, options, feed, partial(kind, grid, session, stop), stack)

    if not lockstep:
        driven = robots(RealTimeRobot)
        followed: dict[int, RealTimeRobot | RealTimeDeck] = {**driven}
        if session is not None and not driven:
            followed = {n: RealTimeDeck(session, names[n]) for n in here}
        vehicles = [RealTimeVehicle(*parts(n), robot=followed.get(n), grid=grid) for n in here]
        room = Room(vehicles, grid, feed)
        _ready([url for _, url in endpoints.values()], stop)
        fly_in_real_time(vehicles, list(driven.values()), room, grid, stop, FastClock(), ticks)
        return
    ahead = robots(LockstepRobot)

    def end_of(n: int) -> FleetEnd:
        """Return the simulator's end of a vehicle's messages to its neighbours."""
        if session is None or not singles[n][0].onboard.fleet.others:
            return FleetEnd()  # without neighbours a companion sends no fleet messages
        return MemberWords(session, names[n])

    loops = [
        LockstepVehicle(*parts(n), robot=ahead.get(n), grid=grid, stop=stop, words=end_of(n)) for n in here
    ]
    room = Room(loops, grid, feed)
    _ready([url for _, url in endpoints.values()], stop)
    for each in loops:
        each.words.await_listener(stop)
    flown = fly_in_lockstep(loops, room, Words(team, options.seed), stop, ticks)
    feed.flush()
    while flown != ticks and not stop.is_set:  # continue until the parent process ends this process
        time.sleep(_PAUSE_S)


def _here(team: Scenario, options: VehicleOptions) -> list[int]:
    """Return the numbers of the vehicles that this process simulates."""
    if options.leave_out and options.lockstep:
        raise ValueError(
            "--leave-out is for real time: a vehicle from elsewhere does not wait for the others"
        )
    number = len(team.members)
    here = sorted({*range(1, number + 1)} - {*options.leave_out})
    if not here or len(here) + len({*options.leave_out}) > number:
        found = ", ".join(map(str, options.leave_out))
        raise ValueError(f"--leave-out: found {found}; allowed are members from 1 to {number}, but not all")
    return here


def _ready(urls: Sequence[str], stop: Stop) -> None:
    stop.install()
    print("ready", *urls, flush=True)
    quiet_garbage_collector()


def _opened(options: VehicleOptions, number: int, system_id: int, stack: ExitStack) -> tuple[Endpoint, str]:
    """Open the MAVLink endpoint of a vehicle; return the endpoint, and its URL with the actual port."""
    kind, host, port = parse_url(options.url)
    if kind not in ("udpin", "udpout"):
        raise ValueError(f"{options.url!r}: the simulated vehicle supports UDP only; give udpin:HOST:PORT")
    port += number - 1 if port else 0
    if port > PORT_MAX:
        raise ValueError(
            f"{options.url!r}: vehicle {number} would have port {port}; allowed is up to {PORT_MAX}"
        )
    if options.lockstep and options.peers:
        raise ValueError("--peer is for real time: in lockstep the companion calls first")
    mine = f"{kind}:{host}:{port}"
    endpoint = open_endpoint("vehicle", mine, system_id, COMPONENT_ID, options, options.peers)
    stack.callback(_close, endpoint)
    return endpoint, f"{kind}:{host}:{endpoint.local_port if kind == 'udpin' else port}"


def _session(team: Scenario, options: VehicleOptions, stack: ExitStack) -> zenoh_link.Session | None:
    """Open the Zenoh session of robots and onboard processes; return None if no endpoint is configured."""
    with_robots = isinstance(options, WorldOptions)
    fleets = [each.onboard.fleet for each in team.members]
    talk_to = {number for fleet in fleets for number in fleet.others} if options.lockstep else set()
    if absent := talk_to - {fleet.id for fleet in fleets}:
        raise ValueError(
            f"[fleet]: found members {', '.join(map(str, sorted(absent)))}, which this command does not "
            "simulate; in lockstep one command simulates all members"
        )
    if not (options.connect or options.listen or options.zenoh_config is not None):
        if not (with_robots or talk_to):
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
    if lost := dropped(endpoint.counters):
        print(f"vehicle: MAVLink frames rejected: {lost}", file=sys.stderr)
    endpoint.close()
