"""MAVLink commands: COMMAND_LONG and COMMAND_INT in, acknowledgement out.

Every command may come again, since an acknowledgement can be lost and MAVSDK does not count its repeats:
a command whose effect is there already is ACCEPTED. A parameter that is NaN means "the default". ACCEPTED
means "valid, and being done"; nothing is ever IN_PROGRESS. Only arming may be acknowledged later, when its
result is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.decoding import Message
from bridge.mavlink.server.owner import Right, Sender
from bridge.mavlink.server.profile import ServerProfile
from bridge.mavlink.server.texts import Texts
from flightstack.core.types import Vec3

ACCEPTED: int = dialect.MAV_RESULT_ACCEPTED
REJECTED: int = dialect.MAV_RESULT_TEMPORARILY_REJECTED
DENIED: int = dialect.MAV_RESULT_DENIED
UNSUPPORTED: int = dialect.MAV_RESULT_UNSUPPORTED
FAILED: int = dialect.MAV_RESULT_FAILED

_WAITING_MAX = 8  # senders that wait for an acknowledgement
_INT32_MAX = 2**31 - 1
_INT_NAN = 0x7FF80000  # how a careless client's NaN looks as an integer (PX4 mavlink_receiver.cpp)
_INT_SCALE = 1e-7  # COMMAND_INT carries degrees times 1e7
# Frames of COMMAND_INT in which z is above sea level, or above home. That of COMMAND_LONG is in the profile.
_AMSL_FRAMES = frozenset({dialect.MAV_FRAME_GLOBAL, dialect.MAV_FRAME_GLOBAL_INT})
_HOME_FRAMES = frozenset({dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT})


@dataclass(frozen=True, slots=True)
class Command:
    """COMMAND_LONG and COMMAND_INT in one form; ``params[0]`` is param1."""

    number: int  # MAV_CMD
    params: tuple[float, float, float, float, float, float, float]
    sender: Sender
    now_s: float
    frame: int = dialect.MAV_FRAME_GLOBAL

    def given(self, n: int) -> float | None:
        """Parameter n (from 1), None when it was left out."""
        value = self.params[n - 1]
        return None if math.isnan(value) else value

    @property
    def above_home(self) -> bool:
        """Whether param7 counts from home instead of from sea level."""
        return self.frame in _HOME_FRAMES

    def local_z_m(self, height_m: float, home_enu_m: Vec3) -> float:
        """Local height of a height in this command; local heights count from sea level."""
        return height_m + (home_enu_m[2] if self.above_home else 0.0)

    @property
    def frame_known(self) -> bool:
        """Whether a place in this frame can be understood."""
        return self.frame in _HOME_FRAMES or self.frame in _AMSL_FRAMES


class Answer(NamedTuple):
    """Result of a command."""

    result: int = ACCEPTED  # MAV_RESULT
    reason: str | None = None  # said when it was refused
    messages: tuple[Message, ...] = ()  # for the sender, after the acknowledgement
    later: bool = False  # the result is not known yet; acknowledged by ``Commands.finish``


class Reply(NamedTuple):
    """An acknowledgement that comes later than its command."""

    sender: Sender
    message: Message


def answer(reason: str | None, result: int = REJECTED) -> Answer:
    """ACCEPTED without a reason, else refused."""
    return Answer() if reason is None else Answer(result, reason)


class Entry(NamedTuple):
    """One line of the command table."""

    run: Callable[[Command], Answer]
    right: Right  # who may, while somebody has control
    place: bool = False  # has a position or height: the frame of COMMAND_INT matters
    right_of: Callable[[Command], Right] | None = None  # when it depends on the parameters


Table = Mapping[int, Entry]


def read_command(
    message: Any, sender: Sender, now_s: float, long_frame: int = dialect.MAV_FRAME_GLOBAL
) -> Command | None:
    """Bring a COMMAND_LONG or COMMAND_INT into one form; None if its numbers are no numbers."""
    m = message
    if m.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_INT:
        if m.x == m.y == _INT_NAN:
            return None
        params = (m.param1, m.param2, m.param3, m.param4, _degrees(m.x), _degrees(m.y), m.z)
        frame = m.frame
    else:
        params = (m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7)
        frame = long_frame
        if abs(m.param5) >= _INT32_MAX or abs(m.param6) >= _INT32_MAX:
            return None
    if any(map(math.isinf, params)):
        return None
    return Command(m.command, params, sender, now_s, frame)


def integer(value: float | None) -> int | None:
    """A parameter that is a whole number, None if it is not."""
    return int(value) if value is not None and value == int(value) else None


class Commands:
    """Runs the commands of a table, and says why one is refused."""

    def __init__(
        self,
        table: Table,
        texts: Texts,
        forbids: Callable[[Sender, Right, float], str | None],
        profile: ServerProfile,
    ) -> None:
        """Set up.

        Args:
            table: MAV_CMD to its handler.
            texts: for reasons of refusals.
            forbids: why a sender may not use a right now.
            profile: has the result of a refusal, and the frame of COMMAND_LONG.
        """
        self.table = table
        self._texts = texts
        self._forbids = forbids
        self._profile = profile
        self._waiting: list[tuple[int, Sender]] = []  # command and sender

    def run(self, message: Message, sender: Sender, now_s: float) -> list[Message]:
        """Run a command; returns the acknowledgement and the messages that it asked for."""
        result, reason, messages, later = self._run(message, sender, now_s)
        if reason is not None:
            entry = self.table.get(message.command)
            # A ground station asks for many things and does without them: its pilot need not be told.
            question = entry is not None and entry.right is Right.ANYBODY
            severity = dialect.MAV_SEVERITY_DEBUG if question else dialect.MAV_SEVERITY_WARNING
            self._texts.refuse(reason, now_s, severity=severity)
        if later:
            waits = (message.command, sender)
            if waits not in self._waiting and len(self._waiting) < _WAITING_MAX:
                self._waiting.append(waits)
            return []
        return [self._acknowledge(message.command, result, sender), *messages]

    def finish(self, result: int) -> list[Reply]:
        """Acknowledge the commands whose result was not known: MAV_RESULT of all of them."""
        waiting, self._waiting = sorted(self._waiting), []
        return [Reply(to, self._acknowledge(number, result, to)) for number, to in waiting]

    def _acknowledge(self, number: int, result: int, sender: Sender) -> Message:
        if result == REJECTED:
            result = self._profile.refused
        return dialect.MAVLink_command_ack_message(number, result, 0, 0, *sender)

    def _run(self, message: Message, sender: Sender, now_s: float) -> Answer:
        command = read_command(message, sender, now_s, self._profile.long_frame)
        if command is None:
            return Answer(DENIED, f"Command {message.command} denied: bad parameter")
        entry = self.table.get(command.number)
        if entry is None:
            return Answer(UNSUPPORTED, f"Command {command.number} is not supported")
        right = entry.right if entry.right_of is None else entry.right_of(command)
        forbidden = self._forbids(sender, right, now_s)
        if forbidden is not None:
            return Answer(REJECTED, f"Command {command.number} refused: {forbidden}")
        if entry.place and not command.frame_known:
            # PX4 ignores the frame, and would fly to another place than the one meant.
            return Answer(DENIED, f"Command {command.number} denied: frame {command.frame}, only global")
        return entry.run(command)


def _degrees(scaled: int) -> float:
    return math.nan if scaled == _INT32_MAX else scaled * _INT_SCALE
