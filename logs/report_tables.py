"""Tables of the report as HTML: result, run, versions, events."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from logs.codec_log import Severity
from logs.flight_data import Flight
from logs.verdict_types import ESTIMATE, Outcome, Verdict

_EVENTS_MAX = 500  # a page with more is not read
_HEADLINES = {
    Outcome.LANDED: ("Landed", "good"),
    Outcome.ABORTED: ("Aborted, declared", "fair"),
    Outcome.CRASHED: ("Crashed", "bad"),
    Outcome.TIMEOUT: ("Not landed", "bad"),
}
_YES_NO = {True: "yes", False: "no", None: "not known"}
_RUN_NAMES = {
    "scenario": "scenario", "description": "description", "seed": "seed", "filter": "safety filter",
    "mode": "mode", "rate_hz": "controller rate [Hz]", "judge_alpha_1_m": "judged by α [1/m]",
    "judge_beta_m": "judged by β [m]", "barrier_alpha_1_m": "controller's α [1/m]",
    "barrier_beta_m": "controller's β [m]", "velocity_max_x_m_s": "velocity box x [m/s]",
    "velocity_max_y_m_s": "velocity box y [m/s]", "velocity_max_z_m_s": "velocity box z [m/s]",
    "pad_radius_m": "pad radius [m]",
}  # fmt: skip


def headline(verdict: Verdict) -> tuple[str, str]:
    """Outcome in words, and the style class of its badge."""
    text, style = _HEADLINES[verdict.outcome]
    if verdict.judged_from == ESTIMATE:
        text = f"{text}, by its own estimate"
    if verdict.violation:
        return f"{text}, with a barrier violation", "fair" if style == "good" else style
    return text, style


def result_table(flight: Flight, verdict: Verdict) -> str:
    """The verdict with units, and what each line was judged from."""
    source, v = verdict.judged_from, verdict
    relative = f"relative to the pad; {source}"
    rows = [
        ("outcome", v.outcome.value, "", v.reason),
        ("barrier violation", _YES_NO[v.violation], "", "h < −5 mm outside the pad, begun with h ≥ 0"),
        ("began safe", _YES_NO[v.started_safe], "", "h ≥ 0 when the landing began"),
        ("lowest h", _number(v.h_min_m, 4), "m", f"since the landing began; {source}"),
        ("lowest h outside the pad", _number(v.h_min_outside_pad_m, 4), "m", source),
        ("touchdown error", _scaled(v.touchdown_error_m, 100.0, 2), "cm", f"d at first contact; {source}"),
        ("touchdown speed, vertical", _number(v.touchdown_speed_vertical_m_s, 3), "m/s", relative),
        ("touchdown speed, horizontal", _number(v.touchdown_speed_horizontal_m_s, 3), "m/s", relative),
        ("time to land", _number(v.time_to_land_s, 2), "s", "begin of the landing to first contact"),
        ("length of the log", _number(flight.duration_s, 2), "s", ""),
    ]
    return _table(("result", "value", "unit", "meaning"), rows, numbers=(1,))


def run_table(flight: Flight) -> str:
    """What was flown, as the launcher wrote it into the log."""
    run = flight.metadata.get("run", {})
    rows = [(name, run[key]) for key, name in _RUN_NAMES.items() if key in run]
    rows += [(key.replace("_", " "), value) for key, value in run.items() if key not in _RUN_NAMES]
    return _table(("run", "value"), rows) if rows else "<p>The log does not say what was flown.</p>"


def versions_table(flight: Flight) -> str:
    """What it was flown with."""
    rows = [(key.replace("_", " "), value or "–") for key, value in flight.metadata.get("made", {}).items()]
    rows += [(f"records lost by {who}", n) for who, n in flight.metadata.get("losses", {}).items()]
    return _table(("made with", "value"), rows) if rows else "<p>The log does not name versions.</p>"


def events_table(flight: Flight) -> str:
    """Events in order, times since the landing began."""
    if not flight.events:
        return "<p>No events in this log.</p>"
    zero = flight.landing_start_s or 0.0
    rows = [
        (f"{e.t_s - zero:+.2f}", _severity(e.level), e.source, e.text) for e in flight.events[:_EVENTS_MAX]
    ]
    more = len(flight.events) - len(rows)
    rest = f"<p>{more} later events are in the log only.</p>" if more > 0 else ""
    return _table(("time [s]", "level", "from", "event"), rows, numbers=(0,), row_class=1) + rest


def _severity(level: int) -> str:
    return Severity(level).name.lower() if level in Severity._value2member_map_ else str(level)


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}".replace("-", "−")


def _scaled(value: float | None, factor: float, digits: int) -> str:
    return _number(None if value is None else value * factor, digits)


def _table(
    head: tuple[str, ...],
    rows: Sequence[tuple[str, ...]],
    numbers: tuple[int, ...] = (),
    row_class: int | None = None,
) -> str:
    """Rows of text as HTML, escaped; columns in ``numbers`` are set to the right."""
    lines = ["<table><thead><tr>"]
    lines += [f"<th{_right(i, numbers)}>{escape(text)}</th>" for i, text in enumerate(head)]
    lines.append("</tr></thead><tbody>")
    for row in rows:
        style = f' class="{escape(row[row_class], quote=True)}"' if row_class is not None else ""
        cells = "".join(f"<td{_right(i, numbers)}>{escape(text)}</td>" for i, text in enumerate(row))
        lines.append(f"<tr{style}>{cells}</tr>")
    lines.append("</tbody></table>")
    return "".join(lines)


def _right(column: int, numbers: tuple[int, ...]) -> str:
    return ' class="number"' if column in numbers else ""
