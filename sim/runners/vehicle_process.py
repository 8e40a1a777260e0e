"""The simulated vehicle as a process, and its loop in real time (``lockstep`` has the other one).

MAVLink is on one side, the robot's true pose on the other.
"""

from __future__ import annotations

import select
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.endpoint import Endpoint, parse_peer
from bridge.mavlink.signing.key import load_key
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
from sim.autopilot.autopilot import COMPONENT_ID, Autopilot
from sim.clock import NoAnswerError, TickGrid
from sim.runners.deck import LockstepDeck, RealTimeDeck
from sim.runners.lockstep import LockstepLoop
from sim.runners.log import VehicleLog
from sim.runners.options import VehicleOptions
from sim.runners.vehicle_node import VehicleNode
from sim.scenarios.scenario import Scenario
from sim.vehicle.vehicle import VehicleSim, warm_up

_BEHIND_MAX_S = 0.1  # s; after a longer pause of the machine, simulated time is put back instead of caught up
_MS = 1e-3
_NS_PER_MS = 1_000_000


class RealTimeVehicle:
    """One vehicle: acts on what comes when it comes, and sends at its ticks.

    Args:
        node: the vehicle.
        deck: true poses of its robot; None: it stands.
        grid: of the ticks.
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
        """Have the autopilot say something."""
        self.node.autopilot.flight.say(dialect.MAV_SEVERITY_WARNING, text)


class Between(Protocol):
    """What happens between several vehicles."""

    def begin(self) -> None:
        """Before a tick."""

    def end(self, tick: int, epoch_ns: int) -> None:
        """After a tick that all have flown; ``epoch_ns`` is the Unix time of tick 0."""

    def write(self, tick: int, epoch_ns: int) -> None:
        """When nothing follows; arguments as of ``end``."""


class RealTimeLoop:
    """Runs ticks until the end.

    Args:
        vehicles: one, or several.
        grid: of the ticks.
        stop: ends the process.
        between: what happens between the vehicles; None: nothing.
    """

    def __init__(
        self,
        vehicles: Sequence[RealTimeVehicle],
        grid: TickGrid,
        stop: Stop,
        between: Between | None = None,
    ) -> None:
        self._vehicles, self._grid, self._stop, self._between = vehicles, grid, stop, between
        self._start_s, self._epoch_ns = 0.0, 0

    def run(self, ticks: int | None) -> None:
        """Simulate.

        Args:
            ticks: how many; None for no end.
        """
        vehicles, grid, between = self._vehicles, self._grid, self._between
        run_promptly()  # a vehicle is nobody's ordinary process: its physics wait for no other program
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
            self._catch_breath(time.monotonic() - deadline_s)
            for vehicle in vehicles:
                vehicle.advance_to(grid.ms(tick))
            if between is not None:
                if tick > 0:
                    between.end(tick - 1, self._epoch_ns)
                between.begin()
            for vehicle in vehicles:
                vehicle.tick(tick)
            tick += 1
        if between is not None and tick > 1:
            between.write(tick - 2, self._epoch_ns)

    def _heard(self, within_s: float) -> Sequence[RealTimeVehicle]:
        """Vehicles for which something has come, or nobody when nothing came in this time."""
        if len(self._vehicles) == 1:
            return self._vehicles if self._vehicles[0].node.endpoint.wait(within_s) else ()
        by_number = {vehicle.node.endpoint.fileno(): vehicle for vehicle in self._vehicles}
        ready, _, _ = select.select(list(by_number), (), (), within_s)
        return [by_number[number] for number in ready]

    def _set_epoch(self, epoch_ns: int) -> None:
        self._epoch_ns = epoch_ns
        for vehicle in self._vehicles:
            vehicle.node.log.epoch_ns = epoch_ns

    def _catch_breath(self, late_s: float) -> None:
        """After a long pause go on from here: simulated time stood still, the log's clock moves."""
        if late_s > _BEHIND_MAX_S:
            give_up_priority()
            self._start_s += late_s
            self._set_epoch(self._epoch_ns + round(late_s * 1e9))
            for vehicle in self._vehicles:
                vehicle.warn(f"Machine paused {late_s:.2f} s: simulation too")


def vehicle_main(scenario: Scenario, options: VehicleOptions) -> int:
    """Run the vehicle until SIGTERM, SIGINT or ``duration_s``; prints ``ready URL`` when it can be reached.

    Prints ``armed`` and ``disarmed``, too, whenever that changes.

    Returns:
        Exit status: 0 in order, 1 when something it needs did not come, 2 for wrong input.
    """
    return served(lambda stop, stack: _fly(scenario, options, stop, stack))


def served(fly: Callable[[Stop, ExitStack], None]) -> int:
    """Call what flies; say what went wrong, and return the exit status, as ``vehicle_main`` has it.

    Args:
        fly: gets what ends it, and a stack for what it has to close.
    """
    stop = Stop()
    try:
        with ExitStack() as stack:
            fly(stop, stack)
    except ValueError as error:
        print(f"vehicle: {error}", file=sys.stderr)
        return 2
    except (OSError, zenoh_link.ZenohLinkError, FeedError, NoAnswerError) as error:
        print(f"vehicle: {error}", file=sys.stderr)
        return 1
    return 0


def _fly(scenario: Scenario, options: VehicleOptions, stop: Stop, stack: ExitStack) -> None:
    lockstep, rate_hz, namespace = options.lockstep, options.rate_hz, options.namespace
    if options.leave_out:
        raise ValueError("--leave-out is for a scenario of several vehicles: this one has no members")
    endpoint, url = opened(options, options.url, options.system_id, stack)
    session = joined(options, stack)
    warm_up(scenario)
    vehicle = VehicleSim(scenario, options.seed)
    epoch_ns = EPOCH_NS if lockstep else time.time_ns()
    feed = Feed.connect(options.recorder, "vehicle", lossless=lockstep)
    stack.callback(feed.close)
    autopilot = autopilot_of(vehicle, options, options.system_id, epoch_ns)
    node = VehicleNode(vehicle, autopilot, endpoint, VehicleLog(feed, epoch_ns, namespace), _tell)
    grid = TickGrid(rate_hz)
    loop: LockstepLoop | RealTimeLoop
    if lockstep:
        deck = LockstepDeck(session, namespace) if session is not None else None
        loop = LockstepLoop(node, deck, grid, stop, scenario.vehicle.setpoint_delay_s)
    else:
        follower = RealTimeDeck(session, namespace) if session is not None else None
        loop = RealTimeLoop([RealTimeVehicle(node, follower, grid)], grid, stop)
    stop.install()
    print(f"ready {url}", flush=True)
    quiet_garbage_collector()
    loop.run(grid.count(options.duration_s))


def opened(options: VehicleOptions, url: str, system_id: int, stack: ExitStack) -> tuple[Endpoint, str]:
    """Open the MAVLink endpoint of a vehicle; returns it, and the URL with the port that it has.

    Raises:
        ValueError: options that exclude each other, or an URL that is not understood.
        OSError: the address cannot be bound.
    """
    kind, host, port = parse_udp_url(url, "the simulated vehicle")
    if options.lockstep and options.peers:
        raise ValueError("--peer is for real time: in lockstep the companion calls first")
    endpoint = Endpoint(
        url,
        system_id,
        COMPONENT_ID,
        signing_key=load_key(options.signing_key) if options.signing_key else None,
        always=[parse_peer(peer) for peer in options.peers],
        allow_unsigned=options.allow_unsigned,
    )
    stack.callback(_close, endpoint)
    for warning in endpoint.warnings:
        print(f"vehicle: WARNING: {warning}", file=sys.stderr)
    return endpoint, f"{kind}:{host}:{endpoint.local_port if kind == 'udpin' else port}"


def joined(options: VehicleOptions, stack: ExitStack) -> zenoh_link.Session | None:
    """Open the Zenoh session on which the robots are; None without endpoints."""
    if not (options.connect or options.listen or options.zenoh_config is not None):
        return None
    session = zenoh_link.open_session(
        options.listen, options.connect, config_file=options.zenoh_config, prompt=not options.lockstep
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


def _tell(armed: bool) -> None:
    """For whoever started us: whether it may end us."""
    print("armed" if armed else "disarmed", flush=True)


def _close(endpoint: Endpoint) -> None:
    dropped = endpoint.counters.dropped()
    if dropped:
        print(f"vehicle: MAVLink not let through: {dropped}", file=sys.stderr)
    endpoint.close()
