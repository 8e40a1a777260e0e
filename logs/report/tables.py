"""Makes the HTML tables of a report."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from logs.reader.flight_data import Event, Fleet, Floats, Span, Steps
from logs.report.derived import Side, fault_spans
from logs.report.page import part
from logs.schema import LOSSES
from logs.schema.events import Severity
from logs.verdict.types import BELOW_ON_PAD, ESTIMATE, FALL_M_S, FALLS, Outcome
from logs.verdict.verdict import FleetVerdict

EVENTS_MAX = 500  # maximum number of shown events
HEADLINES = {
    Outcome.LANDED: ("Landed", "good"),
    Outcome.ABORTED: ("Aborted, declared", "fair"),
    Outcome.CRASHED: ("Crashed", "bad"),
    Outcome.TIMEOUT: ("Not landed", "bad"),
    Outcome.UNKNOWN: ("Not known: records were lost", "bad"),
}
YES_NO = {True: "yes", False: "no", None: "not known"}


def headline(verdict: FleetVerdict) -> tuple[str, str]:
    text, style = HEADLINES[verdict.outcome]
    if verdict.judged_from == ESTIMATE:
        text = f"{text}, by its own estimate"
    also = ["a barrier violation"] if verdict.violation else []
    also += ["an ellipsoid violation"] if verdict.ellipsoid_violations else []
    if also:
        return f"{text}, with {' and '.join(also)}", "fair" if style == "good" else style
    return text, style


def run_table(run: Mapping[str, str], fleet: Fleet) -> str:
    """Return an HTML table of run, vehicles, versions and numbers of lost records.

    ``run``: values of the run; values of one vehicle, for example its seed, follow with the vehicle's name.
    """
    found = {**run, **fleet.metadata.get("made", {})}
    for name, flight in fleet.flights.items():
        own = flight.metadata.get("run", {})
        found |= {f"{name} {key}": value for key, value in own.items() if run.get(key) != value}
    rows = [(key.replace("_", " "), value or "–") for key, value in found.items()]
    rows += [(f"records lost by {who}", n) for who, n in fleet.metadata.get(LOSSES, {}).items()]
    return part("table", ("run", "value"), rows, empty="The log has no metadata of the run.")


def events_table(events: Sequence[Event], zero_s: float) -> str:
    """Return a table of the events in order, each with a link to its time since ``zero_s``."""
    rows = [
        (part("at_link", e.t_s - zero_s, number(e.t_s - zero_s, 2)), severity(e.level), e.source, e.text)
        for e in events[:EVENTS_MAX]
    ]
    more = len(events) - len(rows)
    shown = part("table", ("time [s]", "level", "from", "event"), rows, numbers=(0,), row_class=1,
                  empty="No events in this log.")  # fmt: skip
    return shown + part("paragraph", f"{more} later events are in the log only.") if more > 0 else shown


def severity(level: int) -> str:
    """Return the name of an event's level, which is also the CSS class of its row."""
    return Severity(level).name.lower() if level in Severity._value2member_map_ else str(level)


def number(value: float | None, digits: int, factor: float = 1.0) -> str:
    """Return a number times a factor with ``digits`` decimals, or a dash for None."""
    return "–" if value is None else f"{factor * value:.{digits}f}".replace("-", "−")


def _p99(values: Floats) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, 99)) if len(known) else None


def _of(part: str, value: Callable[[Any], float | None]) -> Callable[[Side], float | None]:
    """Return a function that computes a number from the steps or the timing of a flight."""

    def found(side: Side) -> float | None:
        data = getattr(side.flight, part)
        return None if data is None else value(data)

    return found


def _active_share(steps: Steps) -> float | None:
    ran = np.isfinite(steps.slack_m_s)
    return float(steps.barrier_active[ran].mean()) if ran.any() else None


_RELATIVE, _VERTICAL = "relative to the pad", "touchdown speed, vertical"
_LOWEST = "lowest h outside the pad"
_KEYS = (_LOWEST, "touchdown error", _VERTICAL, "time to land")
# columns of a row: name, unit, digits, factor, value, meaning
_NUMBERS: tuple[tuple[str, str, int, float, Callable[[Side], float | None], str], ...] = (
    ("lowest h", "mm", 1, 1e3, lambda s: s.verdict.h_min_m, BELOW_ON_PAD),
    (_LOWEST, "mm", 1, 1e3, lambda s: s.verdict.h_min_outside_pad_m, ""),
    ("touchdown error", "mm", 1, 1e3, lambda s: s.verdict.touchdown_error_m, "d at first contact"),
    (_VERTICAL, "m/s", 3, 1.0, lambda s: s.verdict.touchdown_speed_vertical_m_s, _RELATIVE),
    ("touchdown speed, horizontal", "m/s", 3, 1.0, lambda s: s.verdict.touchdown_speed_horizontal_m_s,
     _RELATIVE),
    ("time to land", "s", 2, 1.0, lambda s: s.verdict.time_to_land_s,
     "begin of the landing to first contact"),
    ("waited for others", "s", 1, 1.0,
     lambda s: sum(e.end_s - e.begin_s for _, e in _waits([s])) if s.flight.spans else None,
     "flew and gave way to neighbours"),
    ("length of the log", "s", 2, 1.0, lambda s: s.flight.duration_s, ""),
    ("barrier active", "%", 0, 100.0, _of("steps", _active_share), "of the ticks with a filter"),
    ("age of the target state, 99 %", "ms", 1, 1e3, _of("steps", lambda v: _p99(v.target_age_s)),
     "at the ticks"),
    ("age of the own state, 99 %", "ms", 1, 1e3, _of("steps", lambda v: _p99(v.own_age_s)),
     "at the ticks"),
    ("target samples refused", "", 0, 1.0, _of("steps", lambda v: float(v.target_rejected[-1])),
     "by the controller"),
    ("whole tick, 99 %", "µs", 0, 1e6, _of("timing", lambda v: _p99(v.exec_s)), "wall time"),
    ("overruns", "", 0, 1.0, _of("timing", lambda v: float(v.overruns[-1])), "deadlines missed"),
    ("faults injected", "", 0, 1.0, lambda s: float(len(fault_spans(s.flight))), ""),
)  # fmt: skip


def key_numbers(verdict: FleetVerdict, sides: Sequence[Side]) -> list[tuple[str, str, str]]:
    """Return name, value and unit of each key number; the value is the worst of all flights."""
    worst, distance_m = sides[0]._replace(verdict=verdict), verdict.distance_min_m
    found = [
        (name, number(value(worst), digits, factor), unit)
        for name, unit, digits, factor, value, _ in _NUMBERS
        if name in _KEYS
    ]
    if distance_m is not None:
        found.append(("smallest distance of two vehicles", number(distance_m, 2), "m"))
    return found


def result_table(verdict: FleetVerdict, sides: Sequence[Side]) -> str:
    """Return the table of the verdict: a row for each result, a column for each flight."""
    members = [side.verdict for side in sides]
    rows = [
        ("outcome", *(each.outcome.value for each in members), "", verdict.reason),
        ("barrier violation", *(YES_NO[each.violation] for each in members), "",
         "h < −5 mm outside the pad, begun with h ≥ 0"),
        ("began safe", *(YES_NO[each.started_safe] for each in members), "", "h ≥ 0 when the landing began"),
    ]  # fmt: skip
    for name, unit, digits, factor, value, meaning in _NUMBERS:
        found = [value(side) for side in sides]
        if name == _VERTICAL and any((each or 0.0) > FALL_M_S for each in found):
            meaning = f"{meaning}. {FALLS}"
        rows.append((name, *(number(each, digits, factor) for each in found), unit, meaning))
    names = [part("link", f"#{side.name}", side.name) for side in sides]
    text = part("table", ("result", *names, "unit", "meaning"), rows, numbers=range(1, len(sides) + 1))
    return text + part("definitions")


_DASH = "\N{WORD JOINER}–\N{WORD JOINER}"  # en dash without a line break before or after it


def pairs_table(fleet: Fleet) -> str:
    """Return a table with the smallest distances of each pair while both flew, and the collision time."""
    rows = []
    for (one, other), pair in sorted(fleet.pairs.items()):
        names = f"{fleet.ids.get(one, one)}{_DASH}{fleet.ids.get(other, other)}"
        least, flying_m = (
            None if np.isinf(v) else v for v in (pair.ellipsoid_min, pair.flying_distance_min_m)
        )
        hit = "–" if pair.collided_ms < 0 else f"{pair.collided_ms * 1e-3:.2f}"
        inside = number(pair.inside_ms, 2, 1e-3)
        rows.append((names, number(least, 2), number(flying_m, 3), str(pair.violations), inside, hit))
    head = ("pair", "measure [1]", "distance [m]", "times inside", "inside [s]", "collided [s]")
    return _filled(head, rows, range(1, 6))


def waits_table(sides: Sequence[Side]) -> str:
    waits = [(span.begin_s + side.offset_s, side.name, span) for side, span in _waits(sides)]
    rows = [
        (part("at_link", at_s, f"{at_s:.2f}"), name, ", ".join(s.gives_way_to), f"{s.end_s - s.begin_s:.2f}")
        for at_s, name, s in sorted(waits)
    ]
    return _filled(("from [s]", "who", "for whom", "for [s]"), rows, (0, 3))


def _filled(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int]) -> str:
    """Return a table; without rows return an empty text, so that the page leaves the panel out."""
    return part("table", head, rows, numbers=numbers) if rows else ""


def _waits(sides: Sequence[Side]) -> list[tuple[Side, Span]]:
    return [(side, span) for side in sides for span in side.flight.spans if span.waits]
