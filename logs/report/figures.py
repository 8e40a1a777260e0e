"""All figures of the report in order, each with its description and source, and the timeline.

The lanes of the timeline are phases, faults, valid and sent data, right of way, and events.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from flightstack.core.safety.gate import GateVerdict
from flightstack.core.types import Intent
from logs.curves import BOUNDARY, CHARTS, COMMAND, INK, LIMIT, NOMINAL
from logs.reader.flight_data import Bools, Event, Fleet, Floats, phase_name
from logs.report import series, space
from logs.report.derived import Side, fault_spans
from logs.report.page import Panel
from logs.report.style import (
    FAULT,
    Axis,
    axis_of,
    fleet_axis,
    layout,
    light,
    phase_color,
    time_axis,
    words,
)
from logs.schema.events import Severity
from logs.verdict.types import RADIUS_ABOVE_M, RADIUS_BESIDE_M
from logs.verdict.verdict import PairSeries

_EVENTS_MAX = 500
_ROW_PX = 26
_LETTER_SHARE = 0.009  # fraction of the axis per letter of a label; a shorter bar has no label
_INTENT_COLORS = {
    Intent.STANDING: "#d5d9de",
    Intent.WAITING: "#f5e3b3",
    Intent.LANDING: "#b5dcf3",
    Intent.COMMITTED: "#9ad6c3",
    Intent.CLEARING: "#efb08a",
    Intent.DOWN: "#e4e7eb",
}


class _Lanes:
    """Builds a figure of lanes; lanes are from top to bottom in the order of their first bar."""

    def __init__(self, axis: Axis) -> None:
        self._figure, self._axis, self._names = go.Figure(), axis, dict[str, None]()

    def _line(self, lane: str, x: Any, color: str, width: int, text: str) -> None:
        """Add a line to a lane; the pointer shows ``text``."""
        self._names[lane] = None
        self._figure.add_trace(
            go.Scatter(
                x=x, y=[lane] * max(len(x), 1), mode="lines", line={"color": color, "width": width},
                name=text, hovertemplate=f"{text}<br>%{{x:.2f}} s<extra></extra>",
            )
        )  # fmt: skip

    def bar(self, lane: str, ends: Sequence[float], color: str, text: str, label: str = "") -> None:
        """Add a bar; the pointer shows ``text``, the bar shows ``label`` if there is space."""
        self._line(lane, list(ends), color, 13, words(text))
        low, high = self._axis.whole
        if label and ends[1] - ends[0] > _LETTER_SHARE * len(label) * (high - low):
            self._figure.add_annotation(
                x=sum(ends) / 2, y=lane, text=label, showarrow=False, font={"size": 10, "color": INK}
            )

    def phases(self, lane: str, side: Side) -> None:
        for phase, begin_s, end_s in side.flight.phase_spans():
            name, color = phase_name(phase), phase_color(phase, bar=True)
            self.bar(lane, (begin_s + side.offset_s, end_s + side.offset_s), color, f"{side.of}{name}", name)

    def mask(self, lane: str, t: Floats, mask: Bools, color: str) -> None:
        """Add bars where the mask is true, as one line with breaks."""
        edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
        begins, ends = edges[::2], np.minimum(edges[1::2], len(t) - 1)
        x = np.full(3 * len(begins), np.nan)
        x[0::3], x[1::3] = t[begins], t[ends]
        self._line(lane, light(x), color, 9, lane)

    def events(self, events: Sequence[Event], offset_s: float) -> None:
        if not events:
            return
        self._names["event"] = None
        shown = events[:_EVENTS_MAX]
        colors = [
            BOUNDARY if e.level >= Severity.ERROR else NOMINAL if e.level >= Severity.WARN else LIMIT
            for e in shown
        ]
        self._figure.add_trace(
            go.Scatter(
                x=[e.t_s + offset_s for e in shown], y=["event"] * len(shown), mode="markers", name="event",
                text=[words(f"{e.source}: {e.text}") for e in shown],
                marker={"symbol": "line-ns", "size": 14, "line": {"color": colors, "width": 2}},
                hovertemplate="%{x:.2f} s<br>%{text}<extra></extra>",
            )
        )  # fmt: skip

    def figure(self) -> go.Figure | None:
        """Return the figure, which at first shows the whole time axis; None if it has no lane."""
        figure, names = self._figure, list(self._names)
        if not names:
            return None
        layout(figure, 116 + _ROW_PX * len(names))
        time_axis(figure, self._axis)
        figure.update_layout(hovermode="closest", showlegend=False, margin={"t": 32, "b": 50, "l": 150})
        figure.update_xaxes(range=self._axis.whole)
        figure.update_yaxes(categoryorder="array", categoryarray=names[::-1], showgrid=True, automargin=True)
        return figure


def timeline(
    sides: Sequence[Side], axis: Axis, events: Sequence[Event] = (), zero_s: float = 0.0
) -> go.Figure | None:
    """Draw phases, faults, right of way and events; for one flight also sent and missing data.

    ``zero_s``: zero of the page in the times of the events. The result is ``None`` if there is no lane.
    """
    lanes = _Lanes(axis)
    for side in sides:
        lanes.phases(f"{side.of}phase", side)
        if axis.flight is not None:
            _ticks(lanes, side)
        for fault in fault_spans(side.flight):
            ends = (fault.begin_s + side.offset_s, fault.end_s + side.offset_s)
            lanes.bar(f"{side.of}fault injected", ends, FAULT, fault.text)
        for span in side.flight.spans:
            name, others = span.intent.name.lower(), ", ".join(span.gives_way_to)
            color = NOMINAL if span.waits else _INTENT_COLORS[span.intent]
            text = f"{side.of}{name}" + (f", gives way to {others}" if others else "")
            label = f"waits for {others}" if span.waits else name
            ends = (span.begin_s + side.offset_s, span.end_s + side.offset_s)
            lanes.bar(f"{side.of}right of way", ends, color, text, label)
    lanes.events(events, -zero_s)
    return lanes.figure()


def _lost(valid: Bools) -> Bools:
    """Return a mask of the ticks in which data are missing that were present before."""
    return np.maximum.accumulate(valid) & ~valid


def _ticks(lanes: _Lanes, side: Side) -> None:
    """Add a lane for each state of a tick: set-point sent, barrier active, set-point refused, no data."""
    steps = side.flight.steps
    if steps is None:
        return
    refused = (steps.gate != GateVerdict.APPROVED) & (steps.gate != GateVerdict.NOT_IN_CONTROL)
    for name, mask, color in (
        ("set-points sent", steps.setpoint_sent, COMMAND),
        ("barrier active", steps.barrier_active, BOUNDARY),
        ("refused by the gate", refused, FAULT),
        ("target missing or old", _lost(steps.target_valid), FAULT),
        ("own state missing or old", _lost(steps.own_valid), FAULT),
        ("link silent", _lost(steps.link_valid), FAULT),
    ):
        if mask.any():
            lanes.mask(name, steps.t_s + side.offset_s, mask, color)


def panels(side: Side) -> list[Panel]:
    """Return the figures of one flight; the first is the main picture."""
    flight, axis = side.flight, axis_of(side.flight)
    both = "Solid: true states of the simulator. Dashed: the vehicle's own estimate."
    source = both if flight.truth is not None else "The vehicle's own estimate; the log holds no true states."
    edge = "" if flight.barrier is not None else " The log does not name the barrier; none is drawn."
    return [
        Panel(
            "relative", "Landing relative to the pad, over the barrier",
            f"{source} Surface: h = 0; unsafe below it.{edge}", space.trajectory_3d(flight), "Fig. 7, 10",
        ),
        Panel(
            "timeline", "The flight at a glance", _TIMELINE,
            timeline([side], axis, flight.events, -side.offset_s),
        ),
        Panel(
            "altitude", "Relative altitude over horizontal distance",
            f"{source} Shaded: unsafe, h < 0.{edge}",
            space.altitude_over_distance(flight), "Fig. 8, 11",
        ),
        Panel("plan", "Paths from above", f"{source} {_PLAN}", space.plan(flight), "Fig. 12"),
        *(Panel(of.key, of.title, of.note, series.draw(of, flight), of.paper) for of in CHARTS),
    ]  # fmt: skip


def fleet_panels(fleet: Fleet, sides: Sequence[Side], pairs: Sequence[PairSeries]) -> list[Panel]:
    """Return the figures of a fleet; the first is the main picture."""
    axis = fleet_axis(fleet)
    return [
        Panel("room", "All paths in the room", _ROOM, space.room_3d(sides)),
        Panel(
            "timeline", "Who did what, and who waited for whom", _LANES,
            timeline(sides, axis, fleet.events),
        ),
        Panel("pairs", "Distance of the nearest pairs", _NEAR, series.distances(pairs, axis)),
    ]  # fmt: skip


_LANES = (
    "Two lanes for each member: its phase, and the intent that it sent to the others. Orange: it flew and "
    "gave way to a neighbour. Touch or point at a bar to read it."
)
_ROOM = (
    "True paths, or the vehicles' own estimates where the log has no true states. Dotted: the pads. Circle: "
    "start. Square: end."
)
_NEAR = (
    f"By true states. The ellipsoid of two vehicles has the semi-axes {2 * RADIUS_BESIDE_M:g} m sideways and "
    f"{2 * RADIUS_ABOVE_M:g} m up and down; its measure is 1 on the surface, below is too near. It counts "
    f"while both fly; thin: one of them rests. Of many pairs, the {series.PAIRS_SHOWN} nearest are drawn."
)
_TIMELINE = (
    "The whole log. Touch or point at a bar or an event to read it; bands in the figures below have the same "
    "colours."
)
_PLAN = "Circle: where the landing began. Triangle: first contact with the pad. Square, ring: end of the log."
