"""Flies a landing in one process with a fault at a chosen moment, and simulates until the vehicle is down.

The vehicle's lockstep loop, its autopilot, the robot, the companion's link and ``Runner`` are those of a real
run (as in ``sim.runners.landing``); target samples are CDR bytes. When the companion ends, nothing more is
sent, as after the end of its process, but the simulation continues until the vehicle is down.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.link import VehicleLink
from bridge.mavlink.endpoint import Received
from bridge.target.odometry import RawSample
from flightstack.common.pacing import EPOCH_NS, Tick
from flightstack.core.controller import Outputs
from flightstack.core.memory import Memory
from flightstack.core.types import Operator, Phase, VehicleStatus
from flightstack.onboard.leaving import Ended
from flightstack.onboard.runner import Arrived, Taken, decoded
from logs.reader.flight_data import Truth
from sim.clock import TickGrid
from sim.plant.states import truth_row
from sim.robot import Deck, Sample
from sim.runners.landing import Companion
from sim.runners.log import Notes, Seen
from sim.runners.published_robot import odometry
from sim.runners.robot import DirectTarget, Ticks
from sim.scenarios.fault_spec import Fault
from sim.scenarios.scenario import Scenario

REST_S = 2.5  # simulated time after motors off, s; the verdict needs 2 s
WATCH_MAX_S = 30.0  # maximum time of the flight after the disturbance, s
CLIMB_M = 0.2  # height above the ground at which the vehicle counts as climbing

TIMESYNC: int = dialect.MAVLINK_MSG_ID_TIMESYNC
Mangle = Callable[[list[bytes], float], list[bytes]]  # (sent payloads, time in s) -> payloads that arrive


@dataclass(frozen=True)
class Flown:
    """Result of the flight; simulated times in s, NaN for events that did not occur."""

    seen: Seen  # the flight's data, as in a log
    disturbed_at_s: float  # start of the disturbance; all later times are relative to it
    noticed_s: float  # first of: start of HOLD, CLIMB or ABORT; start of a fail-safe
    down_s: float  # time at which the motors stopped for the last time
    failsafe_s: float  # time of the start of the autopilot's first fail-safe
    phases: tuple[Phase, ...]  # phases of the companion in the order of the flight

    @property
    def failsafe(self) -> bool:
        """Whether the autopilot started a fail-safe."""
        return not math.isnan(self.failsafe_s)

    @property
    def truth(self) -> Truth:
        return self.seen.truth

    @property
    def texts(self) -> tuple[str, ...]:
        return tuple(event.text for event in self.seen.events)


class _Target(DirectTarget):
    """Robot that serialises its samples as for Zenoh.

    The robot is simulated only up to the current tick, so that a fault starts at once.
    """

    def __init__(self, scenario: Scenario, seed: int, grid: TickGrid) -> None:
        self._measured: list[Sample] = []
        self.mangle: Mangle | None = None  # changes samples in transit; None: no change
        super().__init__(scenario, seed, grid)

    def take(self, tick: int) -> Deck:
        self._drive(tick)
        return super().take(tick)

    def _keep(self, new: Ticks) -> None:
        self._measured += new.samples.tolist()
        super()._keep(new)

    def samples(self, now_s: float) -> Arrived:
        """Return the odometry released since the last call, serialised and changed in transit."""
        due, self._measured = self._measured, []
        payloads = [odometry(EPOCH_NS + round(each[0] * 1e9), each[1:]) for each in due]
        if self.mangle is not None:
            payloads = self.mangle(payloads, now_s)
        return decoded([RawSample(payload) for payload in payloads], now_s)

    def fail(self, fault: Fault, now_ns: int) -> None:
        """Start a fault of the target's odometry."""
        self.faults.add([fault], now_ns)


class _Log(Notes):
    """Log that also records the time at which the motors stopped for the last time."""

    down_s, height_m = math.nan, 0.0

    def truth(self, tick: int, now_ns: int, values: Sequence[float]) -> None:
        super().truth(tick, now_ns, values)
        state = truth_row(values, now_ns)
        self.height_m = state.position_enu_m[2]
        if state.motors_running:
            self.down_s = math.nan
        elif not math.isfinite(self.down_s):
            self.down_s = 1e-9 * now_ns


class Flight(Companion):
    """A flight with a disturbance; faults of ``target`` and ``vehicle`` can start at any time."""

    robot_type, log_type = _Target, _Log

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        moment: Callable[[Flight], bool],
        disturb: Callable[[Flight], None],
    ) -> None:
        super().__init__(scenario, seed, on_step=lambda _tick, _out: None)
        self.asked = Operator.NONE  # request of the operator, which the next tick reads
        self.phases: list[Phase] = []
        self._moment, self._disturb = moment, disturb
        self._duration_s = scenario.duration_max_s
        self._now_s = 0.0
        self._disturbed_s = self._noticed_s = self._failsafe_s = math.nan
        self._ground_m = self.vehicle.estimate().position_enu_m[2]
        self._runner._ending = self
        self.ticks_max = TickGrid(scenario.onboard.loop.rate_hz).count(scenario.duration_max_s + WATCH_MAX_S)

    @property
    def phase(self) -> Phase:
        return self.controller.memory.phase

    @property
    def now_ns(self) -> int:
        return round(self.vehicle.time_s * 1e9)

    @property
    def climbing(self) -> bool:
        """Whether the vehicle is in the take-off and off the ground."""
        return self.phase is Phase.TAKEOFF and self.node.log.height_m > self._ground_m + CLIMB_M

    def fly(self) -> Flown:
        """Fly to the end. Raises RuntimeError: the moment of the disturbance did not occur."""
        self.node.begin()
        for tick in range(self.ticks_max):
            self.node.ask(tick)
            self.node.act(tick)
            if self._stop.is_set and not self.node.answered:
                break
        if not self._disturbed:
            raise RuntimeError(f"nothing was disturbed; phases {self.phases}")
        began_s, known = self._disturbed_s, (self._noticed_s, self._failsafe_s)
        noticed_s = min((s for s in known if not math.isnan(s)), default=math.nan)
        return Flown(
            self._notes.seen(), began_s, noticed_s - began_s, self.node.log.down_s - began_s,
            self._failsafe_s - began_s, tuple(self.phases),
        )  # fmt: skip

    @property
    def _disturbed(self) -> bool:
        return not math.isnan(self._disturbed_s)

    def _answer(self) -> None:
        if self.node.autopilot.flight.failsafe and self._disturbed and math.isnan(self._failsafe_s):
            self._failsafe_s = self._now_s
        if self._watched():
            self._stop.ask()
            return
        if self._over:
            self._answer_only()
            return
        self._over = self._runner.tick() is not None
        if not self._disturbed and self._moment(self):
            self._disturbed_s = self._now_s
            self._disturb(self)

    def operator(self, status: VehicleStatus | None, now_s: float) -> Operator:
        """Return the operator's request."""
        return self.asked

    def ended(self, out: Outputs, memory: Memory, status: VehicleStatus | None, now_s: float) -> Ended | None:
        """Return the end of the companion after its last tick or at its time limit (a kill), else None."""
        return Ended(out.phase, memory.reason, 1) if out.finished or now_s >= self._duration_s else None

    def write(self, tick: Tick, taken: Taken, out: Outputs, exec_s: float) -> None:
        super().write(tick, taken, out, exec_s)
        self._now_s = tick.now_s
        for text in taken.arrived.problems:
            self._notes.note(tick.now_s, 30, "onboard", text)
        if not self.phases or self.phases[-1] is not out.phase:
            self.phases.append(out.phase)
        given_up = out.phase in (Phase.HOLD, Phase.CLIMB, Phase.ABORT)
        if given_up and self._disturbed and math.isnan(self._noticed_s):
            self._noticed_s = tick.now_s

    def _watched(self) -> bool:
        """Whether the simulation may end, because the vehicle rests or the maximum time is over."""
        if not self._disturbed:
            return self._over
        down_s = self.vehicle.time_s - self.node.log.down_s
        rests = down_s > REST_S and (self._over or down_s > 2.0 * REST_S)
        return rests or self.vehicle.time_s - self._disturbed_s > WATCH_MAX_S

    def _answer_only(self) -> None:
        """Simulate a tick after the companion's end, when only the requests of the clock are answered."""
        endpoint = self._link.endpoint
        for received in endpoint.receive():
            if _is_request(received):
                endpoint.send([VehicleLink.timesync_reply(received.message.ts1)])
                self._now_s = received.message.ts1 / 1e9


def _is_request(received: Received) -> bool:
    return received.message.get_msgId() == TIMESYNC and received.message.tc1 == 0
