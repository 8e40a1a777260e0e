"""Runs one PX4, from its first to its last message, in lockstep with the simulated vehicle.

Each step is 4 ms of simulated time: send the sensor readings, receive the motor outputs, advance the vehicle.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from enum import Enum

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from flightstack.common.hangup import Stop
from sim.clock import NoAnswerError
from sim.px4.airframe import rotor_speeds
from sim.px4.link import SLICE_S, Px4Link
from sim.px4.plant import (
    HIL_STATE_QUATERNION,
    STEP_MS,
    Answer,
    Px4Mocap,
    Px4Plant,
    Px4Sensors,
    answer_of,
    hil_gps,
    hil_sensor,
    hil_state,
)

FIRST_US = 1_000_000  # time of the first HIL_SENSOR; PX4 treats zero as "not set"


class NoLockstepError(NoAnswerError):
    """PX4 was built without lockstep; its clock is the wall clock."""


class Lockstep:
    """Matches answers to steps: call ``sent`` with every HIL_SENSOR, ``take`` with every answer."""

    def __init__(self) -> None:
        self.started = False  # whether PX4 has sent an answer
        self.old = 0  # number of ignored answers to an earlier HIL_SENSOR
        self.newest_us = -1  # time in the newest answer, us; -1: no answer yet
        self._sent_us: int | None = None
        self._before_us = -1  # ``newest_us`` when the last HIL_SENSOR was sent
        self._behind_us = [0]  # accepted delays of PX4's clock: zero, or the time of the first HIL_SENSOR
        self._seen_us: int | None = None  # delay of PX4's clock at the last ``adopt``

    @property
    def expected_us(self) -> list[int]:
        """Return the times that the answer to the last HIL_SENSOR may contain, us."""
        sent_us = self._sent_us
        return [] if sent_us is None else [sent_us - behind_us for behind_us in self._behind_us]

    def sent(self, time_us: int) -> None:
        """Record that a HIL_SENSOR with this time was sent."""
        if self._sent_us is None:
            self._behind_us.append(time_us)
        self._sent_us = time_us
        self._before_us = self.newest_us

    def take(self, answer: Answer) -> bool:
        """Whether this answers the last HIL_SENSOR, so that the simulation may step."""
        if not answer.lockstep:
            raise NoLockstepError(
                "PX4's HIL_ACTUATOR_CONTROLS has no lockstep flag: it was built without lockstep; "
                "build px4_sitl_default, not px4_sitl_nolockstep"
            )
        if self._sent_us is None:
            return False
        self.started = True
        fresh = answer.time_us > self.newest_us
        self.newest_us = max(self.newest_us, answer.time_us)
        if fresh and answer.time_us in self.expected_us:
            return True
        self.old += 1
        return False

    def adopt(self) -> None:
        """After a long wait without an answer, accept another delay of PX4's clock on its second occurrence.

        The first occurrence may be a late answer to an earlier HIL_SENSOR.
        """
        behind_us = None
        if self._sent_us is not None and self.newest_us > self._before_us:
            behind_us = self._sent_us - self.newest_us
            if behind_us == self._seen_us:
                self._behind_us = [behind_us]
        self._seen_us = behind_us


STEP_US = STEP_MS * 1000
STEP_S = STEP_MS * 1e-3
HELLO_MAX_S = 10.0  # time-out of PX4's first message, s of wall time; PX4 sends it on connection
BOOT_MAX_S = 60.0  # time-out of PX4's first motor outputs, s of wall time
NUDGE_S = 1.0  # wall time after which one step runs without an answer, s; PX4 may wait for a sensor
STATE_MAX_US = 1_000_000  # maximum interval of HIL_STATE_QUATERNION; a longer interval turns the message off
_BEHIND_MAX_S = 0.1  # largest delay that simulated time catches up, s


class NotPx4Error(RuntimeError):
    """The client is not PX4; the message names it."""


class Event(Enum):
    """Events that are reported to the launcher."""

    CONNECTED = "connected"
    LOCKSTEP = "lockstep"
    ARMED = "armed"
    DISARMED = "disarmed"
    PAUSED = "the machine paused: simulation too"  # reported only at the first pause in a flight


class Px4Session:
    """Vehicle, sensors and the connection to one PX4.

    ``stop`` ends every wait. ``speed``: ratio of simulated to wall time; 0: as fast as PX4 replies.
    ``silent_max_s``: wall time without an answer after which PX4 counts as dead. ``tell``: called at every
    event. ``mocap``: source of poses, which replaces satellites.
    """

    def __init__(
        self,
        link: Px4Link,
        plant: Px4Plant,
        seed: int,
        stop: Stop,
        *,
        speed: float,
        silent_max_s: float,
        tell: Callable[[Event], None],
        mocap: Px4Mocap | None = None,
    ) -> None:
        self._link, self.plant, self._stop = link, plant, stop
        self._sensors = Px4Sensors(plant.params, plant.body(), seed)
        self._mocap = mocap
        self.lockstep = Lockstep()
        self._speed, self._silent_max_s, self._tell = speed, silent_max_s, tell
        self.steps = 0
        self.nudges = 0  # number of steps that ran without an answer
        self._armed = self._paused = False
        self._state_every_us = 0  # period of HIL_STATE_QUATERNION, us; 0: not requested
        self._state_due_us = 0
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
                raise NotPx4Error(
                    f"a client said nothing that is MAVLink for {HELLO_MAX_S:g} s "
                    f"({self._link.garbage_bytes} other bytes): PX4 sends a HEARTBEAT at once; dropped"
                )
            messages = self._link.receive(min(left_s, SLICE_S))
            if messages:
                self._note(messages)
                self._tell(Event.CONNECTED)
                self._start_s = self._connected_s = self._answered_s = time.monotonic()
                return

    def step(self) -> None:
        self._send()
        answer = self._wait() if self.lockstep.started else self._look()
        if answer is not None:
            self._drive(answer)
        self.plant.advance(STEP_MS)
        self.steps += 1
        self._pace()

    def _send(self) -> None:
        body, now_us = self.plant.body(), self.time_us
        readings = self._sensors.read(body)
        out: list[Message] = []
        if self._mocap is not None:
            out += self._mocap.poll(body, self.steps * STEP_US * 1000, now_us)
        elif readings.fix is not None:
            out.append(hil_gps(now_us, readings.fix))
        if self._state_every_us and now_us >= self._state_due_us:
            self._state_due_us = max(now_us, self._state_due_us + self._state_every_us)
            gravity = self.plant.params.contact.gravity_m_s2
            out.append(hil_state(now_us, body, readings.accel_frd_m_s2, gravity))
        out.append(hil_sensor(now_us, readings))  # sent last, because it advances PX4's clock
        self._link.send(out)
        self.lockstep.sent(now_us)

    def _look(self) -> Answer | None:
        """While PX4 starts in real time, return an answer that arrives before this step ends, or None."""
        until_s = self._start_s + (self.steps + 1) * STEP_S
        while not self._stop.is_set:
            left_s = until_s - time.monotonic()
            answer = self._note(self._link.receive(min(left_s, SLICE_S)))
            if self.lockstep.started:
                self._answered_s = time.monotonic()
                self._start_s = self._answered_s - self.steps * self._step_wall_s
                self._tell(Event.LOCKSTEP)
                return answer if answer is not None else self._wait()
            if left_s <= 0.0:
                break
        if time.monotonic() - self._connected_s > BOOT_MAX_S:
            raise NoAnswerError(
                f"PX4 sent no HIL_ACTUATOR_CONTROLS in its first {BOOT_MAX_S:g} s: look at its console; its "
                "airframe needs PWM_MAIN_FUNC1 to 4 = 101 to 104 (docs/reference/px4_sim.md)"
            )
        return None

    def _wait(self) -> Answer | None:
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
                self.lockstep.adopt()
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

    def _note(self, messages: Iterable[Message]) -> Answer | None:
        """Process messages; return the newest answer to the last HIL_SENSOR, or None."""
        newest = None
        for message in messages:
            kind = message.get_type()
            if kind == "HIL_ACTUATOR_CONTROLS":
                answer = answer_of(message)
                if self.lockstep.take(answer):
                    newest = answer
            elif kind == "HEARTBEAT" and message.autopilot != dialect.MAV_AUTOPILOT_PX4:
                raise NotPx4Error(
                    f"a client is autopilot {message.autopilot} of MAV_AUTOPILOT, allowed is "
                    f"{dialect.MAV_AUTOPILOT_PX4} (PX4); dropped"
                )
            elif kind == "COMMAND_LONG":
                self._command(message)
        return newest

    def _command(self, message: Message) -> None:
        """Handle SET_MESSAGE_INTERVAL, by which PX4 requests the true state; ignore other commands."""
        if message.command != dialect.MAV_CMD_SET_MESSAGE_INTERVAL or message.param1 != HIL_STATE_QUATERNION:
            return
        wanted_us = message.param2
        sane = 0.0 < wanted_us <= STATE_MAX_US
        self._state_every_us = max(STEP_US, round(wanted_us)) if sane else 0
        self._state_due_us = self.time_us

    def _drive(self, answer: Answer) -> None:
        self.plant.wanted[:] = rotor_speeds(answer.controls, answer.armed, self.plant.params.rotor)
        if answer.armed is not self._armed:
            self._armed, self._paused = answer.armed, False
            self._tell(Event.ARMED if answer.armed else Event.DISARMED)

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
            if self._armed and not self._paused:
                self._paused = True
                self._tell(Event.PAUSED)
