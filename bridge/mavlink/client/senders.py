"""Selects the frames of one vehicle by their ids and address, and explains why no frames arrive.

Ids do not identify a sender: a script or router with default ids, or a second vehicle, may use them, too. A
sender is an address with ids, and a heartbeat adds its kind (type and autopilot). While the known sender is
alive, frames that contradict it are ignored and counted; a notice follows whenever the count has doubled. A
frame that arrives a second time, over a slower path or a duplicating line, contains an outdated state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from bridge.mavlink.profiles import named
from bridge.mavlink.transport.address import Peer

SILENT_S = 2.5  # time without a frame after which the known sender counts as silent, s; heartbeats have 1 Hz
_APART_S = 0.5  # time for which frames of both addresses prove two senders, s; reordering is shorter
_GAP_MAX = 4  # maximum expected step of the sequence number (modulo 256): three lost frames
_STEADY = 8  # number of frames in a row with steps up to _GAP_MAX after which a larger step is suspicious
_AGAIN_S = 0.95  # time after which a repeated contradicting heartbeat is accepted, s: heartbeats have 1 Hz
_FRAMES = 200  # number of stored frames; below 256, so that their sequence numbers differ
_OTHERS_MAX = 8  # maximum number of other addresses; the oldest is replaced


class Kind(NamedTuple):
    type: int  # MAV_TYPE number of the heartbeat
    autopilot: int  # MAV_AUTOPILOT number of the heartbeat

    def __str__(self) -> str:
        return f"type {named('MAV_TYPE', self.type)}, autopilot {named('MAV_AUTOPILOT', self.autopilot)}"


@dataclass(slots=True)
class Senders:
    """Admits the frames of one vehicle. All times are on the caller's clock."""

    known: Peer | None = None  # address of the vehicle; None before its first frame
    ignored: int = 0  # number of rejected frames with the vehicle's ids
    doubled: str | None = None  # error text if two addresses send with the vehicle's ids; None: one address
    _now_s: float = -math.inf  # arrival time of the newest frame
    _known_s: float = -math.inf  # arrival time of the newest frame from the known address
    _kind: Kind | None = None
    _beat_s: float = -math.inf  # time of the known sender's newest frame after its first heartbeat, s
    _claims: tuple[int, int] | None = None  # base_mode and custom_mode of the last accepted heartbeat
    # base_mode and custom_mode, then first time, of a heartbeat that is not accepted yet
    _doubted: tuple[tuple[int, int], float] | None = None
    _sequence: int = 0  # sequence number of the newest frame of the known sender
    _steady: int = 0  # number of the known sender's newest frames with steps up to _GAP_MAX
    _number: int = -1  # sequence number of the newest frame that was compared with ``_newest``
    _newest: dict[tuple[int, int, int], None] = field(default_factory=dict)  # newest frames, oldest first
    # times, s, of the first and of the newest frame of other addresses that use the vehicle's ids
    _others: dict[Peer, tuple[float, float]] = field(default_factory=dict)
    _due: int = 1  # count of ignored frames at which the next notice is due
    _notices: list[str] = field(default_factory=list)

    def begin(self, now_s: float) -> None:
        """Change to a new clock; the known sender remains and counts as received at ``now_s``."""
        if self._kind is not None:
            self._beat_s = now_s
        self.ignored, self._due, self._now_s, self._known_s = 0, 1, now_s, -math.inf
        self._others.clear()

    @property
    def suspects(self) -> bool:
        """Whether another address has sent recently: there may be a second vehicle, so arming is blocked."""
        return any(self._now_s - last_s <= SILENT_S for _, last_s in self._others.values())

    def take_notices(self) -> list[str]:
        """Return the texts for the operator since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def admits(self, message: Message, peer: Peer, now_s: float, *, armed: bool) -> bool:
        """Whether a frame with the vehicle's ids comes from the vehicle.

        A heartbeat from another address replaces a silent sender; in flight only a heartbeat of the same kind
        does. So a radio that restarts behind another port is accepted, but a second vehicle is not.
        """
        self._now_s = now_s
        if self.known is None:
            self.known = peer
        if peer == self.known and self._repeats(message):
            return False
        beats = message.get_msgId() == dialect.MAVLINK_MSG_ID_HEARTBEAT
        kind = Kind(message.type, message.autopilot) if beats else None
        well = now_s - self._beat_s <= SILENT_S
        fits = kind is not None and (self._kind is None or kind == self._kind or not (well or armed))
        if peer == self.known:
            self._known_s = now_s
            if kind is None:
                self._count(message.get_header().seq)
                if well:  # any frame counts, since heartbeats may be lost
                    self._beat_s = now_s
                return True
            if fits and self._believed(message, now_s, well=well):
                self._kind, self._beat_s = kind, now_s
                return True
        elif kind is not None and fits and not well:
            self._move(peer, now_s)
            self._kind, self._beat_s = kind, now_s
            return True
        else:
            self._note(peer, now_s, well=well)
        self._ignore(message, kind, peer)
        return False

    def _repeats(self, message: Message) -> bool:
        """Whether a frame of the known sender is a repetition; never for TIMESYNC, which lockstep repeats."""
        header, newest = message.get_header(), self._newest
        frame = (header.seq, header.msgId, message.get_crc())
        # a message without a checksum was never on a wire; some senders never change the sequence number
        if header.msgId == dialect.MAVLINK_MSG_ID_TIMESYNC or frame[2] is None or header.seq == self._number:
            return False
        self._number = header.seq
        if frame in newest:
            return True
        newest[frame] = None
        if len(newest) > _FRAMES:
            del newest[next(iter(newest))]
        return False

    def _believed(self, heartbeat: Message, now_s: float, *, well: bool) -> bool:
        """Whether a heartbeat belongs to the known stream.

        A heartbeat that has new content and does not continue the sequence numbers must be repeated 0.95 s
        later, without other content in between: frames added by a router have their own sequence numbers.
        """
        claims = (heartbeat.base_mode, heartbeat.custom_mode)
        number = heartbeat.get_header().seq
        strange = self._steady >= _STEADY and (number - self._sequence) % 256 > _GAP_MAX
        if well and strange and claims != self._claims:
            if self._doubted is None or self._doubted[0] != claims:
                self._doubted = (claims, now_s)
            if now_s - self._doubted[1] < _AGAIN_S:
                return False
        self._count(number)
        self._claims, self._doubted = claims, None
        return True

    def _count(self, number: int) -> None:
        """Record a sequence number; streams with many gaps, as behind a filtering router, are not checked."""
        self._steady = self._steady + 1 if (number - self._sequence) % 256 <= _GAP_MAX else 0
        self._sequence = number

    def _note(self, peer: Peer, now_s: float, *, well: bool) -> None:
        """Record a frame from another address; there are two senders if both addresses send for some time."""
        first_s, last_s = self._others.get(peer, (now_s, -math.inf))
        if now_s - last_s > SILENT_S:
            first_s = now_s
            if len(self._others) >= _OTHERS_MAX:
                del self._others[next(iter(self._others))]
        self._others[peer] = (first_s, now_s)
        if well and self._known_s - first_s >= _APART_S and self.known is not None:
            self.doubled = (
                f"two senders have the vehicle's ids: {_at(self.known)} and {_at(peer)}; stop one of them, "
                "or give it another system id (PX4 MAV_SYS_ID, ArduPilot MAV_SYSID or SYSID_THISMAV), which "
                "--system-id names"
            )

    def _move(self, peer: Peer, now_s: float) -> None:
        if self._kind is not None and self.known is not None:
            self._notices.append(
                f"the vehicle sends from {_at(peer)} now; {_at(self.known)} has been silent for "
                f"{now_s - self._beat_s:.1f} s"
            )
        self.known, self.doubled = peer, None
        self._claims = self._doubted = None
        self._steady = 0
        self._others.pop(peer, None)

    def _ignore(self, message: Message, kind: Kind | None, peer: Peer) -> None:
        self.ignored += 1
        if self.ignored < self._due or self.known is None:
            return
        self._due = 2 * self.ignored
        where = f"from {_at(peer)}, while the vehicle is at {_at(self.known)}"
        if peer == self.known:
            where = f"that contradict those of the vehicle at {_at(peer)}"
        says = f" of {kind}" if kind is not None else ""
        self._notices.append(
            f"frames with the vehicle's ids ignored: {self.ignored} {where}; "
            f"the newest: {message.get_type()}{says}"
        )


def _at(peer: Peer) -> str:
    return f"{peer[0]}:{peer[1]}"


_NO_DATA = "no data arrives; check that the vehicle is on and that its link leads to the address of --vehicle"
_SENDERS_SHOWN = 4  # maximum number of listed senders

# Causes of a missing heartbeat, the likely causes first: counters, and a text with their sum as {n}. Every
# vehicle sends some unknown messages, so damage is the cause only if no frame is received.
_CAUSES: Sequence[tuple[tuple[str, ...], str]] = (
    (("bad_signature",), "{n} frames are signed with another key than --signing-key"),
    (("unsigned",), "{n} frames have no signature: with --signing-key only signed ones are accepted"),
    (
        ("stale", "replayed", "ahead"),
        "{n} signed frames are rejected by their time stamps: its clock and ours differ",
    ),
    (("reflected",), "{n} frames have our own ids: the link sends back what we send"),
    (("received",), "{received}"),
    (("version_1",), "{n} frames are MAVLink 1: set that link of the vehicle to MAVLink 2"),
    (("bad_crc", "unknown_id", "undecodable"), "{n} frames are damaged or of unknown messages"),
    (("garbage_bytes",), "{n} bytes are no MAVLink 2 frames"),
)


def why_silent(
    system_id: int, grown: Mapping[str, int], senders: Mapping[tuple[int, int], int], *, time: str = ""
) -> str:
    """Return a sentence about the missing heartbeat of a vehicle with the likely reason.

    ``grown``: increments of the endpoint's counters; ``senders``: number of frames of each other sender
    (system, component); ``time``: duration without a heartbeat, such as " for 5 s".
    """
    received = "only its other messages arrive"
    if senders:
        shown = ", ".join(f"{system}/{component}" for system, component in sorted(senders)[:_SENDERS_SHOWN])
        more = ", ..." if len(senders) > _SENDERS_SHOWN else ""
        received = f"frames come from system/component {shown}{more}; --system-id names the vehicle's"
    cause = _NO_DATA
    for counters, text in _CAUSES:
        n = sum(grown.get(name, 0) for name in counters)
        if n:
            cause = text.format(n=n, received=received)
            break
    return f"no heartbeat of system {system_id}, component 1{time}: {cause}"
