"""The simulated vehicles as a process, and their loop in real time (``lockstep`` has the other one).

Each has a MAVLink endpoint on one side, the true pose of its robot on the other. Vehicles of a team share a
process since what happens between them is physical: jets and collisions need all states at once.
"""

from __future__ import annotations

import select
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.endpoint import Endpoint, open_endpoint
from bridge.mavlink.server.server import COMPONENT_ID
from bridge.mavlink.transport.address import parse_udp_url
from bridge.zenoh import zenoh_link
from flightstack.common.hangup import Stop
from flightstack.common.pacing import (
    EPOCH_NS,
    give_up_priority,
    quiet_garbage_collector,
    run_promptly,
)
from logs.recorder.feed import Feed, FeedError
from sim.autopilot.autopilot import Autopilot
from sim.clock import NoAnswerError, TickGrid
from sim.options import VehicleOptions
from sim.runners.deck import LockstepDeck, RealTimeDeck
from sim.runners.lockstep import LockstepLoop
from sim.runners.lockstep_team import LockstepMember, TeamLockstep
from sim.runners.log import VehicleLog
from sim.runners.room import Member, Room, Words, warm_up_room
from sim.runners.vehicle_node import VehicleNode
from sim.scenarios.scenario import Scenario
from sim.scenarios.team import TeamScenario
from sim.vehicle.vehicle import VehicleSim

_BEHIND_MAX_S = 0.1  # s; after a longer pause of the machine, simulated time is put back instead of caught up
_MS = 1e-3
_NS_PER_MS = 1_000_000
_PAUSE_S = 0.1  # s between two looks at the signals when all flights are over


class RealTimeVehicle:
    """One vehicle: acts on what comes when it comes, and sends at its ticks.

    ``deck``: true poses of the robot; None: it stands.
    """

    def __init__(self, node: VehicleNode, deck: RealTimeDeck | None, grid: TickGrid) -> None:
        self.node, self._deck, self._grid = node, deck, grid
        self._deck_stale = False
        self._ms = 0  # simulated so far

    def tick(self, tick: int) -> None:
        """Send and write what is due at a tick, up to which it was simulated."""
        node, now_ns = self.node, self._grid.ns(tick)
        now_s = now_ns / 1e9
        self.receive()
        node.control(now_s)
        messages = node.autopilot.telemetry(now_s)
        if node.wire.sound:
            node.endpoint.send(messages)
        else:
            node.wire.send(messages, node.endpoint.peers, now_ns)
        truth = node.write_log(tick, now_ns)
        if self._deck is not None:
            for payload in self._deck.poll(now_s):
                node.log.target(now_ns, payload)
            state = self._deck.follow(truth.pad_position_enu_m, truth.pad_yaw_rad, now_s)
            if state is not None:
                node.move_deck(state)
            stale = self._deck.stale(now_s)
            if stale and not self._deck_stale:
                self.warn("Robot's pose too old: deck stopped")
            self._deck_stale = stale
        node.log.feed.flush()

    def receive(self) -> None:
        """Act on what has come, now."""
        node, now_s = self.node, self._ms * _MS
        now_ns = self._ms * _NS_PER_MS
        frames = node.wire.late(now_ns)
        for received in node.endpoint.receive():
            frames += node.wire.receive(received, now_ns)
        for received in frames:
            replies = node.answer(received, now_s)
            if replies and node.wire.sound:
                node.endpoint.send(replies, received.peer)
            elif replies:
                node.wire.send(replies, (received.peer,), now_ns)
        if frames:
            node.control(now_s)

    def advance_to(self, ms: int) -> None:
        """Simulate up to a time."""
        if ms > self._ms:
            self.node.vehicle.advance(ms - self._ms)
            self._ms = ms

    def warn(self, text: str) -> None:
        """Send a warning to the clients, as a text of the autopilot."""
        self.node.autopilot.flight.say(dialect.MAV_SEVERITY_WARNING, text)


class RealTimeLoop:
    """Runs ticks until the end.

    ``vehicles``: at least one; ``grid``: of the ticks; ``stop``: ends the process; ``room``: what happens
    between the vehicles.
    """

    def __init__(self, vehicles: Sequence[RealTimeVehicle], grid: TickGrid, stop: Stop, room: Room) -> None:
        self._vehicles, self._grid, self._stop, self._room = vehicles, grid, stop, room
        self._start_s, self._epoch_ns = 0.0, 0

    def run(self, ticks: int | None) -> None:
        """Simulate. ``ticks``: number of ticks; None: no end."""
        vehicles, grid, room = self._vehicles, self._grid, self._room
        run_promptly()  # like a real vehicle, the physics must not wait for other programs
        self._start_s = time.monotonic()
        self._set_epoch(time.time_ns())  # making the vehicle took a while
        tick = 0
        while not self._stop.is_set and tick != ticks:
            deadline_s = self._start_s + grid.ns(tick) / 1e9
            while (left_s := deadline_s - time.monotonic()) > 0.0 and not self._stop.is_set:
                for vehicle in self._heard(left_s):
                    since_start_ms = int((time.monotonic() - self._start_s) / _MS)
                    vehicle.advance_to(min(since_start_ms, grid.ms(tick)))
                    vehicle.receive()
            self._resync_clock(time.monotonic() - deadline_s)
            for vehicle in vehicles:
                vehicle.advance_to(grid.ms(tick))
            if tick > 0:
                room.end(tick - 1, self._epoch_ns)
            room.begin()
            for vehicle in vehicles:
                vehicle.tick(tick)
            tick += 1
        if tick > 1:
            room.write(tick - 2, self._epoch_ns)

    def _heard(self, within_s: float) -> Sequence[RealTimeVehicle]:
        """Vehicles with received frames; empty if none arrived in this time."""
        if len(self._vehicles) == 1:
            return self._vehicles if self._vehicles[0].node.endpoint.wait(within_s) else ()
        by_number = {vehicle.node.endpoint.fileno(): vehicle for vehicle in self._vehicles}
        ready, _, _ = select.select(list(by_number), (), (), within_s)
        return [by_number[number] for number in ready]

    def _set_epoch(self, epoch_ns: int) -> None:
        self._epoch_ns = epoch_ns
        for vehicle in self._vehicles:
            vehicle.node.log.epoch_ns = epoch_ns

    def _resync_clock(self, late_s: float) -> None:
        """After a long pause go on from here: simulated time stood still, the log's clock moves."""
        if late_s > _BEHIND_MAX_S:
            give_up_priority()
            self._start_s += late_s
            self._set_epoch(self._epoch_ns + round(late_s * 1e9))
            for vehicle in self._vehicles:
                vehicle.warn(f"Machine paused {late_s:.2f} s: simulation too")


def vehicle_main(team: TeamScenario, options: VehicleOptions) -> int:
    """Run the vehicles until SIGTERM, SIGINT or ``duration_s``; prints ``ready URL ...``, cf1's first.

    Prints ``armed`` and ``disarmed``, too, whenever that changes; of several vehicles with the name.

    ``team``: everything that is not chance; ``options``: a port that is not 0 is that of cf1, and the others
    follow; system id and namespace are those of a vehicle that is alone, members of a team have their own.
    Returns exit status: 0 in order, 1 when something it needs did not come, 2 for wrong input.
    """
    stop = Stop()
    try:
        with ExitStack() as stack:
            _fly(team, options, stop, stack)
    except ValueError as error:
        print(f"vehicle: {error}", file=sys.stderr)
        return 2
    except (OSError, zenoh_link.ZenohLinkError, FeedError, NoAnswerError) as error:
        print(f"vehicle: {error}", file=sys.stderr)
        return 1
    return 0


def _fly(team: TeamScenario, options: VehicleOptions, stop: Stop, stack: ExitStack) -> None:
    lockstep, grid = options.lockstep, TickGrid(options.rate_hz)
    here = _here(team, options)
    endpoints = [opened(options, number, system_id, stack) for number, system_id, _, _ in here]
    session = joined(options, stack)
    if session is None and not team.is_alone:
        raise ValueError("vehicles of a team follow robots on Zenoh; --connect, --listen or --zenoh-config")
    warm_up_room(team)
    simulated = [VehicleSim(scenario, seed) for _, _, scenario, seed in here]
    epoch_ns = EPOCH_NS if lockstep else time.time_ns()
    feed = Feed.connect(options.recorder, "vehicle", lossless=lockstep, vehicles=len(here))
    stack.callback(feed.close)
    members = []
    for (number, system_id, _, _), (endpoint, _), vehicle in zip(here, endpoints, simulated, strict=True):
        names = team.names(number)
        name = names.member or options.namespace
        log = VehicleLog(feed, epoch_ns, name, names)
        autopilot = autopilot_of(vehicle, options, system_id, epoch_ns)
        node = VehicleNode(vehicle, autopilot, endpoint, log, _teller(names.member))
        members.append(Member(number, name, node))
    room, ticks = Room(members, grid, feed), grid.count(options.duration_s)
    stop.install()
    print("ready", *(url for _, url in endpoints), flush=True)
    quiet_garbage_collector()
    if not lockstep:
        decks = [RealTimeDeck(session, each.name) if session is not None else None for each in members]
        vehicles = [RealTimeVehicle(each.node, deck, grid) for each, deck in zip(members, decks, strict=True)]
        RealTimeLoop(vehicles, grid, stop, room).run(ticks)
        return
    radios_s = [scenario.vehicle.setpoint_delay_s for _, _, scenario, _ in here]
    if session is None or team.is_alone:
        deck = LockstepDeck(session, members[0].name) if session is not None else None
        LockstepLoop(members[0].node, deck, grid, stop, radios_s[0]).run(ticks)
        return
    in_step = [
        LockstepMember(member, session, grid, stop, radio_s)
        for member, radio_s in zip(members, radios_s, strict=True)
    ]
    TeamLockstep(in_step, room, Words(team, options.seed), stop, epoch_ns).run(ticks)
    feed.flush()
    while not stop.is_set:  # the parent process ends this one
        time.sleep(_PAUSE_S)


def _here(team: TeamScenario, options: VehicleOptions) -> list[tuple[int, int, Scenario, int]]:
    """Number, system id, scenario and seed of each vehicle that is simulated here."""
    if options.leave_out and team.is_alone:
        raise ValueError("--leave-out is for a scenario of several vehicles: this one has no members")
    if options.leave_out and options.lockstep:
        raise ValueError(
            "--leave-out is for real time: a vehicle from elsewhere does not wait for the others"
        )
    here = [
        (number, options.system_id if team.is_alone else number, scenario, seed)
        for number, (scenario, seed) in enumerate(team.singles(options.seed), 1)
        if number not in options.leave_out
    ]
    if not here:
        raise ValueError("--leave-out leaves no vehicle; the scenario of one of them simulates it alone")
    return here


def opened(options: VehicleOptions, number: int, system_id: int, stack: ExitStack) -> tuple[Endpoint, str]:
    """Open the MAVLink endpoint of a vehicle; returns it, and the URL with the port that it has.

    ``options``: its URL is that of the first vehicle; ``number``: of the vehicle, from 1; ``stack``: closes
    it.
    Raises ValueError: options that exclude each other, or an URL that is not understood; OSError: the address
    cannot be bound.
    """
    kind, host, port = parse_udp_url(options.url, "the simulated vehicle")
    port += number - 1 if port else 0
    if options.lockstep and options.peers:
        raise ValueError("--peer is for real time: in lockstep the companion calls first")
    mine = f"{kind}:{host}:{port}"
    endpoint = open_endpoint("vehicle", mine, system_id, COMPONENT_ID, options, options.peers)
    stack.callback(_close, endpoint)
    return endpoint, f"{kind}:{host}:{endpoint.local_port if kind == 'udpin' else port}"


def joined(options: VehicleOptions, stack: ExitStack) -> zenoh_link.Session | None:
    """Open the Zenoh session on which the robots are; None without endpoints."""
    if not (options.connect or options.listen or options.zenoh_config is not None):
        return None
    session = zenoh_link.open_session(
        options.listen,
        options.connect,
        config_file=options.zenoh_config,
        prompt=not options.lockstep,
        lockstep=options.lockstep,
    )
    stack.callback(session.close)
    return session


def autopilot_of(vehicle: VehicleSim, options: VehicleOptions, system_id: int, epoch_ns: int) -> Autopilot:
    """Make the autopilot of a vehicle, with its parameters; ``epoch_ns`` is the Unix time of tick 0."""
    autopilot = Autopilot(
        vehicle,
        options.rate_hz,
        system_id=system_id,
        epoch_ns=epoch_ns,
        trim_enu_m_s=vehicle.trim_velocity_enu_m_s,
    )
    for name, value in options.parameters.items():
        autopilot.parameters.preset(name, value)
    return autopilot


def _teller(name: str) -> Callable[[bool], None]:
    """Prints whether a vehicle is armed, for the process that started this one and may end it."""

    def tell(armed: bool) -> None:
        print(f"{'armed' if armed else 'disarmed'} {name}".strip(), flush=True)

    return tell


def _close(endpoint: Endpoint) -> None:
    dropped = endpoint.counters.dropped()
    if dropped:
        print(f"vehicle: MAVLink not let through: {dropped}", file=sys.stderr)
    endpoint.close()
