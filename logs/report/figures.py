"""All figures of the report in order, each with its description and source: charts and timeline.

The lanes of the timeline are phases, right of way, faults, valid and sent data of each vehicle, and events.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np
import plotly.graph_objects as go

from flightstack.core.safety.gate import GateVerdict
from flightstack.core.types import Intent
from logs.curves import BOUNDARY, CHARTS, COMMAND, INK, LIMIT, NOMINAL, Chart, Curve
from logs.reader.flight_data import Bools, Event, Fleet, Flight, Floats, phase_name
from logs.report import space
from logs.report.derived import Side, fault_spans
from logs.report.page import Panel
from logs.report.style import (
    FAULT,
    Axis,
    chart,
    light,
    line,
    low_envelope,
    phase_color,
    thin,
    value_range,
    words,
)
from logs.schema.events import Severity

_EVENTS_MAX = 500
_ROW_PX = 26
_INTENT_COLORS = {
    Intent.STANDING: "#d5d9de",
    Intent.WAITING: "#f5e3b3",
    Intent.LANDING: "#b5dcf3",
    Intent.COMMITTED: "#9ad6c3",
    Intent.CLEARING: "#efb08a",
    Intent.DOWN: "#e4e7eb",
}


class Bar(NamedTuple):
    lane: str
    begin_s: float
    end_s: float
    color: str
    text: str  # text that is shown when the pointer is on the bar
    label: str = ""  # text on the bar, if there is space


def timeline(axis: Axis, bars: Iterable[Bar], events: Sequence[Event], zero_s: float) -> go.Figure | None:
    """Draw bars in lanes, one for each name in the order of ``bars``, and a lane of events below.

    ``zero_s``: event time, s, that is zero on the axis. Returns ``None`` without bars and events.
    """
    found = list(bars)
    lanes = [*dict.fromkeys(bar.lane for bar in found), *["event"][: len(events)]]
    if not lanes:
        return None
    drawn = go.Bar(
        orientation="h", y=[bar.lane for bar in found], width=0.8, marker_color=[bar.color for bar in found],
        base=[bar.begin_s for bar in found], x=[bar.end_s - bar.begin_s for bar in found],
        text=[words(bar.label) for bar in found], textposition="inside", insidetextanchor="middle",
        textfont_color=INK, textangle=0, hovertemplate="%{hovertext}<extra></extra>",
        hovertext=[f"{words(bar.text)}<br>{bar.begin_s:.2f} to {bar.end_s:.2f} s" for bar in found],
    )  # fmt: skip
    shown = events[:_EVENTS_MAX]
    colors = [
        BOUNDARY if e.level >= Severity.ERROR else NOMINAL if e.level >= Severity.WARN else LIMIT
        for e in shown
    ]
    said = go.Scatter(
        x=[e.t_s - zero_s for e in shown], y=["event"] * len(shown), mode="markers", name="event",
        text=[words(f"{e.source}: {e.text}") for e in shown],
        marker={"symbol": "line-ns", "size": 14, "line": {"color": colors, "width": 2}},
        hovertemplate="%{x:.2f} s<br>%{text}<extra></extra>",
    )  # fmt: skip
    rows = {"categoryorder": "array", "categoryarray": lanes[::-1], "showgrid": False, "automargin": True}
    shown_first = axis._replace(first=axis.whole)
    height_px = 116 + _ROW_PX * len(lanes)
    figure = chart(shown_first, height_px, [(1, drawn), (1, said)], rows, hovermode="closest")
    labels = {"minsize": 10, "mode": "hide"}
    return figure.update_layout(showlegend=False, uniformtext=labels, margin={"t": 32, "b": 50, "l": 150})


def _bars(side: Side) -> Iterator[Bar]:
    """Yield phases, right of way and faults of a flight."""
    flight, zero_s, of = side.flight, side.offset_s, side.name
    for phase, begin_s, end_s in flight.phase_spans():
        name, color = phase_name(phase), phase_color(phase, bar=True)
        yield Bar(f"{of} phase", begin_s + zero_s, end_s + zero_s, color, f"{of} {name}", name)
    for span in flight.spans:
        name, others = span.intent.name.lower(), ", ".join(span.gives_way_to)
        color = NOMINAL if span.waits else _INTENT_COLORS[span.intent]
        text = f"{of} {name}" + (f", gives way to {others}" if others else "")
        label = f"waits for {others}" if span.waits else name
        yield Bar(f"{of} right of way", span.begin_s + zero_s, span.end_s + zero_s, color, text, label)
    for fault in fault_spans(flight):
        yield Bar(f"{of} fault injected", fault.begin_s + zero_s, fault.end_s + zero_s, FAULT, fault.text)


def _ticks(side: Side) -> Iterator[Bar]:
    """Yield bars of the times with set-points sent, barrier active, set-points refused, or data missing."""

    def lost(valid: Bools) -> Bools:
        return np.maximum.accumulate(valid) & ~valid  # missing now, but valid at an earlier tick

    steps = side.flight.steps
    if steps is None:
        return
    refused = (steps.gate != GateVerdict.APPROVED) & (steps.gate != GateVerdict.NOT_IN_CONTROL)
    for what, mask, color in (
        ("set-points sent", steps.setpoint_sent, COMMAND),
        ("barrier active", steps.barrier_active, BOUNDARY),
        ("refused by the gate", refused, FAULT),
        ("target missing or old", lost(steps.target_valid), FAULT),
        ("own state missing or old", lost(steps.own_valid), FAULT),
        ("link silent", lost(steps.link_valid), FAULT),
    ):
        edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
        times_s = steps.t_s[np.minimum(edges, len(mask) - 1)] + side.offset_s
        lane = f"{side.name} {what}"
        for begin_s, end_s in times_s.reshape(-1, 2).tolist():
            yield Bar(lane, begin_s, end_s, color, lane)


def _chart(what: Chart, side: Side, axis: Axis) -> go.Figure | None:
    """Draw a chart of a flight; ``None`` if the log has no data for it."""
    traces, axes, named = [], [], set[str]()
    for number, row in enumerate(what.rows, 1):
        shown: list[tuple[Floats, Floats]] = []
        for curve in row.curves:
            found = curve.values(side.flight)
            if found is None or not np.isfinite(found[1]).any():
                continue
            t_s, values = found[0] + side.offset_s, found[1]
            if row.lowest:
                t_s, values = low_envelope(t_s, values)
            traces.append((number, _trace(curve, t_s, values, first=curve.key not in named)))
            named.add(curve.key)
            if not curve.hidden:
                shown.append((t_s, values))
        axes.append({"title_text": row.title, **(row.axis or {"range": value_range(axis, shown)})})
    return chart(axis, what.height_px, traces, *axes, side=side) if traces else None


def _trace(curve: Curve, t_s: Floats, values: Floats, *, first: bool) -> go.Scatter:
    look = {"legendgroup": curve.key, "showlegend": first, "visible": "legendonly" if curve.hidden else True}
    if not curve.symbol:
        return line(t_s, values, curve.name, curve.color, dash=curve.dash, width=curve.width, **look)
    at = np.flatnonzero(np.isfinite(values))
    at = at[thin(len(at))]
    marker = {"symbol": curve.symbol, "size": 8, "color": curve.color}
    x, y = light(t_s[at]), light(values[at])
    return go.Scatter(x=x, y=y, mode="markers", name=curve.name, marker=marker, **look)


def overview(fleet: Fleet, sides: Sequence[Side], axis: Axis) -> tuple[Panel, Panel, Panel]:
    """Return the figures of all vehicles together: the main picture, the timeline, the paths in the room."""
    drawn = " ".join(dict.fromkeys(_drawn(side.flight) for side in sides))
    edges = "".join(dict.fromkeys(_edge(side.flight) for side in sides))
    bars = chain(*map(_bars, sides), *map(_ticks, sides))
    return (
        Panel(
            "relative", "Landing relative to the pad, over the barrier",
            f"{drawn} Surface: h = 0; unsafe below it.{edges}",
            space.trajectory_3d(fleet.flights), "Fig. 7, 10",
        ),
        Panel(
            "timeline", "The flight at a glance", _TIMELINE,
            timeline(axis, bars, fleet.events, fleet.landing_start_s or 0.0),
        ),
        Panel("room", "All paths in the room", _ROOM, space.room_3d(sides)),
    )  # fmt: skip


def panels(side: Side, axis: Axis) -> list[Panel]:
    """Return the figures of one vehicle, whose name is the first part of each key."""
    flight, drawn, of = side.flight, _drawn(side.flight), side.name
    return [
        Panel(
            f"{of}-altitude", "Relative altitude over horizontal distance",
            f"{drawn} Shaded: unsafe, h < 0.{_edge(flight)}",
            space.altitude_over_distance(flight), "Fig. 8, 11",
        ),
        Panel(f"{of}-plan", "Paths from above", f"{drawn} {_PLAN}", space.plan(flight), "Fig. 12"),
        *(
            Panel(f"{of}-{what.key}", what.title, what.note, _chart(what, side, axis), what.paper)
            for what in CHARTS
        ),
    ]  # fmt: skip


def _drawn(flight: Flight) -> str:
    """Return the text that names the source of the drawn paths."""
    if flight.truth is None:
        return "The vehicle's own estimate; the log holds no true states."
    return "Solid: true states of the simulator. Dashed: the vehicle's own estimate."


def _edge(flight: Flight) -> str:
    return "" if flight.barrier is not None else " The log does not name the barrier; none is drawn."


_ROOM = (
    "True paths, or the vehicles' own estimates where the log has no true states. Dotted: the pads. Circle: "
    "start. Square: end."
)
_TIMELINE = (
    "The whole log. Right of way: the intent that a vehicle sent to the others; orange: it flew and gave way "
    "to a neighbour. Touch or point at a bar or an event to read it; bands in the figures below have the "
    "same colours."
)
_PLAN = "Circle: where the landing began. Triangle: first contact with the pad. Square, ring: end of the log."
