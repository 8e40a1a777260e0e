"""Two flights on one page: key numbers with their differences, what was set differently, figures overlaid."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from flightstack.common.strict_toml import to_table
from logs.reader.flight import load_flight
from logs.reader.flight_data import Flight, Floats
from logs.reader.reader import LogFile
from logs.report.derived import Side, estimate_errors, fault_spans, root_mean_square
from logs.report.page import (
    block,
    header,
    need_libraries,
    page,
    paragraph,
    section,
    table,
    time_bar,
    warnings_box,
)
from logs.report.tables import YES_NO, definitions, events_table, headline, number
from logs.verdict.verdict import judge

_SETTINGS = "Run, versions and configuration."
_WIDE = "wide events"  # style of the tables of events


def write_comparison(log_a: Path, log_b: Path, out: Path | None = None, member: str | None = None) -> Path:
    """Write the page that compares two logs, by default ``comparison.html`` beside the second."""
    need_libraries()
    sides = (_side("A", log_a, member), _side("B", log_b, member))
    target = log_b.with_name("comparison.html") if out is None else out
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(render(*sides), encoding="utf-8")
    return target


def _side(name: str, log: Path, member: str | None) -> Side:
    from logs.report.links import load_streams

    flight = load_flight(log, member if LogFile(log).members else None)
    return Side(name, flight, judge(flight), load_streams(flight.path, flight.origin_ns, flight.member))


def render(a: Side, b: Side) -> str:
    from logs.report.overlay import overlays
    from logs.report.report import warnings

    worse = max((headline(s.verdict)[1] for s in (a, b)), key=("good", "fair", "bad").index)
    title = f"{_scenario(a)} and {_scenario(b)}, compared"
    outcomes = " · ".join(f"{s.name} {headline(s.verdict)[0]}" for s in (a, b))
    names = " · ".join(_told(s) for s in (a, b))
    figures = [section(p.key, p.title, p.paper, p.note, p.figure) for p in overlays(a, b)]
    body = (
        header(title, outcomes, worse, names),
        warnings_box([f"{s.name}: {text}" for s in (a, b) for text in warnings(s.flight, s.verdict)]),
        block("numbers", "Key numbers", "", _numbers(a, b) + definitions()),
        block("settings", "What was set differently", _SETTINGS, _settings(a.flight, b.flight)),
        time_bar(events=False),
        *figures,
        '<div class="columns">',
        *(
            block(f"events-{s.name}", f"Events of {s.name}", "", events_table(s.flight), _WIDE)
            for s in (a, b)
        ),
        "</div>",
    )
    return page(title, "".join(body))


def _scenario(side: Side) -> str:
    return side.flight.metadata.get("run", {}).get("scenario", side.flight.path.stem)


def _told(side: Side) -> str:
    run = side.flight.metadata.get("run", {})
    told = [f"{key} {run[key]}" for key in ("seed", "filter", "mode") if key in run]
    return ", ".join([f"{side.name}: {side.flight.path}", *told])


def _p99(values: Floats) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, 99)) if len(known) else None


def _error_m(side: Side) -> float | None:
    errors = estimate_errors(side.flight)
    return None if errors is None else root_mean_square(errors.h_m)


def _lost(side: Side) -> float | None:
    lost = [stream.lost for stream in side.streams if stream.lost is not None]
    return float(sum(lost)) if lost else None


# name, unit, digits, factor, value
_NUMBERS: tuple[tuple[str, str, int, float, Callable[[Side], float | None]], ...] = (
    ("lowest h", "mm", 1, 1e3, lambda s: s.verdict.h_min_m),
    ("lowest h outside the pad", "mm", 1, 1e3, lambda s: s.verdict.h_min_outside_pad_m),
    ("touchdown error", "mm", 1, 1e3, lambda s: s.verdict.touchdown_error_m),
    ("touchdown speed, vertical", "m/s", 3, 1.0, lambda s: s.verdict.touchdown_speed_vertical_m_s),
    ("touchdown speed, horizontal", "m/s", 3, 1.0, lambda s: s.verdict.touchdown_speed_horizontal_m_s),
    ("time to land", "s", 2, 1.0, lambda s: s.verdict.time_to_land_s),
    ("length of the log", "s", 2, 1.0, lambda s: s.flight.duration_s),
    ("error of h, root mean square", "mm", 1, 1e3, _error_m),
    ("age of the target state, 99 %", "ms", 1, 1e3,
     lambda s: None if s.flight.steps is None else _p99(s.flight.steps.target_age_s)),
    ("whole tick, 99 %", "µs", 0, 1e6,
     lambda s: None if s.flight.timing is None else _p99(s.flight.timing.exec_s)),
    ("overruns", "", 0, 1.0,
     lambda s: None if s.flight.timing is None else float(s.flight.timing.overruns[-1])),
    ("messages lost", "", 0, 1.0, _lost),
    ("faults injected", "", 0, 1.0, lambda s: float(len(fault_spans(s.flight)))),
    ("phases", "", 0, 1.0, lambda s: float(len(s.flight.phase_spans()))),
)  # fmt: skip


def _numbers(a: Side, b: Side) -> str:
    rows: list[tuple[str, ...]] = [
        ("outcome", a.verdict.outcome.value, b.verdict.outcome.value, "", ""),
        ("barrier violation", YES_NO[a.verdict.violation], YES_NO[b.verdict.violation], "", ""),
    ]
    for name, unit, digits, factor, value in _NUMBERS:
        of_a, of_b = (None if v is None else factor * v for v in (value(a), value(b)))
        change = None if of_a is None or of_b is None else of_b - of_a
        sign = "+" if change is not None and round(change, digits) > 0.0 else ""
        shown = [number(v, digits) for v in (of_a, of_b, change)]
        rows.append((name, shown[0], shown[1], sign + shown[2], unit))
    return table(("result", "A", "B", "B − A", "unit"), rows, numbers=(1, 2, 3))


def _settings(a: Flight, b: Flight) -> str:
    rows: list[tuple[str, str, str]] = []
    of_a, of_b = _all_settings(a), _all_settings(b)
    for key in sorted(of_a.keys() | of_b.keys()):
        left, right = of_a.get(key, "–"), of_b.get(key, "–")
        if left != right:
            rows.append((key, left, right))
    return table(("setting", "A", "B"), rows) if rows else paragraph("Nothing that the logs tell of.")


def _all_settings(flight: Flight) -> dict[str, str]:
    found = {f"{n}.{key}": v for n in ("run", "made") for key, v in flight.metadata.get(n, {}).items()}
    if flight.config is not None:
        _flatten("onboard", to_table(flight.config), found)
    return found


def _flatten(prefix: str, values: object, found: dict[str, str]) -> None:
    if isinstance(values, dict):
        for key, value in values.items():
            _flatten(f"{prefix}.{key}", value, found)
    else:
        found[prefix] = str(values)
