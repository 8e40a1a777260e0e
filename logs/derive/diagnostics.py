"""Diagnostics of loop, inputs, safety filter and link, once a second: ``diagnostic_msgs/DiagnosticArray``.

They use the controller steps, loop timings and raw MAVLink frames of one onboard process. Loop timings are
measured in wall time, so they differ between two runs of one seed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

from logs.derive.frames import FrameCounter
from logs.schema.rows import ControllerStepRow, LoopTimingRow
from logs.schema.schemas import DIAGNOSTIC_ARRAY, packer

TOPIC = "/diagnostics"
PERIOD_NS = 1_000_000_000
FILTER_BAD = 3  # smallest filter_status of ControllerStep that is a problem: FILTER_INFEASIBLE
LATE_S = 0.002  # greatest normal delay of a tick after its deadline, s: a fifth of 10 ms
LOST_MAX = 0.02  # fraction of the vehicle's frames that may be missing by their sequence numbers


class Level(IntEnum):
    """Levels of ``diagnostic_msgs/msg/DiagnosticStatus`` in ROS."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Status(NamedTuple):
    name: str
    level: Level
    message: str
    values: dict[str, float]


class Health:
    """Diagnostics of one onboard process, once a second."""

    def __init__(self, namespace: str) -> None:
        self._name = namespace.strip("/")
        self._steps: list[ControllerStepRow] = []
        self._timings: list[LoopTimingRow] = []
        self._slot: int | None = None
        self._pack = packer(DIAGNOSTIC_ARRAY, frame_id="")
        self._accepted = self._rejected = self._overruns = self._dropped = 0
        self.incoming, self.outgoing = FrameCounter(), FrameCounter()

    def step(self, row: ControllerStepRow) -> None:
        self._steps.append(row)
        del self._steps[:-1000]  # without timings no call empties the list

    def timing(self, log_time_ns: int, row: LoopTimingRow) -> list[tuple[str, str, bytes]]:
        """Add the timing of a tick; at the end of a second, return the diagnostics of this second.

        The result is (topic, schema, CDR), at most one.
        """
        slot = log_time_ns // PERIOD_NS
        if self._slot is None:
            self._slot = slot
        self._timings.append(row)
        if slot == self._slot:
            return []
        self._slot = slot
        statuses = self._statuses()
        self._steps.clear()
        self._timings.clear()
        array = [(s.level, s.name, s.message, self._name, _texts(s.values)) for s in statuses]
        return [(TOPIC, DIAGNOSTIC_ARRAY, self._pack((log_time_ns, array)))]

    def _statuses(self) -> list[Status]:
        steps, name = self._steps, self._name
        found = [_loop(name, self._timings, self._overruns, self._dropped), self._link()]
        self._overruns, self._dropped = self._timings[-1].overruns, self._timings[-1].feed_dropped
        if steps:
            found += [_inputs(name, steps, self._accepted, self._rejected), _safety(name, steps)]
            self._accepted, self._rejected = steps[-1].target_accepted, steps[-1].target_rejected
        return found

    def _link(self) -> Status:
        frames, lost = self.incoming.take()
        sent, _ = self.outgoing.take()
        share = lost / (frames + lost) if frames + lost else math.nan
        heard = bool(self._steps) and self._steps[-1].link_valid
        level = Level.WARN if share > LOST_MAX else Level.OK
        message = f"{frames} frames in, {sent} out"
        if not heard:
            level, message = Level.ERROR, "no fresh heartbeat"
        values = {"frames_in": frames, "frames_out": sent, "lost": lost, "lost_share": share}
        return Status(f"{self._name}: vehicle link", level, message, values)


def _loop(name: str, rows: Sequence[LoopTimingRow], overruns: int, dropped: int) -> Status:
    late_s = max(r.lateness_s for r in rows)
    missed, lost = rows[-1].overruns - overruns, rows[-1].feed_dropped - dropped
    level, message = Level.OK, "on time"
    if late_s > LATE_S or missed > 0:
        level, message = Level.WARN, f"{missed} deadlines missed, at most {1e3 * late_s:.1f} ms late"
    if lost > 0:
        level, message = Level.ERROR, f"{lost} log records dropped"
    values = {
        "period_mean_s": sum(r.period_s for r in rows) / len(rows),
        "lateness_max_s": late_s,
        "exec_max_s": max(r.exec_s for r in rows),
        "solve_max_s": max(r.solve_s for r in rows),
        "overruns": rows[-1].overruns,
        "feed_dropped": rows[-1].feed_dropped,
    }
    return Status(f"{name}: loop", level, message, values)


def _inputs(name: str, rows: Sequence[ControllerStepRow], accepted: int, rejected: int) -> Status:
    own = sum(not r.own_valid for r in rows)
    target = sum(not r.target_valid for r in rows)
    level, message = Level.OK, "both states fresh"
    if own or target:
        level = Level.WARN
        message = f"own state missing in {own}, target in {target} of {len(rows)} ticks"
    if not (rows[-1].own_valid and rows[-1].target_valid):
        level = Level.STALE
    values = {
        "own_age_max_s": _worst(r.own_age_s for r in rows),
        "target_age_max_s": _worst(r.target_age_s for r in rows),
        "target_accepted": rows[-1].target_accepted - accepted,
        "target_rejected": rows[-1].target_rejected - rejected,
    }
    return Status(f"{name}: inputs", level, message, values)


def _safety(name: str, rows: Sequence[ControllerStepRow]) -> Status:
    h_m = min((r.h_m for r in rows if not math.isnan(r.h_m)), default=math.nan)
    slack = min((r.slack_m_s for r in rows if not math.isnan(r.slack_m_s)), default=math.nan)
    bad = sum(r.filter_status >= FILTER_BAD for r in rows)
    refused = sum(r.gate != 0 for r in rows)
    level, message = Level.OK, f"smallest h {h_m:.3f} m"
    if bad or refused:
        level, message = Level.WARN, f"filter without a solution {bad} times, gate refused {refused}"
    if h_m < 0.0:
        level, message = Level.ERROR, f"h fell to {h_m:.4f} m"
    values = {
        "h_min_m": h_m, "slack_min_m_s": slack, "filter_bad": bad, "gate_refused": refused,
        "phase": rows[-1].phase,
    }  # fmt: skip
    return Status(f"{name}: safety", level, message, values)


def _worst(values: Any) -> float:
    """Return the largest age; NaN, for an input that never arrived, counts as largest."""
    ages = list(values)
    return math.nan if any(math.isnan(a) for a in ages) else max(ages)


def _texts(values: dict[str, float]) -> tuple[tuple[str, str], ...]:
    """Return keys and values as text; floats have six digits."""
    return tuple((key, f"{v:.6g}" if isinstance(v, float) else str(v)) for key, v in values.items())
