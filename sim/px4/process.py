"""The process that simulates sensors and physics for PX4: TCP to PX4, Zenoh to the robot's true pose."""

from __future__ import annotations

import select
import socket
import sys
from contextlib import ExitStack
from functools import partial

from bridge.zenoh import zenoh_link
from flightstack.common.hangup import Stop
from flightstack.common.pacing import (
    FastClock,
    SimulationClock,
    ask_for_priority,
    give_up_priority,
    quiet_garbage_collector,
)
from logs.recorder.feed import Feed
from logs.schema import Names
from sim.clock import NS_PER_S, run_process
from sim.options import Px4SimOptions
from sim.px4.link import SLICE_S, LinkClosedError, Px4Link, parse_endpoint
from sim.px4.plant import STEP_MS, Px4Plant, Px4Sensors
from sim.px4.session import STEP_S, Px4Session
from sim.runners.log import VehicleLog
from sim.runners.published_robot import RealTimeDeck
from sim.scenarios.scenario import Scenario

_LOG_EVERY = 3  # steps between two logged true states: 83 Hz
_BEHIND_MAX_NS = 50_000_000  # maximum difference of log time and clock, ns; a larger one is corrected
_NS_PER_STEP = STEP_MS * 1_000_000


class Px4Node:
    """Moves the deck with the robot, and logs the true state."""

    def __init__(
        self, deck: RealTimeDeck | None, log: VehicleLog, clock: FastClock | SimulationClock, stop: Stop
    ) -> None:
        self.log = log
        self._clock, self._stop = clock, stop
        self._deck = deck
        self._deck_s = 0.0  # simulated time of all flights so far; the deck's clock must not jump back

    def serve(self, flight: Px4Session, link: Px4Link, duration_s: float | None) -> bool:
        """Serve one PX4 until it disconnects; return whether ``duration_s`` is over."""
        try:
            flight.greet()
            self.log.epoch_ns = self._clock.unix_ns()
            while not self._stop.is_set:
                if duration_s is not None and flight.steps * STEP_S >= duration_s:
                    return True
                self._before_step(flight)
                flight.step()
        except LinkClosedError as error:
            print(f"px4-sim: {error}; listening for the next one", file=sys.stderr)
        finally:
            link.close()
            self._deck_s += flight.steps * STEP_S
            garbage = link.garbage_bytes
            if flight.nudges or flight.lockstep.old or garbage:
                print(
                    f"px4-sim: {flight.steps} steps, {flight.nudges} without an answer, "
                    f"{flight.lockstep.old} old answers, {garbage} bytes that are no MAVLink",
                    file=sys.stderr,
                )
        return False

    def _before_step(self, flight: Px4Session) -> None:
        """Publish the simulated time; at 83 Hz log the true state and move the deck."""
        if isinstance(self._clock, SimulationClock):
            passed_ns = round(self._deck_s * NS_PER_S) + flight.steps * _NS_PER_STEP
            self._clock.advance(passed_ns, lambda: self._stop.is_set)
        if flight.steps % _LOG_EVERY:
            return
        now_ns = flight.steps * _NS_PER_STEP
        behind_ns = self._clock.unix_ns() - self.log.epoch_ns - now_ns
        if self._deck is not None and abs(behind_ns) > _BEHIND_MAX_NS:
            self.log.epoch_ns += behind_ns  # PX4's start or a busy machine has delayed this process
        self.log.truth(flight.steps // _LOG_EVERY, now_ns, flight.plant.truth_values())
        if self._deck is not None:
            now_s, log = self._deck_s + flight.steps * STEP_S, partial(self.log.target, now_ns)
            self._deck.move(flight.plant, now_s, log, _warn)
        self.log.feed.flush()


def _warn(text: str) -> None:
    print(f"px4-sim: WARNING: {text}", file=sys.stderr, flush=True)


def _tell(event: str, *, paced: bool) -> None:
    """Print an event; give a paced simulation priority over other programs while PX4 is armed."""
    print(event, flush=True)
    if paced:
        (ask_for_priority if event == "armed" else give_up_priority)()


def px4_sim_main(scenario: Scenario, options: Px4SimOptions) -> int:
    """Serve PX4 until SIGTERM, SIGINT or ``duration_s``; print ``ready tcp:HOST:PORT`` when PX4 can connect.

    Each PX4 that connects starts with the vehicle at the start position; PX4 does not reconnect, so a new
    connection is a new flight. Returns the exit status.
    """
    return run_process("px4-sim", partial(_run, scenario, options))


def _run(scenario: Scenario, options: Px4SimOptions, stop: Stop, stack: ExitStack) -> None:
    speed = options.speed
    host, port = parse_endpoint(options.tcp, allow_unsigned=options.allow_unsigned)
    with_robot = bool(options.connect or options.listen or options.zenoh_config is not None)
    if with_robot and speed == 0.0 and options.clock is None:
        raise ValueError(
            "speed is 0, as fast as PX4 answers: the deck follows a robot over Zenoh, which drives at a "
            "speed of its own; give --clock to both, or the speed of `target --speed`, or no Zenoh options"
        )
    Px4Plant(scenario, options.seed).advance(STEP_MS)  # checks the scenario and compiles the code
    session = None
    if with_robot:
        session = zenoh_link.open_session(
            options.listen, options.connect, config_file=options.zenoh_config, prompt=True
        )
        stack.callback(session.close)
    # a second PX4 waits until the first disconnects
    server = stack.enter_context(socket.create_server((host, port), backlog=1))
    feed = Feed.connect(options.recorder, "vehicle", lossless=False)
    stack.callback(feed.close)
    deck = RealTimeDeck(session, options.namespace) if session is not None else None
    # without a robot and at full speed no other process needs the simulated time
    paced = SimulationClock(options.clock) if options.clock is not None else FastClock(speed or 1.0)
    node = Px4Node(deck, VehicleLog(feed, paced.unix_ns(), Names(options.namespace, 1)), paced, stop)
    stop.install()
    print(f"ready tcp:{host}:{server.getsockname()[1]}", flush=True)
    quiet_garbage_collector()
    while not stop.is_set:
        if not select.select([server], [], [], SLICE_S)[0]:
            continue
        link, plant = Px4Link(server.accept()[0]), Px4Plant(scenario, options.seed)
        mocap = scenario.vehicle.mocap if options.mocap else None
        flight = Px4Session(
            link, plant, Px4Sensors(plant.params, plant.body(), options.seed, mocap), stop, speed=speed,
            silent_max_s=options.silent_max_s, tell=partial(_tell, paced=speed > 0.0),
        )  # fmt: skip
        if node.serve(flight, link, options.duration_s) or (options.once and flight.steps):
            break
