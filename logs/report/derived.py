"""Derived values of the report: faults, traffic, contact."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from logs.reader.flight import TARGET_TOPIC_END
from logs.reader.flight_data import Flight, Floats, Steps
from logs.reader.reader import LogFile
from logs.schema.events import ContactBit
from logs.schema.mavlink import unpack_mavlink
from logs.schema.schemas import MAVLINK, ODOMETRY
from logs.verdict.types import Verdict

BEGINS, ENDS = "Fault: ", "Fault over: "
_RELAYED = "vehicle: "  # prefix of the vehicle's messages in events of the onboard process
_ENOUGH = 200  # maximum number of entries in a table of the report


def root_mean_square(values: Floats) -> float | None:
    """Return the root mean square of the finite values; ``None`` if no value is finite."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known * known))) if len(known) else None


class FaultSpan(NamedTuple):
    """One fault, with its times since the flight's origin, s; ``over``: whether it ended before the log."""

    text: str
    begin_s: float
    end_s: float
    over: bool


def fault_spans(flight: Flight) -> list[FaultSpan]:
    """Return the faults in order of their start; a fault that two processes report counts once."""
    begun: dict[str, float] = {}
    found: list[FaultSpan] = []
    for event in flight.events:
        text = event.text.removeprefix(_RELAYED)
        if text.startswith(BEGINS):
            begun.setdefault(text.removeprefix(BEGINS), event.t_s)
        elif text.startswith(ENDS):
            name = text.removeprefix(ENDS)
            begin_s = begun.pop(name, None)
            if begin_s is not None:
                found.append(FaultSpan(name, begin_s, event.t_s, over=True))
    found += [FaultSpan(name, begin_s, flight.duration_s, over=False) for name, begin_s in begun.items()]
    return sorted(found, key=lambda span: span.begin_s)[:_ENOUGH]


POSITION = "vehicle position"
TARGET = "target odometry"
_SOURCE, _SINK = "/mavlink_source", "/mavlink_sink"
_SHOWN = {
    (_SOURCE, dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED): POSITION,
    (_SOURCE, dialect.MAVLINK_MSG_ID_HEARTBEAT): "vehicle heartbeat",
    (_SINK, dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED): "set-points sent",
}
_ALL = {_SOURCE: "vehicle, all MAVLink", _SINK: "onboard, all MAVLink"}
_HALF = 128  # half of the 256 sequence numbers; a number ahead by this or more counts as late


@dataclass(frozen=True)
class Stream:
    """All messages of one kind on one link."""

    name: str
    t_s: Floats  # arrival times, s since the origin of the flight, (n,)
    # number of missing messages by sequence number; ``None`` if the sender does not number this kind
    lost: int | None

    @property
    def rate_hz(self) -> float | None:
        span_s = float(self.t_s[-1] - self.t_s[0]) if len(self.t_s) > 1 else 0.0
        return (len(self.t_s) - 1) / span_s if span_s > 0.0 else None

    @property
    def gap_max_s(self) -> float | None:
        return float(np.diff(self.t_s).max()) if len(self.t_s) > 1 else None


def load_streams(path: Path, origin_ns: int, member: str | None = None) -> list[Stream]:
    """Read the message traffic of a log, up to its first damage; damaged frames are skipped."""
    times: dict[str, list[int]] = defaultdict(list)
    frames: dict[str, list[tuple[tuple[int, int], int]]] = {side: [] for side in _ALL}
    target: list[int] = []
    for message in LogFile(path, member).messages():
        if message.schema == ODOMETRY and message.topic.endswith(TARGET_TOPIC_END):
            times[TARGET].append(message.log_time_ns)
            target.append(message.sequence)
        elif message.schema == MAVLINK:
            side = next((end for end in _ALL if message.topic.endswith(end)), None)
            if side is None:
                continue
            try:
                record = unpack_mavlink(message.data)
            except ValueError:
                continue
            frames[side].append((record.sender, record.sequence))
            for name in filter(None, (_ALL[side], _SHOWN.get((side, record.message_id)))):
                times[name].append(message.log_time_ns)
    lost = {_ALL[side]: frames_lost(seen) for side, seen in frames.items()} | {TARGET: missing(target)}
    order = (*_ALL.values(), *_SHOWN.values(), TARGET)
    return [
        Stream(name, np.asarray((np.array(times[name]) - origin_ns) * 1e-9, np.float64), lost.get(name))
        for name in order
        if name in times
    ]


def frames_lost(frames: Iterable[tuple[tuple[int, int], int]]) -> int:
    """Return the number of missing MAVLink frames, from sender and sequence number of each frame."""
    last: dict[tuple[int, int], int] = {}
    lost = 0
    for sender, sequence in frames:
        ahead = (sequence - last.get(sender, sequence - 1)) & 0xFF
        if ahead >= _HALF:
            lost = max(0, lost - 1)  # a late frame was counted as lost
        else:
            lost += max(0, ahead - 1)
            last[sender] = sequence
    return lost


def missing(numbers: Sequence[int]) -> int | None:
    """Return the count of missing sequence numbers; ``None`` if the sender does not number messages."""
    if not numbers or max(numbers) == 0:
        return None
    return max(numbers) - min(numbers) + 1 - len(set(numbers))


class Side(NamedTuple):
    """A flight as one side of a report page, with the data that the page shows."""

    name: str  # name of the member of a fleet; empty for a single flight
    flight: Flight
    verdict: Verdict
    streams: list[Stream]  # message traffic; empty for the member of a fleet
    offset_s: float  # offset that converts times of the flight to times of the page, s

    @property
    def of(self) -> str:
        """Prefix of the names on the page that belong to this side; empty for a single flight."""
        return f"{self.name} " if self.name else ""


def side_of(flight: Flight, verdict: Verdict) -> Side:
    """Return a flight with its traffic; its times count from the start of the landing."""
    streams = load_streams(flight.path, flight.origin_ns, flight.member)
    return Side("", flight, verdict, streams, -(flight.landing_start_s or 0.0))


def touch_index(flight: Flight) -> int | None:
    """Return the index of the first true state with contact to the pad after the landing began."""
    truth, start_s = flight.truth, flight.landing_start_s
    if truth is None or start_s is None:
        return None
    found = np.flatnonzero((truth.contacts & ContactBit.PAD > 0) & (truth.t_s > start_s))
    return int(found[0]) if len(found) else None


def share_active(steps: Steps) -> float | None:
    """Return the fraction of filtered ticks in which the barrier changed the velocity; ``None``: no ticks."""
    ran = np.isfinite(steps.slack_m_s)
    return float(steps.barrier_active[ran].mean()) if ran.any() else None
