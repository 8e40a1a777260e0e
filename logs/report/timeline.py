"""The whole flight in one picture: phases, faults, what was valid, what went out, every event at its time."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from flightstack.core.safety.gate import GateVerdict
from logs.reader.flight_data import Bools, Flight, Floats, phase_name
from logs.report.derived import fault_spans
from logs.report.style import (
    BOUNDARY,
    COMMAND,
    FAULT,
    INK,
    LIMIT,
    NOMINAL,
    PHASE_SOLID,
    light,
    time_axis,
    words,
    zero_s,
)
from logs.report.style import layout as common
from logs.schema.events import Severity

_EVENTS_MAX = 500
_LEVEL_COLOR = {Severity.WARN: NOMINAL, Severity.ERROR: BOUNDARY, Severity.FATAL: BOUNDARY}
_ROW_PX = 26
_LABEL_SHARE = 0.05  # of the log; a shorter phase carries no name


def timeline(flight: Flight) -> go.Figure | None:
    """Swim lanes over the whole log; ``None`` without steps and without events."""
    if flight.steps is None and not flight.events:
        return None
    lanes: list[str] = []
    figure, zero = go.Figure(), zero_s(flight)
    if flight.steps is not None:
        lanes.append("phase")
        _phases(figure, flight)
        steps, t = flight.steps, flight.steps.t_s - zero
        refused = (steps.gate != GateVerdict.APPROVED) & (steps.gate != GateVerdict.NOT_IN_CONTROL)
        told: tuple[tuple[str, Bools, str], ...] = (
            ("set-points sent", steps.setpoint_sent, COMMAND),
            ("barrier active", steps.barrier_active, BOUNDARY),
            ("refused by the gate", refused, FAULT),
            ("target missing or old", ~steps.target_valid, FAULT),
            ("own state missing or old", ~steps.own_valid, FAULT),
            ("link silent", ~steps.link_valid, FAULT),
        )
        for name, mask, color in told:
            if color is not FAULT or mask.any():
                lanes.append(name)
                _lane(figure, t, mask, name, color)
    spans = fault_spans(flight)
    if spans:
        lanes.append("fault injected")
        for span in spans:
            ends = [span.begin_s - zero, span.end_s - zero]
            bar(figure, ends, "fault injected", FAULT, span.text)
    if flight.events:
        lanes.append("event")
        _events(figure, flight)
    height_px = 116 + _ROW_PX * len(lanes)
    common(figure, height_px)
    time_axis(figure, flight)
    whole = figure.layout.meta["whole"]
    figure.update_layout(hovermode="closest", showlegend=False, margin={"t": 32, "b": 50, "l": 150})
    figure.update_xaxes(range=whole)
    figure.update_yaxes(categoryorder="array", categoryarray=lanes[::-1], showgrid=True, automargin=True)
    return figure


def bar(figure: go.Figure, ends: list[float], lane: str, color: str, text: str) -> None:
    """One bar of a lane from end to end; ``text`` shows where it is pointed at."""
    figure.add_trace(
        go.Scatter(
            x=ends, y=[lane, lane], mode="lines", line={"color": color, "width": 13},
            name=words(text), text=[words(text)] * 2, hovertemplate="%{text}<br>%{x:.2f} s<extra></extra>",
        )
    )  # fmt: skip


def _phases(figure: go.Figure, flight: Flight) -> None:
    zero = zero_s(flight)
    for phase, begin_s, end_s in flight.phase_spans():
        name = phase_name(phase)
        bar(figure, [begin_s - zero, end_s - zero], "phase", PHASE_SOLID.get(phase, LIMIT), name)
        if end_s - begin_s > _LABEL_SHARE * flight.duration_s:
            figure.add_annotation(
                x=(begin_s + end_s) / 2 - zero, y="phase", text=name, showarrow=False,
                font={"size": 10, "color": INK},
            )  # fmt: skip


def _lane(figure: go.Figure, t: Floats, mask: Bools, lane: str, color: str) -> None:
    """Bars where the mask is true; one line with breaks."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    begins, ends = edges[::2], np.minimum(edges[1::2], len(t) - 1)
    x = np.full(3 * len(begins), np.nan)
    x[0::3], x[1::3] = t[begins], t[ends]
    figure.add_trace(
        go.Scatter(
            x=light(x), y=[lane] * max(len(x), 1), mode="lines", line={"color": color, "width": 9}, name=lane,
            hovertemplate=f"{lane}<br>%{{x:.2f}} s<extra></extra>",
        )
    )  # fmt: skip


def _events(figure: go.Figure, flight: Flight) -> None:
    shown, zero = flight.events[:_EVENTS_MAX], zero_s(flight)
    colors = [_LEVEL_COLOR.get(e.level, LIMIT) for e in shown]  # type: ignore[call-overload]
    figure.add_trace(
        go.Scatter(
            x=[e.t_s - zero for e in shown], y=["event"] * len(shown), mode="markers", name="event",
            text=[words(f"{e.source}: {e.text}") for e in shown],
            marker={"symbol": "line-ns", "size": 14, "line": {"color": colors, "width": 2}},
            hovertemplate="%{x:.2f} s<br>%{text}<extra></extra>",
        )
    )  # fmt: skip
