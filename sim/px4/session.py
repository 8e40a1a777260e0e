"""Runs one PX4, from its first to its last message, in lockstep with the simulated vehicle.

Each step is 4 ms of simulated time: send the sensor readings, receive the motor outputs, advance the vehicle.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from flightstack.common.hangup import Stop
from flightstack.common.pacing import give_up_priority
from sim.clock import NoAnswerError
from sim.px4.airframe import rotor_speeds
from sim.px4.link import SLICE_S, LinkClosedError, Px4Link
from sim.px4.plant import STEP_MS, Px4Plant, Px4Sensors

_ARMED = dialect.MAV_MODE_FLAG_SAFETY_ARMED
_LOCKSTEP = 1  # bit of HIL_ACTUATOR_CONTROLS.flags that shows lockstep
FIRST_US = 1_000_000  # time of the first HIL_SENSOR; PX4 treats zero as "not set"


class Lockstep:
    """Matches answers to steps: call ``sent`` with every HIL_SENSOR, ``take`` with every answer."""

    def __init__(self) -> None:
        self.started = False  # whether PX4 has sent an answer
        self.old = 0  # number of ignored answers to an earlier HIL_SENSOR
        self.newest_us = -1  # time in the newest answer, us; -1: no answer yet
        # times that the answer to the last HIL_SENSOR may contain, us: newer PX4s subtract the first time
        self.expected_us: tuple[int, ...] = ()

    def sent(self, time_us: int) -> None:
        """Record that a HIL_SENSOR with this time was sent."""
        self.expected_us = time_us, time_us - FIRST_US

    def take(self, answer: Message) -> bool:
        """Whether a HIL_ACTUATOR_CONTROLS answers the last HIL_SENSOR, so that the simulation may step."""
        if not answer.flags & _LOCKSTEP:
            raise NoAnswerError(
                "PX4's HIL_ACTUATOR_CONTROLS has no lockstep flag: it was built without lockstep; "
                "build px4_sitl_default, not px4_sitl_nolockstep"
            )
        if not self.expected_us:
            return False
        self.started = True
        fresh = answer.time_usec > self.newest_us
        self.newest_us = max(self.newest_us, answer.time_usec)
        if fresh and answer.time_usec in self.expected_us:
            return True
        self.old += 1
        return False


STEP_US = STEP_MS * 1000
STEP_S = STEP_MS * 1e-3
HELLO_MAX_S = 10.0  # time-out of PX4's first message, s of wall time; PX4 sends this message on connection
BOOT_MAX_S = 60.0  # time-out of PX4's first motor outputs, s of wall time
NUDGE_S = 1.0  # wall time after which one step runs without an answer, s; PX4 may wait for a sensor
_BEHIND_MAX_S = 0.1  # delay above which simulated time does not catch up, s


class Px4Session:
    """Vehicle, sensors and the connection to one PX4.

    ``stop`` ends every wait. ``speed``: ratio of simulated to wall time; 0: as fast as PX4 replies.
    ``silent_max_s``: wall time without an answer after which PX4 counts as dead. ``tell``: called with each
    new state, for the launcher: connected, lockstep, armed or disarmed.
    """

    def __init__(
        self, link: Px4Link, plant: Px4Plant, sensors: Px4Sensors, stop: Stop, *, speed: float,
        silent_max_s: float, tell: Callable[[str], None],
    ) -> None:  # fmt: skip
        self._link, self.plant, self._sensors, self._stop = link, plant, sensors, stop
        self.lockstep = Lockstep()
        self._speed, self._silent_max_s, self._tell = speed, silent_max_s, tell
        self.steps = 0
        self.nudges = 0  # number of steps that ran without an answer
        self._armed = False
        self._start_s = self._connected_s = self._answered_s = time.monotonic()

    @property
    def time_us(self) -> int:  # time on PX4's clock
        return FIRST_US + self.steps * STEP_US

    def greet(self) -> None:
        """Wait for the first message; PX4 sends a heartbeat on connection."""
        until_s = time.monotonic() + HELLO_MAX_S
        while not self._stop.is_set:
            left_s = until_s - time.monotonic()
            if left_s <= 0.0:
                raise LinkClosedError(
                    f"a client said nothing that is MAVLink for {HELLO_MAX_S:g} s "
                    f"({self._link.garbage_bytes} other bytes): PX4 sends a HEARTBEAT at once; dropped"
                )
            messages = self._link.receive(min(left_s, SLICE_S))
            if messages:
                self._note(messages)
                self._tell("connected")
                self._start_s = self._connected_s = self._answered_s = time.monotonic()
                return

    def step(self) -> None:
        self._link.send(self._sensors.read(self.plant.body(), self.time_us))
        self.lockstep.sent(self.time_us)
        answer = self._wait() if self.lockstep.started else self._look()
        if answer is not None:
            self._drive(answer)
        self.plant.advance(STEP_MS)
        self.steps += 1
        self._pace()

    def _look(self) -> Message | None:
        """While PX4 starts in real time, return an answer that arrives before this step ends, or None."""
        until_s = self._start_s + (self.steps + 1) * STEP_S
        while not self._stop.is_set:
            left_s = until_s - time.monotonic()
            answer = self._note(self._link.receive(min(left_s, SLICE_S)))
            if self.lockstep.started:
                self._answered_s = time.monotonic()
                self._start_s = self._answered_s - self.steps * self._step_wall_s
                self._tell("lockstep")
                return answer if answer is not None else self._wait()
            if left_s <= 0.0:
                break
        if time.monotonic() - self._connected_s > BOOT_MAX_S:
            raise NoAnswerError(
                f"PX4 sent no HIL_ACTUATOR_CONTROLS in its first {BOOT_MAX_S:g} s: look at its console; its "
                "airframe needs PWM_MAIN_FUNC1 to 4 = 101 to 104 (docs/reference/px4_sim.md)"
            )
        return None

    def _wait(self) -> Message | None:
        """Wait for the answer to this step's HIL_SENSOR; None: run this step without an answer."""
        began_s = time.monotonic()
        while not self._stop.is_set:
            answer = self._note(self._link.receive(SLICE_S))
            now_s = time.monotonic()
            if answer is not None:
                self._answered_s = now_s
                return answer
            if now_s - self._answered_s > self._silent_max_s:
                raise NoAnswerError(self._silence(now_s - self._answered_s))
            if now_s - began_s > NUDGE_S:
                self.nudges += 1
                return None
        return None

    def _silence(self, for_s: float) -> str:
        lockstep = self.lockstep
        return (
            f"PX4 is silent: no HIL_ACTUATOR_CONTROLS for {for_s:.1f} s since the HIL_SENSOR at "
            f"{self.steps * STEP_S:.3f} s of simulated time; expected time_usec "
            f"{' or '.join(map(str, lockstep.expected_us))}, the newest answer has {lockstep.newest_us} "
            f"({lockstep.old} old ones). Is it stopped in a debugger, or hung?"
        )

    def _note(self, messages: Iterable[Message]) -> Message | None:
        """Process messages; return the newest answer to the last HIL_SENSOR, or None."""
        newest = None
        for message in messages:
            kind = message.get_type()
            if kind == "HIL_ACTUATOR_CONTROLS":
                if self.lockstep.take(message):
                    newest = message
            elif kind == "HEARTBEAT" and message.autopilot != dialect.MAV_AUTOPILOT_PX4:
                raise LinkClosedError(
                    f"a client is autopilot {message.autopilot} of MAV_AUTOPILOT, allowed is "
                    f"{dialect.MAV_AUTOPILOT_PX4} (PX4); dropped"
                )
        return newest

    def _drive(self, answer: Message) -> None:
        armed = bool(answer.mode & _ARMED)
        self.plant.wanted[:] = rotor_speeds(answer.controls, armed, self.plant.params.rotor)
        if armed is not self._armed:
            self._armed = armed
            self._tell("armed" if armed else "disarmed")

    @property
    def _step_wall_s(self) -> float:
        return STEP_S / self._speed if self._speed > 0.0 else 0.0

    def _pace(self) -> None:
        if self._speed <= 0.0 or not self.lockstep.started:
            return
        left_s = self._start_s + self.steps * self._step_wall_s - time.monotonic()
        if left_s > 0.0:
            time.sleep(left_s)
        elif left_s < -_BEHIND_MAX_S:
            self._start_s -= left_s
            give_up_priority()  # a simulation that is too slow must not block other programs
