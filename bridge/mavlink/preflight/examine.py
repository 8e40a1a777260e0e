"""Before a flight: reads and checks a vehicle's parameters in bounded time; writes none."""

from __future__ import annotations

import math
import struct
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.companion import companion_heartbeat, request_message
from bridge.mavlink.client.senders import Senders, why_silent
from bridge.mavlink.codec.messages import Message, parameter_name
from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.preflight import table as rules
from bridge.mavlink.preflight.table import Asked, Choice, Finding, Level, Needs, Release
from bridge.mavlink.profiles import OWN_SITL, Encoding, Profile, found, marked, refusal

_HELLO_S = 0.2  # time between heartbeats before the first message of the vehicle, s
_HEARTBEAT_S = 1.0
_VERSION_S = 0.5  # time between two requests of the version, s
_VERSION_TRIES = 12  # number of requests of the version; a busy line of 57,600 baud loses most replies
_SAY_S = 2.0  # time between two texts about the wait, s
_VOLTAGE_UNKNOWN = 0xFFFF  # value in mV of an unknown voltage, MAVLink SYS_STATUS.voltage_battery
_SLICE_S = 0.02  # time between two polls, s
_READ_MAX_S = 30.0  # time limit of the check after the first message of the vehicle, s

_AT_ONCE = 5  # maximum number of parameter requests without a reply; a radio has a small buffer
_READ_PERIOD_S = 0.4  # time between two requests of a parameter, s; autopilots reply within 0.05 s on a wire
_READ_TRIES = 5
_READ_TRIES_LOSSY = 15  # number of requests of a parameter after a lost reply, for a busy line
_FLOAT = struct.Struct("<f")
# Layout of the float field that carries an integer bytewise.
_BYTES: Mapping[int, struct.Struct] = {
    dialect.MAV_PARAM_TYPE_UINT8: struct.Struct("<Bxxx"),
    dialect.MAV_PARAM_TYPE_INT8: struct.Struct("<bxxx"),
    dialect.MAV_PARAM_TYPE_UINT16: struct.Struct("<Hxx"),
    dialect.MAV_PARAM_TYPE_INT16: struct.Struct("<hxx"),
    dialect.MAV_PARAM_TYPE_UINT32: struct.Struct("<I"),
    dialect.MAV_PARAM_TYPE_INT32: struct.Struct("<i"),
    dialect.MAV_PARAM_TYPE_REAL32: _FLOAT,
}
_ERRORS = {number: entry.name.removeprefix("MAV_PARAM_ERROR_") for number, entry in
           dialect.enums["MAV_PARAM_ERROR"].items()}  # fmt: skip


class ParameterReader:
    """Reads parameters by name (mavlink.io, services/parameter); the number of tries is limited.

    A parameter without a reply is listed as missing, with the reason. After a lost reply more tries are made.
    """

    def __init__(
        self, names: Iterable[str], target_system: int, target_component: int, encoding: Encoding
    ) -> None:
        self.values: dict[str, float] = {}  # received values by name
        self.missing: dict[str, str] = {}  # reasons why parameters are missing, by name
        self._open = list(dict.fromkeys(names))
        self._target = (target_system, target_component)
        self._encoding = encoding
        self._tries = dict.fromkeys(self._open, 0)
        self._asked_s = dict.fromkeys(self._open, -math.inf)
        self._tries_max = _READ_TRIES

    @property
    def done(self) -> bool:
        return not self._open

    def take(self, message: Message) -> None:
        """Handle a message of the vehicle; ignore messages that answer no request."""
        kind = message.get_msgId()
        if kind == dialect.MAVLINK_MSG_ID_PARAM_VALUE:
            self._value(message)
        elif kind == dialect.MAVLINK_MSG_ID_PARAM_ERROR:
            name = parameter_name(message.param_id)
            if name in self._open:
                self._close(name, f"refused: {_ERRORS.get(message.error, f'error {message.error}')}")

    def step(self, now_s: float) -> list[Message]:
        """Return the requests to send now; list parameters without a reply as missing."""
        most, waited = self._tries_max, [n for n in self._open if now_s - self._asked_s[n] >= _READ_PERIOD_S]
        for name in [name for name in waited if self._tries[name] >= most]:
            self._close(name, f"no answer to {most} requests in {most * _READ_PERIOD_S:g} s")
        due = [name for name in self._open[:_AT_ONCE] if name in waited]
        for name in due:
            self._tries[name] += 1
            self._asked_s[name] = now_s
        return [dialect.MAVLink_param_request_read_message(*self._target, name.encode(), -1) for name in due]

    def _value(self, message: Message) -> None:
        name = parameter_name(message.param_id)
        if name not in self._open:
            return
        value = self._decoded(message.param_value, message.param_type)
        if value is None or not math.isfinite(value):
            self._close(name, f"not a number: {message.param_value} of type {message.param_type}")
            return
        if self._tries[name] > 1:
            self._tries_max = _READ_TRIES_LOSSY
        self.values[name] = value
        self._open.remove(name)

    def _decoded(self, wire: float, type_: int) -> float | None:
        if self._encoding is Encoding.C_CAST:
            return wire
        struct_ = _BYTES.get(type_)
        return float(struct_.unpack(_FLOAT.pack(wire))[0]) if struct_ is not None else None

    def _close(self, name: str, why: str) -> None:
        self.missing[name] = why
        self._open.remove(name)


@dataclass(frozen=True, slots=True)
class Report:
    profile: Profile | None  # profile of the autopilot; None: not recognised
    version: str | None  # release of the autopilot; None: not received
    findings: tuple[Finding, ...]  # findings, one per rule; empty if the check ended early
    problem: str | None  # reason besides parameters that forbids the flight, or None
    notes: tuple[str, ...] = ()  # information about the release for the operator
    rules: str | None = None  # release whose rules were used; None: no rules
    # required and measured rates of a serial line; None: the link is not serial
    line: str | None = None
    rest_v: float | None = None  # battery voltage before arming; None: armed, or not received

    @property
    def blocking(self) -> tuple[Finding, ...]:
        return tuple(finding for finding in self.findings if finding.level is Level.UNSAFE)

    @property
    def safe(self) -> bool:
        return self.problem is None and not self.blocking


class Dialogue:
    """Sends heartbeats and requests to one vehicle on the ground, and takes its messages."""

    def __init__(self, endpoint: Endpoint, system_id: int, senders: Senders) -> None:
        self.endpoint, self.target, self.senders = endpoint, (system_id, 1), senders
        self.heard = self.armed = False  # whether a heartbeat of the vehicle arrived; whether it is armed
        self.foreign = Counter[tuple[int, int]]()
        self._beat_s = -math.inf

    def take(self, message: Message) -> None:
        """Handle a message of the vehicle's autopilot."""

    def turn(self, requests: Sequence[Message] = ()) -> None:
        """Send a due heartbeat and the requests, wait briefly, and handle the received messages."""
        now_s, messages = time.monotonic(), [*requests]
        if now_s - self._beat_s >= (_HEARTBEAT_S if self.heard else _HELLO_S):
            self._beat_s = now_s
            messages.insert(0, companion_heartbeat())
        self.endpoint.send(messages, self.senders.known)
        self.endpoint.wait(_SLICE_S)
        for received in self.endpoint.receive():
            message = received.message
            if received.sender != self.target:
                self.foreign[received.sender] += 1
            elif self.senders.admits(message, received.peer, now_s, armed=self.armed):
                if message.get_msgId() == dialect.MAVLINK_MSG_ID_HEARTBEAT:
                    self.heard = True
                    self.armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
                self.take(message)

    def until(
        self, done: Callable[[], bool], within_s: float, requests: Callable[[], Sequence[Message]] = tuple
    ) -> bool:
        """Exchange messages until ``done`` or for a time; return whether it is done."""
        until_s = time.monotonic() + within_s
        while not done():
            if time.monotonic() >= until_s:
                return False
            self.turn(requests())
        return True


class _EndedError(Exception):
    """The check ends without findings; the text is the reason."""


class Examination(Dialogue):
    """Check of one vehicle; it consumes the messages of its endpoint.

    ``chosen``: configured profile, None: the heartbeat selects it; ``senders``: stores the vehicle's address
    for the flight; ``stopped``: returns True to end the check early; ``say``: receives a text about the wait
    every two seconds.
    """

    profile: Profile | None = None  # None before the first heartbeat
    release: Release | None = None
    refused: str | None = None
    rest_v: float | None = None
    asked: tuple[Asked, ...] = ()
    reader: ParameterReader | None = None

    def __init__(
        self, endpoint: Endpoint, system_id: int, chosen: Profile | None = None,
        senders: Senders | None = None, stopped: Callable[[], bool] = lambda: False,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:  # fmt: skip
        super().__init__(endpoint, system_id, senders or Senders())
        self._chosen, self._stopped, self._say = chosen, stopped, say
        self._said_s = self._until_s = time.monotonic()
        self._counted: Counter[str] = Counter()
        self._grown: Counter[str] = Counter()  # last increase of the counters by received data

    def report(
        self, needs: Needs, accepted: Collection[str], *, wait_s: float, accept_release: bool = False
    ) -> Report:
        """Read firmware version and parameters, and judge them.

        ``accepted``: names of accepted parameters; ``wait_s``: time-out of the first heartbeat;
        ``accept_release``: allow an unknown release, with the nearest rules.
        """
        try:
            choice, reader = self._read(wait_s, accept_release)
        except _EndedError as ended:
            return Report(self.profile, self.version, (), str(ended))
        findings = tuple(rules.judge(self.asked, reader.values, reader.missing, needs, accepted))
        notes = (choice.note,) if choice.note is not None else ()
        return Report(
            self.profile, self.version, findings, choice.problem, notes, choice.release, rest_v=self.rest_v
        )

    def _read(self, wait_s: float, accept_release: bool) -> tuple[Choice, ParameterReader]:
        self._until_s = time.monotonic() + wait_s
        if not self.until(lambda: self.profile is not None, wait_s) or self.profile is None:
            raise _EndedError(self.waits_for(f" within {wait_s:g} s"))
        self._until_s = time.monotonic() + _READ_MAX_S
        for _ in range(_VERSION_TRIES):
            number, unset = dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION, self.profile.unset
            self.turn([request_message(self.target, number, unset)])
            if self.until(lambda: self.release is not None, _VERSION_S):
                break
        profile, table, choice = self.profile, rules.table(self.profile.name), Choice(None, None, None)
        if table is not None:
            tried = f"{_VERSION_TRIES} requests within {_VERSION_TRIES * _VERSION_S:g} s"
            silence = f"no AUTOPILOT_VERSION in reply to {tried}"
            choice = rules.choose(table, self.release, silence, accept=accept_release)
            if profile is OWN_SITL:  # the rules of this profile do not depend on the release
                choice = Choice(table.releases[-1], None, None)
            self.asked = table.asked(profile.name, choice.release or "")
        names = (each.name.name for each in self.asked)
        reader = self.reader = ParameterReader(names, *self.target, profile.encoding)
        self.until(
            lambda: reader.done and not self.senders.suspects,
            self._until_s - time.monotonic(),
            lambda: reader.step(time.monotonic()),
        )
        return choice, reader

    @property
    def version(self) -> str | None:
        return self.release.text if self.release is not None else None

    def turn(self, requests: Sequence[Message] = ()) -> None:
        if self._stopped():
            raise _EndedError("cancelled by the operator")
        now_s = time.monotonic()
        if now_s - self._said_s >= _SAY_S:
            self._said_s = now_s
            self._say(f"waiting up to {self._until_s - now_s:.0f} s more: {self.waits_for()}")
        super().turn(requests)
        problem = self.refused or self.senders.doubled
        if problem is not None:
            raise _EndedError(problem)

    def waits_for(self, time: str = "") -> str:
        """Return a text about the message that has not arrived yet; ``time``: see ``why_silent``."""
        if not self.heard:
            counted = self._counted
            self._counted = self.endpoint.counters.copy()
            grown = self._counted - counted
            if grown.keys() - {"sent", "bytes_out", "send_errors"}:
                self._grown = grown
            return why_silent(self.target[0], self._grown, self.foreign, time=time)
        if self.reader is None:
            return "the vehicle does not send its version (AUTOPILOT_VERSION)"
        names = [each.name.name for each in self.asked]
        known = self.reader.values.keys() | self.reader.missing.keys()
        left = [name for name in names if name not in known]
        return f"{len(known)} of {len(names)} parameters received; missing are {', '.join(left[:4])}"

    def take(self, message: Message) -> None:
        kind = message.get_msgId()
        if kind == dialect.MAVLINK_MSG_ID_SYS_STATUS:
            known = message.voltage_battery != _VOLTAGE_UNKNOWN and not self.armed
            self.rest_v = message.voltage_battery * 1e-3 if known else None
        elif kind == dialect.MAVLINK_MSG_ID_HEARTBEAT and self.profile is None and self.refused is None:
            self.refused = refusal(message.autopilot, message.type, self._chosen)
            if self.refused is None:
                self.profile = self._chosen or found(message.autopilot)
        elif self.reader is not None:
            self.reader.take(message)
        elif kind == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION and self.profile is not None:
            self.release, own = rules.release_of(message), marked(message)
            if own is not None and own.autopilot == self.profile.autopilot:
                self.profile = own
