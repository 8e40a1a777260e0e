"""Derived values of the report: filter margin, estimation errors, tilt, faults, traffic."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from flightstack.core.strategies.strategy import packaged_strategy_of
from flightstack.core.types import FilterStatus
from logs.reader.flight import TARGET_TOPIC_END
from logs.reader.flight_data import Flight, Floats, Steps
from logs.reader.reader import LogFile
from logs.schema.events import ContactBit
from logs.schema.mavlink import unpack_mavlink
from logs.schema.schemas import MAVLINK, ODOMETRY
from logs.verdict.types import Verdict

_RAN = (
    FilterStatus.SOLVED,
    FilterStatus.CLOSED_FORM,
    FilterStatus.INFEASIBLE,
    FilterStatus.CROWDED,
    FilterStatus.OWN,
)
_NEAR_S = 0.02  # maximum time between a step and its true state, s: two ticks
BEGINS, ENDS = "Fault: ", "Fault over: "
_RELAYED = "vehicle: "  # prefix of the vehicle's messages in events of the onboard process
_ENOUGH = 200  # maximum number of entries in a table of the report


def held_margin_m(flight: Flight) -> Floats | None:
    """Return the margin on h, m, that the filter enforced at each step, (n,); NaN if it did not run.

    A step contains the slack s of the constraint at u*: s = g u* + rate * h_held + dh/dt. This gives h_held,
    and the margin is h - h_held. The result is ``None`` without steps, without configuration, and for a
    filter that is not part of the package.
    """
    steps, config = flight.steps, flight.config
    if steps is None or config is None:
        return None
    strategy = packaged_strategy_of(config)
    if strategy is None:
        return None
    flow = np.einsum("ij,ij->i", steps.gradient, steps.filtered_enu_m_s)
    held_m = (steps.slack_m_s - flow - steps.dh_dt_m_s) / strategy.rate_1_s
    margin_m = np.where(np.isin(steps.filter_status, _RAN), steps.h_m - held_m, np.nan)
    return margin_m if np.isfinite(margin_m).any() else None


@dataclass(frozen=True)
class Errors:
    """Estimated minus true values at the n controller steps; vectors are (n, 3), unknown values are NaN."""

    t_s: Floats
    own_m: Floats
    target_m: Floats
    target_m_s: Floats
    h_m: Floats


def estimate_errors(flight: Flight) -> Errors | None:
    """Return the errors against linearly interpolated true states; ``None`` without true states."""
    steps, truth = flight.steps, flight.truth
    if steps is None or truth is None or len(truth.t_s) < 2:
        return None
    gap_s = np.abs(truth.t_s[_nearest(truth.t_s, steps.t_s)] - steps.t_s)
    known = (gap_s <= _NEAR_S)[:, None]

    def at_steps(values: Floats) -> Floats:
        columns = [np.interp(steps.t_s, truth.t_s, column) for column in values.T]
        return np.where(known, np.column_stack(columns), np.nan)

    own = np.where(steps.own_valid[:, None], steps.own_position_enu_m, np.nan)
    target = np.where(steps.target_valid[:, None], steps.target_position_enu_m, np.nan)
    target_v = np.where(steps.target_valid[:, None], steps.target_velocity_enu_m_s, np.nan)
    h_m = np.where(steps.both_valid, steps.h_m, np.nan)
    return Errors(
        steps.t_s,
        own - at_steps(truth.position_enu_m),
        target - at_steps(truth.pad_position_enu_m),
        target_v - at_steps(truth.pad_velocity_enu_m_s),
        h_m - at_steps(truth.h_m[:, None])[:, 0],
    )


def root_mean_square(values: Floats) -> float | None:
    """Return the root mean square of the finite values; ``None`` if no value is finite."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known * known))) if len(known) else None


def tilt_deg(flight: Flight) -> Floats | None:
    """Return the true angle between body z and the vertical, degrees, (n,); ``None`` without true states."""
    if flight.truth is None:
        return None
    x, y = flight.truth.orientation[:, 0], flight.truth.orientation[:, 1]
    return np.asarray(np.degrees(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0))))


def _nearest(times: Floats, wanted: Floats) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    right = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    left = right - 1
    return np.where(wanted - times[left] <= times[right] - wanted, left, right)


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
