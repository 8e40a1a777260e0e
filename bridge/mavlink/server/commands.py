"""MAVLink commands: accepts COMMAND_LONG and COMMAND_INT, returns the acknowledgement.

Every command may be repeated, since an acknowledgement can be lost and MAVSDK does not count its repeats: a
command that already has its effect is ACCEPTED. A parameter NaN means "the default". ACCEPTED means "valid,
and in execution"; IN_PROGRESS is never sent. Only arming may be acknowledged later, when its result is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from bridge.mavlink.server.commander import Right, Sender
from bridge.mavlink.server.profile import FORCE, FlightMode, mode_of
from bridge.mavlink.server.telemetry import Builder, Snapshot, Streams, V

ACCEPTED: int = dialect.MAV_RESULT_ACCEPTED
REJECTED: int = dialect.MAV_RESULT_TEMPORARILY_REJECTED
DENIED: int = dialect.MAV_RESULT_DENIED
UNSUPPORTED: int = dialect.MAV_RESULT_UNSUPPORTED
FAILED: int = dialect.MAV_RESULT_FAILED

_WAITING_MAX = 8  # maximum number of commands whose acknowledgement is sent later
_INT32_MAX = 2**31 - 1
_INT_NAN = 0x7FF80000  # x and y of a faulty client that casts NaN to integers (PX4 mavlink_receiver.cpp)
_INT_SCALE = 1e-7  # degrees per unit of x and y in COMMAND_INT
# COMMAND_INT frames with z above sea level, and with z above home; COMMAND_LONG has z above sea level.
_AMSL_FRAMES = (dialect.MAV_FRAME_GLOBAL, dialect.MAV_FRAME_GLOBAL_INT)
_HOME_FRAMES = (dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
_CUSTOM_MODE = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED


@dataclass(frozen=True, slots=True)
class Command:
    """COMMAND_LONG and COMMAND_INT in one form; ``params[0]`` is param1."""

    number: int  # MAV_CMD number
    params: tuple[float, float, float, float, float, float, float]
    sender: Sender
    now_s: float
    frame: int = dialect.MAV_FRAME_GLOBAL

    def given(self, n: int) -> float | None:
        """Return parameter n (from 1); None if it was omitted."""
        value = self.params[n - 1]
        return None if math.isnan(value) else value


class Answer(NamedTuple):
    result: int = ACCEPTED  # MAV_RESULT number
    reason: str | None = None  # reason of a refusal
    messages: tuple[Message, ...] = ()  # messages for the sender after the acknowledgement
    later: bool = False  # the result is not known yet; ``Commands.finish`` sends the acknowledgement


class Reply(NamedTuple):
    sender: Sender
    message: Message


def answer(reason: str | None, result: int = REJECTED) -> Answer:
    """Return ACCEPTED if ``reason`` is None, else ``result`` with the reason."""
    return Answer() if reason is None else Answer(result, reason)


class Entry(NamedTuple):
    run: Callable[[Command], Answer]
    right: Right  # senders that may send the command while one sender has control
    place: bool = False  # the command has a position or height, so the frame of COMMAND_INT matters
    # function that returns the right for a command with these parameters; None: ``right`` applies
    right_of: Callable[[Command], Right] | None = None


Table = Mapping[int, Entry]


def read_command(message: Any, sender: Sender, now_s: float) -> Command | None:
    """Convert a COMMAND_LONG or COMMAND_INT into a ``Command``; None: a value is infinite or too large."""
    m = message
    if m.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_INT:
        if m.x == m.y == _INT_NAN:
            return None
        params = (m.param1, m.param2, m.param3, m.param4, _degrees(m.x), _degrees(m.y), m.z)
        frame = m.frame
    else:
        params = (m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7)
        frame = dialect.MAV_FRAME_GLOBAL
        if abs(m.param5) >= _INT32_MAX or abs(m.param6) >= _INT32_MAX:
            return None
    if any(map(math.isinf, params)):
        return None
    return Command(m.command, params, sender, now_s, frame)


def integer(value: float | None) -> int | None:
    """Return a parameter as an integer; None if it is omitted or not a whole number."""
    return int(value) if value is not None and value == int(value) else None


class Commands(Generic[V]):
    """Runs COMMAND_LONG and COMMAND_INT, and reports the reason of each refusal.

    This class has arming, modes, take-off, landing and message requests; ``own`` adds the commands of one
    vehicle. Results equal those of PX4's ``Commander.cpp``.
    """

    def __init__(
        self,
        vehicle: V,
        streams: Streams[V],
        builders: Mapping[int, Builder[V]],
        snapshot: Callable[[float], Snapshot[V] | None],
        own: Table,
    ) -> None:
        """``builders``: functions that make requestable messages, by id; ``own``: additional commands."""
        self._vehicle, self._streams = vehicle, streams
        self._builders, self._snapshot = builders, snapshot
        self._waiting: list[tuple[int, Sender]] = []  # commands without acknowledgement, and their senders
        m, anybody, owner = dialect, Right.ANYBODY, Right.OWNER
        self.table: Table = {
            m.MAV_CMD_NAV_LAND: Entry(self._land, anybody),
            m.MAV_CMD_NAV_TAKEOFF: Entry(self._take_off, owner, place=True),
            m.MAV_CMD_DO_SET_MODE: Entry(self._set_mode, owner, right_of=_right_to_mode),
            m.MAV_CMD_COMPONENT_ARM_DISARM: Entry(self._arm_disarm, owner, right_of=_right_to_arm),
            m.MAV_CMD_DO_FLIGHTTERMINATION: Entry(self._terminate, Right.OWNER_OR_GROUND),
            m.MAV_CMD_RUN_PREARM_CHECKS: Entry(self._prearm_checks, anybody),
            m.MAV_CMD_GET_MESSAGE_INTERVAL: Entry(self._interval, anybody),
            m.MAV_CMD_SET_MESSAGE_INTERVAL: Entry(self._interval, anybody, right_of=self._right_to_interval),
            m.MAV_CMD_REQUEST_MESSAGE: Entry(self._request_message, anybody),
            m.MAV_CMD_REQUEST_CAMERA_INFORMATION: Entry(lambda _: Answer(UNSUPPORTED, "No camera"), anybody),
            **own,
        }

    def run(self, message: Message, sender: Sender, now_s: float) -> list[Message]:
        """Run a command; return the acknowledgement and the requested messages."""
        result, reason, messages, later = self._run(message, sender, now_s)
        if reason is not None:
            entry = self.table.get(message.command)
            # No warning is sent for refused queries: a ground station requests many messages without need.
            question = entry is not None and entry.right is Right.ANYBODY
            severity = dialect.MAV_SEVERITY_DEBUG if question else dialect.MAV_SEVERITY_WARNING
            self._vehicle.texts.refuse(reason, now_s, severity=severity)
        if later:
            waits = (message.command, sender)
            if waits not in self._waiting and len(self._waiting) < _WAITING_MAX:
                self._waiting.append(waits)
            return []
        return [self._acknowledge(message.command, result, sender), *messages]

    def finish(self, result: int) -> list[Reply]:
        waiting, self._waiting = sorted(self._waiting), []
        return [Reply(to, self._acknowledge(number, result, to)) for number, to in waiting]

    def _acknowledge(self, number: int, result: int, sender: Sender) -> Message:
        return dialect.MAVLink_command_ack_message(number, result, 0, 0, *sender[:2])

    def _run(self, message: Message, sender: Sender, now_s: float) -> Answer:
        command = read_command(message, sender, now_s)
        if command is None:
            return Answer(DENIED, f"Command {message.command} denied: bad parameter")
        entry = self.table.get(command.number)
        if entry is None:
            return Answer(UNSUPPORTED, f"Command {command.number} is not supported")
        right = entry.right if entry.right_of is None else entry.right_of(command)
        forbidden = self._vehicle.forbids(sender, right, now_s)
        if forbidden is not None:
            return Answer(REJECTED, f"Command {command.number} refused: {forbidden}")
        if entry.place and command.frame not in (*_HOME_FRAMES, *_AMSL_FRAMES):
            # PX4 would ignore the frame and fly to a wrong place.
            return Answer(DENIED, f"Command {command.number} denied: frame {command.frame}, only global")
        return entry.run(command)

    def _arm_disarm(self, command: Command) -> Answer:
        arm, force = command.given(1), command.given(2)
        if arm is None or round(arm) not in (0, 1):
            return Answer(UNSUPPORTED, "Arm or disarm? param1 must be 0 or 1")
        if round(arm) == 0:
            return answer(self._vehicle.disarm(command.now_s, force=force == FORCE))
        reason = self._vehicle.arm(command.now_s)  # a forced arming must also pass all checks, as in PX4
        return answer(reason) if reason is not None else Answer(later=self._vehicle.arming)

    def _terminate(self, command: Command) -> Answer:
        if not (command.given(1) or 0.0) > 0.5:
            return Answer(DENIED, "Termination refused: param1 must be 1")
        return answer(self._vehicle.terminate(command.now_s), DENIED)

    def _take_off(self, command: Command) -> Answer:
        """Take off; the height counts from home, or from sea level, which is at local z = 0."""
        z_m, base_m = command.given(7), self._vehicle.home_enu_m[2] if command.frame in _HOME_FRAMES else 0.0
        return answer(self._vehicle.take_off(None if z_m is None else z_m + base_m, command.now_s))

    def _land(self, command: Command) -> Answer:
        return answer(self._vehicle.land(command.now_s))

    def _set_mode(self, command: Command) -> Answer:
        base, main, sub = command.given(1) or 0.0, command.given(2), command.given(3) or 0.0
        if not int(base) & _CUSTOM_MODE or main is None:
            return Answer(DENIED, "Mode refused: only custom modes")
        mode = mode_of(round(main), round(sub))
        if mode is None:
            known = ", ".join(each.value for each in FlightMode)
            return Answer(DENIED, f"Mode {round(main)}/{round(sub)} refused: only {known}")
        return answer(self._vehicle.set_mode(mode, command.now_s))

    def _prearm_checks(self, command: Command) -> Answer:
        if self._vehicle.armed:
            return Answer(REJECTED, "Checks refused: armed")
        for problem in self._vehicle.problems(command.now_s):
            self._vehicle.texts.refuse(f"Preflight fail: {problem}", command.now_s)
        return Answer()

    def _interval(self, command: Command) -> Answer:
        message_id, streams = integer(command.given(1)), self._streams
        if message_id is None or not streams.known(message_id):
            return Answer(FAILED, f"Message {message_id} has no rate to set")  # as in PX4, even for HEARTBEAT
        if command.number == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
            streams.set_interval(message_id, command.given(2) or 0.0, command.now_s)
            return Answer()
        interval_us = streams.interval_us(message_id)
        return Answer(messages=(dialect.MAVLink_message_interval_message(message_id, interval_us),))

    def _right_to_interval(self, command: Command) -> Right:
        """Return the right to set a rate: peers share all rates; only the sender in control may lower one."""
        rarer = self._streams.rarer(integer(command.given(1)), command.given(2) or 0.0)
        return Right.OWNER if rarer else Right.ANYBODY

    def _request_message(self, command: Command) -> Answer:
        message_id = integer(command.given(1))
        builder = self._builders.get(message_id) if message_id is not None else None
        if builder is None:
            # After ACCEPTED, QGroundControl would wait for this message without limit.
            return Answer(DENIED, f"Message {message_id} refused: there is none")
        snapshot = self._snapshot(command.now_s)
        if snapshot is None:
            return Answer(REJECTED, f"Message {message_id} refused: the state of the vehicle is not known")
        return Answer(messages=(builder(snapshot),))


def _degrees(scaled: int) -> float:
    return math.nan if scaled == _INT32_MAX else scaled * _INT_SCALE


def _right_to_mode(command: Command) -> Right:
    main, sub = command.given(2), command.given(3) or 0.0
    landing = main is not None and mode_of(round(main), round(sub)) is FlightMode.LAND
    return Right.ANYBODY if landing else Right.OWNER


def _right_to_arm(command: Command) -> Right:
    kill = command.given(1) is not None and round(command.params[0]) == 0 and command.given(2) == FORCE
    return Right.OWNER_OR_GROUND if kill else Right.OWNER
