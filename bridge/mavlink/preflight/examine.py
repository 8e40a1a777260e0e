"""Identifies a vehicle and reads its parameters before a flight, in bounded time; writes no parameter."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.companion import companion_heartbeat, request_message
from bridge.mavlink.client.senders import Arrivals, Senders, why_silent
from bridge.mavlink.codec.messages import Message, parameter_name
from bridge.mavlink.endpoint import Endpoint, LinkCounters
from bridge.mavlink.preflight.table import (
    Asked,
    Choice,
    Finding,
    Level,
    Needs,
    Release,
    choose,
    judge,
    release_of,
)
from bridge.mavlink.preflight.table import table as table_of
from bridge.mavlink.profiles import OWN_SITL, Encoding, Profile, found, marked, refusal

_HELLO_S = 0.2  # time between heartbeats before the first message of the vehicle, s
_HEARTBEAT_S = 1.0
_VERSION_S = 0.5  # time between two tries, s
_VERSION_TRIES = 12  # number of tries; a busy line of 57,600 baud loses most replies
_VERSION_TRIES_UNNEEDED = 4  # number of tries for a vehicle whose rules do not depend on the release
_SAY_S = 2.0  # time between two texts about the wait, s
_VOLTAGE_UNKNOWN = 0xFFFF  # value in mV of an unknown voltage, MAVLink SYS_STATUS.voltage_battery
_SLICE_S = 0.02  # time between two polls, s
_READ_MAX_S = 30.0  # time limit of the check after the first message of the vehicle, s


_AT_ONCE = 5  # number of pending requests; a radio has a small buffer
_READ_PERIOD_S = 0.4  # time between two tries, s; PX4 and ArduPilot reply within 0.05 s on a wire
_READ_TRIES = 5
_READ_TRIES_LOSSY = 15  # number of tries after a lost reply: a busy line of 57,600 baud loses most replies
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
        most = self._tries_max
        for name in [n for n in self._open if self._tries[n] >= most and self._waited(n, now_s)]:
            self._close(name, f"no answer to {most} requests in {most * _READ_PERIOD_S:g} s")
        due = [name for name in self._open[:_AT_ONCE] if self._waited(name, now_s)]
        for name in due:
            self._tries[name] += 1
            self._asked_s[name] = now_s
        return [dialect.MAVLink_param_request_read_message(*self._target, name.encode(), -1) for name in due]

    def _waited(self, name: str, now_s: float) -> bool:
        return now_s - self._asked_s[name] >= _READ_PERIOD_S

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


def examine(
    endpoint: Endpoint,
    system_id: int,
    chosen: Profile | None,
    needs: Needs,
    accepted: Collection[str],
    *,
    wait_s: float,
    accept_release: bool = False,
    stopped: Callable[[], bool] = lambda: False,
    say: Callable[[str], None] = lambda _text: None,
    senders: Senders | None = None,
) -> Report:
    """Check the vehicle and return a report; the check consumes the messages of ``endpoint``.

    ``chosen``: configured profile, None: the heartbeat selects it; ``accepted``: names of accepted
    parameters; ``wait_s``: time-out of the first heartbeat; ``accept_release``: allow an unknown release,
    with the nearest rules; ``stopped``: returns True to end the check early; ``say``: receives a text about
    the wait every two seconds; ``senders``: stores the vehicle's address for the flight.
    """
    check = _Check(endpoint, system_id, chosen, senders or Senders(), accept_release=accept_release)
    began_s = time.monotonic()
    until_s = began_s + wait_s
    said_s = began_s
    heard = False
    while not check.over and not stopped():
        now_s = time.monotonic()
        if check.link.heard and not heard:
            heard, until_s = True, now_s + _READ_MAX_S
        if now_s >= until_s:
            break
        if now_s - said_s >= _SAY_S:
            said_s = now_s
            say(f"waiting up to {until_s - now_s:.0f} s more: {check.waits_for()}")
        check.turn(now_s)
    reader, profile = check.reader, check.profile
    if stopped():
        return Report(profile, check.version, (), "cancelled by the operator")
    if check.refused is not None:
        return Report(profile, check.version, (), check.refused)
    if profile is None or reader is None:
        return Report(None, None, (), check.waits_for(f" within {wait_s:g} s"))
    findings = tuple(judge(check.asked, reader.values, reader.missing, needs, accepted))
    rules, problem, note = check.choice or (None, None, None)
    notes = (note,) if note is not None else ()
    return Report(profile, check.version, findings, problem, notes, rules, rest_v=check.rest_v)


class Dialogue:
    """Sends heartbeats and requests to one vehicle on the ground, and takes its messages."""

    def __init__(
        self, endpoint: Endpoint, system_id: int, take: Callable[[Message], None], senders: Senders
    ) -> None:
        """``take`` receives each message of the vehicle's autopilot."""
        self.endpoint, self.target, self.senders = endpoint, (system_id, 1), senders
        self.heard = self.armed = False  # whether a heartbeat of the vehicle arrived; whether it is armed
        self.foreign = LinkCounters()
        self._take, self._said_s = take, -math.inf

    def turn(self, requests: Sequence[Message] = ()) -> None:
        """Send a due heartbeat and the requests, wait briefly, and handle the received messages."""
        now_s, messages = time.monotonic(), [*requests]
        if now_s - self._said_s >= (_HEARTBEAT_S if self.heard else _HELLO_S):
            self._said_s = now_s
            messages.insert(0, companion_heartbeat())
        self.endpoint.send(messages, self.senders.known)
        self.endpoint.wait(_SLICE_S)
        for received in self.endpoint.receive():
            message = received.message
            if received.sender != self.target:
                self.foreign.add_foreign(received.sender)
            elif self.senders.admits(message, received.peer, now_s, armed=self.armed):
                if message.get_msgId() == dialect.MAVLINK_MSG_ID_HEARTBEAT:
                    self.heard = True
                    self.armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
                self._take(message)


class _Check:
    def __init__(
        self, endpoint: Endpoint, system_id: int, chosen: Profile | None, senders: Senders, *,
        accept_release: bool,
    ) -> None:  # fmt: skip
        self.link = Dialogue(endpoint, system_id, self._take, senders)
        self._chosen, self._accept_release = chosen, accept_release
        self.profile: Profile | None = None
        self._release: Release | None = None
        self.choice: Choice | None = None
        self.refused: str | None = None
        self.reader: ParameterReader | None = None
        self.asked: tuple[Asked, ...] = ()
        self.rest_v: float | None = None
        self._version_s = -math.inf
        self._version_tries = 0
        self._version_over = False
        self._arrivals = Arrivals()
        self._grown: Mapping[str, int] = {}  # last increase of the counters by received data

    @property
    def version(self) -> str | None:
        return self._release.text if self._release is not None else None

    @property
    def over(self) -> bool:
        read = self.reader is not None and self.reader.done
        return self.refused is not None or (read and not self.link.senders.suspects)

    def waits_for(self, time: str = "") -> str:
        """Return a text about the message that has not arrived yet; ``time``: see ``why_silent``."""
        link = self.link
        if not link.heard:
            grown = self._arrivals.grown(link.endpoint.counters)
            if grown.keys() - {"sent", "bytes_out", "send_errors"}:
                self._grown = grown
            return why_silent(link.target[0], self._grown, link.foreign.senders, time=time)
        if self.reader is None:
            return "the vehicle does not send its version (AUTOPILOT_VERSION)"
        names = [each.name.name for each in self.asked]
        known = self.reader.values.keys() | self.reader.missing.keys()
        left = [name for name in names if name not in known]
        return f"{len(known)} of {len(names)} parameters received; missing are {', '.join(left[:4])}"

    def turn(self, now_s: float) -> None:
        """Send due requests, wait briefly, handle the received messages."""
        self.link.turn(self._ask(self.profile, now_s) if self.profile is not None else ())
        self.refused = self.refused or self.link.senders.doubled

    def _ask(self, profile: Profile, now_s: float) -> list[Message]:
        if self._version_over and self.reader is None:
            self._choose(profile)
            names = (each.name.name for each in self.asked)
            self.reader = ParameterReader(names, *self.link.target, profile.encoding)
        if self.reader is not None:
            return self.reader.step(now_s)
        if now_s - self._version_s < _VERSION_S:
            return []
        if self._version_tries >= _tries(profile):
            self._version_over = True
            return []
        self._version_s = now_s
        self._version_tries += 1
        return [request_message(self.link.target, dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION, profile.unset)]

    def _choose(self, profile: Profile) -> None:
        """Choose the rules; for this project's vehicles they do not depend on the release."""
        table = table_of(profile.name)
        if table is None:
            return
        if profile is OWN_SITL:
            self.choice = Choice(table.releases[-1], None, None)
        else:
            tries = self._version_tries
            silence = f"no AUTOPILOT_VERSION in reply to {tries} requests within {tries * _VERSION_S:g} s"
            self.choice = choose(table, self._release, silence, accept=self._accept_release)
        self.asked = table.asked(profile.name, self.choice.release)

    def _take(self, message: Message) -> None:
        kind = message.get_msgId()
        if kind == dialect.MAVLINK_MSG_ID_SYS_STATUS:
            known = message.voltage_battery != _VOLTAGE_UNKNOWN and not self.link.armed
            self.rest_v = message.voltage_battery * 1e-3 if known else None
        elif kind == dialect.MAVLINK_MSG_ID_HEARTBEAT and self.profile is None and self.refused is None:
            self.refused = refusal(message.autopilot, message.type, self._chosen)
            if self.refused is None:
                self.profile = self._chosen or found(message.autopilot)
        elif kind == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION and not self._version_over:
            self._release, self._version_over = release_of(message), True
            own = marked(message)
            if own is not None and self.profile is not None and own.autopilot == self.profile.autopilot:
                self.profile = own
        elif self.reader is not None:
            self.reader.take(message)


def _tries(profile: Profile) -> int:
    unneeded = profile is OWN_SITL or table_of(profile.name) is None
    return _VERSION_TRIES_UNNEEDED if unneeded else _VERSION_TRIES
