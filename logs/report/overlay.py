"""Figures with two flights in them, each on its own time since its landing began."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import plotly.graph_objects as go

from logs.reader.flight_data import Flight, Floats, phase_name
from logs.report.derived import Side, estimate_errors, fault_spans
from logs.report.figures import Panel
from logs.report.series import AXES
from logs.report.space import relative_tracks
from logs.report.style import (
    BOUNDARY,
    FAULT,
    INK,
    LIMIT,
    PHASE_SOLID,
    TRUE,
    UNSAFE,
    boundary_height_m,
    layout,
    line,
    low_envelope,
    rows_of,
    shown_range,
    value_range,
    zero_s,
)
from logs.report.timeline import bar
from logs.verdict.types import VIOLATION_LIMIT_M

_COLORS = {"A": TRUE, "B": "#D55E00"}


def overlays(a: Side, b: Side) -> list[Panel]:
    both = "A is blue, B is orange; each on the time since its own landing began."
    best = "From true states where the log has them, else by the vehicle's estimate."
    return [
        Panel("timeline", "Phases and faults", "", both, _phases(a, b)),
        Panel("barrier", "Barrier value over time", "", f"{both} {best}", _h(a, b)),
        Panel(
            "altitude", "Relative altitude over horizontal distance", "", f"{both} {best}", _altitude(a, b)
        ),
        Panel("sent", "Velocity sent", "", both, _vectors(a, b, _sent, "m/s")),
        Panel("flown", "Velocity flown", "", f"{both} {best}", _vectors(a, b, _flown, "m/s")),
        Panel(
            "error",
            "Error of the estimated h",
            "",
            f"{both} Needs true states.",
            _series(a, b, _error, "error of h [mm]"),
        ),
        Panel("age", "Age of the target state", "", both, _series(a, b, _age, "age [ms]")),
        Panel("tick", "Time spent in a tick", "", f"{both} Wall clock.", _series(a, b, _exec, "time [µs]")),
    ]


_Lines = Callable[[Flight], tuple[Floats, Floats] | None]


def _h(a: Side, b: Side) -> go.Figure | None:
    figure = _series(a, b, _best_h, "h [m]")
    if figure is not None:
        figure.add_hline(0.0, line={"color": INK, "width": 1.4})
        figure.add_hline(VIOLATION_LIMIT_M, line={"color": BOUNDARY, "width": 1, "dash": "dot"})
    return figure


def _best_h(flight: Flight) -> tuple[Floats, Floats] | None:
    if flight.truth is not None:
        return low_envelope(flight.truth.t_s, flight.truth.h_min_m)
    steps = flight.steps
    return None if steps is None else (steps.t_s, np.where(steps.both_valid, steps.h_m, np.nan))


def _age(flight: Flight) -> tuple[Floats, Floats] | None:
    return None if flight.steps is None else (flight.steps.t_s, flight.steps.target_age_s * 1e3)


def _exec(flight: Flight) -> tuple[Floats, Floats] | None:
    return None if flight.timing is None else (flight.timing.t_s, flight.timing.exec_s * 1e6)


def _error(flight: Flight) -> tuple[Floats, Floats] | None:
    found = estimate_errors(flight)
    return None if found is None else (found.t_s, 1e3 * found.h_m)


def _series(a: Side, b: Side, values: _Lines, title: str) -> go.Figure | None:
    figure, ranges = go.Figure(), []
    for side in (a, b):
        found = values(side.flight)
        if found is None or not np.isfinite(found[1]).any():
            continue
        t, y = found[0] - zero_s(side.flight), np.where(np.isfinite(found[1]), found[1], np.nan)
        ranges.append(value_range(side.flight, [(t, y)]))
        figure.add_trace(line(t, y, side.name, _COLORS[side.name], width=1.6))
    if not ranges:
        return None
    layout(figure, 360)
    figure.update_yaxes(title_text=title, range=[min(r[0] for r in ranges), max(r[1] for r in ranges)])
    return _times(figure, a, b, 1)


def _sent(flight: Flight) -> tuple[Floats, Floats] | None:
    steps = flight.steps
    if steps is None or not steps.setpoint_sent.any():
        return None
    return steps.t_s, np.where(steps.setpoint_sent[:, None], steps.command_enu_m_s, np.nan)


def _flown(flight: Flight) -> tuple[Floats, Floats] | None:
    if flight.truth is not None:
        return flight.truth.t_s, flight.truth.velocity_enu_m_s
    steps = flight.steps
    return None if steps is None else (steps.t_s, steps.own_velocity_enu_m_s)


def _vectors(a: Side, b: Side, values: _Lines, unit: str) -> go.Figure | None:
    figure = rows_of(3, 0.045)
    drawn = False
    for side in (a, b):
        found = values(side.flight)
        if found is None:
            continue
        drawn = True
        for axis in range(3):
            trace = line(
                found[0] - zero_s(side.flight), found[1][:, axis], side.name, _COLORS[side.name], width=1.5,
                legendgroup=side.name, showlegend=axis == 0,
            )  # fmt: skip
            figure.add_trace(trace, row=axis + 1, col=1)
    if not drawn:
        return None
    layout(figure, 640)
    for axis in range(3):
        figure.update_yaxes(title_text=f"{AXES[axis]} [{unit}]", row=axis + 1, col=1)
    return _times(figure, a, b, 3)


def _altitude(a: Side, b: Side) -> go.Figure | None:
    figure, far, drawn = go.Figure(), 0.6, False
    for side in (a, b):
        tracks = relative_tracks(side.flight)
        if not tracks:
            continue
        drawn = True
        points = tracks[-1].points_m  # the best known comes last
        d = np.hypot(points[:, 0], points[:, 1])
        far = max(far, 1.1 * float(np.nanmax(d)))
        figure.add_trace(
            line(d, points[:, 2], f"{side.name}, {tracks[-1].name}", _COLORS[side.name], width=2)
        )
    if not drawn:
        return None
    for side in (a, b):
        if side.flight.barrier is not None:
            d = np.linspace(0.0, far, 300)
            dash = "solid" if side is a else "dash"
            edge = line(
                d, boundary_height_m(side.flight, d), f"h = 0 of {side.name}", LIMIT, width=1.4, dash=dash,
                fill="tozeroy" if side is a else None, fillcolor=UNSAFE,
            )  # fmt: skip
            figure.add_trace(edge)
    layout(figure, 440)
    figure.update_xaxes(title_text="horizontal distance d [m]", range=[0.0, far])
    figure.update_yaxes(title_text="relative altitude e<sub>z</sub> [m]")
    return figure


def _phases(a: Side, b: Side) -> go.Figure | None:
    figure, lanes = go.Figure(), []
    for side in (a, b):
        zero = zero_s(side.flight)
        spans = [
            (phase_name(p), begin, end, PHASE_SOLID.get(p, LIMIT))
            for p, begin, end in side.flight.phase_spans()
        ]
        faults = [(f.text, f.begin_s, f.end_s, FAULT) for f in fault_spans(side.flight)]
        for lane, bars in ((f"{side.name} phase", spans), (f"{side.name} fault", faults)):
            lanes += [lane] if bars else []
            for name, begin, end, color in bars:
                bar(figure, [begin - zero, end - zero], lane, color, name)
                if end - begin > 0.06 * side.flight.duration_s and color != FAULT:
                    figure.add_annotation(
                        x=(begin + end) / 2 - zero, y=lane, text=name, showarrow=False, font={"size": 10}
                    )
    if not lanes:
        return None
    layout(figure, 130 + 34 * len(lanes))
    _times(figure, a, b, 1)
    figure.update_layout(hovermode="closest", showlegend=False, margin={"t": 32, "b": 50, "l": 80})
    figure.update_yaxes(categoryorder="array", categoryarray=lanes[::-1], automargin=True)
    return figure


def _times(figure: go.Figure, a: Side, b: Side, rows: int) -> go.Figure:
    """The common time axis of both; see ``report_style.time_axis``."""
    shown = [shown_range(side.flight) for side in (a, b)]
    landing = [min(s[0] for s in shown), max(s[1] for s in shown)]
    ends = [(-zero_s(s.flight), s.flight.duration_s - zero_s(s.flight)) for s in (a, b)]
    whole = [min(e[0] for e in ends), max(e[1] for e in ends)]
    figure.update_layout(
        hovermode="x unified", meta={"time": True, "rows": rows, "landing": landing, "whole": whole}
    )
    figure.update_xaxes(range=landing)
    figure.update_xaxes(
        title_text="time since the landing began [s]",
        row=rows if rows > 1 else None,
        col=1 if rows > 1 else None,
    )
    return figure
