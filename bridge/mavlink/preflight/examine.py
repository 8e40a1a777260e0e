"""Before a flight: reads and checks a vehicle's parameters, and sets its signing key, in bounded time.

The check writes no parameter.
"""

from __future__ import annotations

import math
import struct
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.companion import companion_heartbeat, request_message
from bridge.mavlink.client.senders import Senders, why_silent
from bridge.mavlink.codec.messages import Message
from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.preflight import table as rules
from bridge.mavlink.preflight.table import Asked, Choice, Finding, Level, Needs, Release
from bridge.mavlink.profiles import OWN_SITL, Profile, found, marked, refusal
from bridge.mavlink.signing import EPOCH_NS, KEY_BYTES, TICK_NS, SigningKey
from bridge.mavlink.transport.address import is_local, parse_url, resolve

_HELLO_S = 0.2  # time between heartbeats before the first message of the vehicle, s
_HEARTBEAT_S = 1.0
_VERSION_S = 0.5  # time between two requests of the version, s
_VERSION_TRIES = 12  # maximum number of version requests; a busy line of 57,600 baud loses most replies
_SAY_S = 2.0  # time between two texts about the wait, s
_VOLTAGE_UNKNOWN = 0xFFFF  # value in mV of an unknown voltage, MAVLink SYS_STATUS.voltage_battery
_SLICE_S = 0.02  # time between two polls, s
_COMPONENT_ID = 191  # component id MAV_COMP_ID_ONBOARD_COMPUTER
_KEY_PERIOD_S, _KEY_TRIES = 0.5, 12  # time between two tries to change a signing key, s; number of tries
_READ_MAX_S = 30.0  # time limit of the check after the first message of the vehicle, s

_AT_ONCE = 5  # maximum number of open parameter requests; the buffer of a radio is small
_READ_PERIOD_S = 0.4  # time between two requests of a parameter, s; autopilots reply within 0.05 s on a wire
_READ_TRIES = 5
_READ_TRIES_LOSSY = 15  # maximum number of requests of a parameter once a reply was lost on a busy line
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

    A parameter without a reply is listed as missing, with the reason. A lost reply allows more tries.
    """

    def __init__(self, names: Iterable[str], target: tuple[int, int], *, bytewise: bool) -> None:
        self.values: dict[str, float] = {}  # received values by name
        self.missing: dict[str, str] = {}  # reasons why parameters are missing, by name
        self._asked = dict.fromkeys(names, (0, -math.inf))  # number of tries, time of the newest try, by name
        self._target, self._bytewise = target, bytewise
        self._tries_max = _READ_TRIES

    @property
    def left(self) -> list[str]:
        """Names of the parameters that have no result yet."""
        return list(self._asked)

    @property
    def done(self) -> bool:
        return not self._asked

    def take(self, message: Message) -> None:
        """Handle a message of the vehicle; ignore messages that answer no request."""
        kind, name = message.get_msgId(), getattr(message, "param_id", "")
        if name not in self._asked:
            return
        if kind == dialect.MAVLINK_MSG_ID_PARAM_ERROR:
            self._close(name, f"refused: {_ERRORS.get(message.error, f'error {message.error}')}")
        elif kind == dialect.MAVLINK_MSG_ID_PARAM_VALUE:
            value = self._decoded(message.param_value, message.param_type)
            if value is None or not math.isfinite(value):
                self._close(name, f"not a number: {message.param_value} of type {message.param_type}")
                return
            if self._asked.pop(name)[0] > 1:
                self._tries_max = _READ_TRIES_LOSSY
            self.values[name] = value

    def step(self, now_s: float) -> list[Message]:
        """Return the requests to send now; list parameters without a reply as missing."""
        most, requests = self._tries_max, []
        waited = [name for name, (_, at_s) in self._asked.items() if now_s - at_s >= _READ_PERIOD_S]
        for name in waited:
            if self._asked[name][0] >= most:
                self._close(name, f"no answer to {most} requests in {most * _READ_PERIOD_S:g} s")
        for name in [name for name in self.left[:_AT_ONCE] if name in waited]:
            self._asked[name] = (self._asked[name][0] + 1, now_s)
            requests.append(dialect.MAVLink_param_request_read_message(*self._target, name.encode(), -1))
        return requests

    def _decoded(self, wire: float, type_: int) -> float | None:
        if not self._bytewise:
            return wire
        struct_ = _BYTES.get(type_)
        return float(struct_.unpack(_FLOAT.pack(wire))[0]) if struct_ is not None else None

    def _close(self, name: str, why: str) -> None:
        self.missing[name] = why
        del self._asked[name]


@dataclass(frozen=True, slots=True)
class Report:
    profile: Profile | None  # profile of the autopilot; None: not recognised
    version: str | None  # release of the autopilot; None: not received
    findings: tuple[Finding, ...]  # one finding per checked parameter; empty if the check ended early
    problem: str | None  # reason against the flight other than parameters, or None
    notes: tuple[str, ...] = ()  # texts for the operator about the release
    rules: str | None = None  # release whose rules were used; None: no rules
    # text with the required data rates of a serial line; None: the link is not serial
    line: str | None = None
    rest_v: float | None = None  # battery voltage before arming; None: armed, or not received

    @property
    def blocking(self) -> tuple[Finding, ...]:
        return tuple(finding for finding in self.findings if finding.level is Level.UNSAFE)

    @property
    def safe(self) -> bool:
        return self.problem is None and not self.blocking


class _EndedError(Exception):
    """The check ends without findings; the text is the reason."""


class Examination:
    """Check of one vehicle on the ground; the check consumes the messages of its endpoint.

    ``chosen``: configured profile, None: the heartbeat selects the profile; ``senders``: stores the vehicle's
    address for the flight; ``stopped``: returns True to end the check early; ``say``: receives a text about
    the wait every two seconds.
    """

    def __init__(
        self, endpoint: Endpoint, system_id: int, chosen: Profile | None = None,
        senders: Senders | None = None, stopped: Callable[[], bool] = lambda: False,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:  # fmt: skip
        self.endpoint, self.target, self._senders = endpoint, (system_id, 1), senders or Senders()
        self._chosen, self._stopped, self._say = chosen, stopped, say
        self._profile: Profile | None = None  # None before the first heartbeat
        self._release: Release | None = None
        self._reader: ParameterReader | None = None
        self._refused: str | None = None  # reason why the vehicle is not supported, or None
        self._rest_v: float | None = None
        self._armed = False
        self._foreign = Counter[tuple[int, int]]()
        self._beat_s = -math.inf
        self._said_s = self._until_s = time.monotonic()
        self._counted: Counter[str] = Counter()
        self._grown: Counter[str] = Counter()  # newest increments of the counters, if data arrived

    def report(
        self, needs: Needs, accepted: Collection[str], *, wait_s: float, accept_release: bool = False
    ) -> Report:
        """Read firmware version and parameters, and judge them.

        ``accepted``: names of accepted parameters; ``wait_s``: time-out of the first heartbeat;
        ``accept_release``: allow an unknown release, with the nearest rules.
        """
        findings, choice = list[Finding](), Choice(None, None, None)
        try:
            profile = self._recognised(wait_s)
            table, asked = rules.table(profile.name), tuple[Asked, ...]()
            if table is not None:
                tried = f"{_VERSION_TRIES} requests within {_VERSION_TRIES * _VERSION_S:g} s"
                silence = f"no AUTOPILOT_VERSION in reply to {tried}"
                choice = rules.choose(table, self._release, silence, accept=accept_release)
                if profile is OWN_SITL:  # the rules of this profile do not depend on the release
                    choice = Choice(table.releases[-1], None, None)
                asked = table.asked(profile.name, choice.release or "")
            names = (each.name.name for each in asked)
            reader = self._reader = ParameterReader(names, self.target, bytewise=profile.bytewise)
            self._exchange(
                lambda: reader.done and not self._senders.suspects,
                self._until_s,
                lambda: reader.step(time.monotonic()),
            )
            findings = rules.judge(asked, reader.values, reader.missing, needs, accepted)
        except _EndedError as ended:
            choice = Choice(None, str(ended), None)
        version, notes = self._release and self._release.text, (choice.note,) if choice.note else ()
        return Report(
            self._profile, version, tuple(findings), choice.problem, notes, choice.release,
            rest_v=self._rest_v,
        )  # fmt: skip

    def _recognised(self, wait_s: float) -> Profile:
        """Return the profile found from the heartbeat and, if received, AUTOPILOT_VERSION."""
        self._until_s = time.monotonic() + wait_s
        self._exchange(lambda: self._profile is not None, self._until_s)
        if self._profile is None:
            raise _EndedError(self._waits_for(f" within {wait_s:g} s"))
        self._until_s = time.monotonic() + _READ_MAX_S
        for _ in range(_VERSION_TRIES):
            number, unset = dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION, self._profile.unset
            self._turn([request_message(self.target, number, unset)])
            self._exchange(lambda: self._release is not None, time.monotonic() + _VERSION_S)
            if self._release is not None:
                break
        return self._profile

    def _exchange(
        self, done: Callable[[], bool], until_s: float, requests: Callable[[], Sequence[Message]] = tuple
    ) -> None:
        """Exchange messages until ``done`` returns True or the time is ``until_s``."""
        while not done() and time.monotonic() < until_s:
            self._turn(requests())

    def _turn(self, requests: Sequence[Message]) -> None:
        """Send a due heartbeat and the requests, wait briefly, and handle the received messages."""
        if self._stopped():
            raise _EndedError("cancelled by the operator")
        now_s, messages = time.monotonic(), [*requests]
        if now_s - self._said_s >= _SAY_S:
            self._said_s = now_s
            self._say(f"waiting up to {self._until_s - now_s:.0f} s more: {self._waits_for()}")
        if now_s - self._beat_s >= (_HELLO_S if self._profile is None else _HEARTBEAT_S):
            self._beat_s = now_s
            messages.insert(0, companion_heartbeat())
        self.endpoint.send(messages, self._senders.known)
        self.endpoint.wait(_SLICE_S)
        for received in self.endpoint.receive():
            if received.sender != self.target:
                self._foreign[received.sender] += 1
            elif self._senders.admits(received.message, received.peer, now_s, armed=self._armed):
                self._take(received.message)
        problem = self._refused or self._senders.doubled
        if problem is not None:
            raise _EndedError(problem)

    def _waits_for(self, time: str = "") -> str:
        """Return a text about the message that has not arrived yet; ``time``: see ``why_silent``."""
        if self._profile is None:
            counted, self._counted = self._counted, self.endpoint.counters.copy()
            grown = self._counted - counted
            if grown.keys() - {"sent", "bytes_out", "send_errors"}:
                self._grown = grown
            return why_silent(self.target[0], self._grown, self._foreign, time=time)
        if self._reader is None:
            return "the vehicle does not send its version (AUTOPILOT_VERSION)"
        left, known = self._reader.left, len(self._reader.values) + len(self._reader.missing)
        return f"{known} of {known + len(left)} parameters received; missing are {', '.join(left[:4])}"

    def _take(self, message: Message) -> None:
        """Handle a message of the vehicle's autopilot."""
        kind = message.get_msgId()
        if kind == dialect.MAVLINK_MSG_ID_SYS_STATUS:
            known = message.voltage_battery != _VOLTAGE_UNKNOWN and not self._armed
            self._rest_v = message.voltage_battery * 1e-3 if known else None
        elif kind == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            self._armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
            if self._profile is None:
                self._refused = refusal(message.autopilot, message.type, self._chosen)
                self._profile = self._chosen or found(message.autopilot)
        elif self._reader is not None:
            self._reader.take(message)
        elif kind == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION and self._profile is not None:
            self._release, own = rules.release_of(message), marked(message)
            if own is not None and own.autopilot == self._profile.autopilot:
                self._profile = own

    def set_key(self, key: SigningKey, *, remove: bool, wait_s: float) -> str | None:
        """Set or remove the vehicle's signing key; see ``provision``."""
        counters = self.endpoint.counters

        def changed() -> bool:
            """Whether received frames show the change: they are signed, or unsigned after a removal."""
            return bool(counters["unsigned"] if remove else counters["unchecked"])

        self._until_s = time.monotonic() + wait_s
        self._exchange(lambda: self._profile is not None or changed(), self._until_s)
        if self._profile is None:
            if changed():
                return "the vehicle does not sign: there is no key to remove"
            return f"no heartbeat of system {self.target[0]} within {wait_s:g} s"
        if self._armed:
            return "the vehicle is armed: its key can be changed on the ground only"
        if changed():
            return "the vehicle signs already: remove its key first, with that key (--remove-signing)"
        secret = bytes(KEY_BYTES) if remove else key.secret
        stamp = 0 if remove else (time.time_ns() - EPOCH_NS) // TICK_NS
        message = dialect.MAVLink_setup_signing_message(*self.target, list(secret), stamp)
        for _ in range(_KEY_TRIES):
            self._turn([message])
            self._exchange(changed, time.monotonic() + _KEY_PERIOD_S)
            if changed():
                return None
        what = "still signs" if remove else "does not sign"
        return (
            f"the vehicle {what} after {_KEY_TRIES} tries in {_KEY_TRIES * _KEY_PERIOD_S:g} s: PX4 accepts "
            "keys from 1.18 on, with an SD card; ArduPilot does not sign on USB"
        )


def provision(url: str, system_id: int, key: SigningKey, *, remove: bool, wait_s: float) -> str | None:
    """Set or remove the MAVLink signing key of a vehicle on the ground by SETUP_SIGNING.

    The key is sent unencrypted, so only a cable or loopback is allowed. PX4 1.18 and later accepts a first
    key in an unsigned message on any link; a key of zeros, in a message signed with the current key, ends
    signing. ArduPilot also accepts a key but never signs on its first USB link. Both reject a key if armed.

    ``key``: the new key, or the current key with ``remove``; ``wait_s``: time-out of the first heartbeat.
    Returns the reason of a failure; None: the frames of the vehicle confirm the change.
    """
    kind, host, port = parse_url(url)
    if kind != "serial" and not is_local(resolve(f"MAVLink URL {url!r}", host, port)):
        raise ValueError(
            f"{url!r} leads over a network, where the key could be read: set or remove it over a "
            "cable (serial:DEVICE) or loopback"
        )
    with closing(Endpoint(url, system_id, _COMPONENT_ID, signing_key=key if remove else None)) as endpoint:
        try:
            return Examination(endpoint, system_id).set_key(key, remove=remove, wait_s=wait_s)
        except _EndedError as ended:
            return str(ended)
