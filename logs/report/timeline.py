"""Swim lanes over time: phases, faults, what was valid and sent, right of way, events."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from flightstack.core.safety.gate import GateVerdict
from flightstack.core.types import Intent
from logs.reader.fleet_messages import FleetMessages
from logs.reader.flight_data import Bools, Event, Fleet, Flight, Floats, phase_name
from logs.report.derived import Side, fault_spans
from logs.report.style import (
    BOUNDARY,
    COMMAND,
    FAULT,
    INK,
    LIMIT,
    NOMINAL,
    PHASE_SOLID,
    Axis,
    axis_of,
    fleet_axis,
    layout,
    light,
    time_axis,
    words,
    zero_s,
)
from logs.schema.events import Severity
from logs.verdict.verdict import shift_s

_EVENTS_MAX = 500
_SILENT_MAX = 16  # lanes of silent members; more are not read
_ROW_PX = 26
_LETTER_SHARE = 0.009  # of the axis, for a letter of a label; a bar that is too short carries none
_INTENT_COLORS = {
    Intent.STANDING: "#d5d9de",
    Intent.WAITING: "#f5e3b3",
    Intent.LANDING: "#b5dcf3",
    Intent.COMMITTED: "#9ad6c3",
    Intent.CLEARING: "#efb08a",
    Intent.DOWN: "#e4e7eb",
}


class _Lanes:
    """One figure of lanes, from top to bottom in the order of their first bar."""

    def __init__(self, axis: Axis) -> None:
        self._figure, self._axis, self._names = go.Figure(), axis, dict[str, None]()

    def bar(self, lane: str, ends: Sequence[float], color: str, text: str, label: str = "") -> None:
        """Add a bar; ``text`` shows where it is pointed at, ``label`` where there is space for it."""
        self._names[lane] = None
        self._figure.add_trace(
            go.Scatter(
                x=list(ends), y=[lane, lane], mode="lines", line={"color": color, "width": 13},
                name=words(text), text=[words(text)] * 2,
                hovertemplate="%{text}<br>%{x:.2f} s<extra></extra>",
            )
        )  # fmt: skip
        low, high = self._axis.whole
        if label and ends[1] - ends[0] > _LETTER_SHARE * len(label) * (high - low):
            self._figure.add_annotation(
                x=sum(ends) / 2, y=lane, text=label, showarrow=False, font={"size": 10, "color": INK}
            )

    def phases(self, lane: str, flight: Flight, offset_s: float, of: str = "") -> None:
        for phase, begin_s, end_s in flight.phase_spans():
            name, color = phase_name(phase), PHASE_SOLID.get(phase, LIMIT)
            self.bar(lane, (begin_s + offset_s, end_s + offset_s), color, f"{of}{name}", name)

    def faults(self, lane: str, flight: Flight, offset_s: float) -> None:
        for span in fault_spans(flight):
            self.bar(lane, (span.begin_s + offset_s, span.end_s + offset_s), FAULT, span.text)

    def mask(self, lane: str, t: Floats, mask: Bools, color: str) -> None:
        """Add bars where the mask is true, as one line with breaks."""
        self._names[lane] = None
        edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
        begins, ends = edges[::2], np.minimum(edges[1::2], len(t) - 1)
        x = np.full(3 * len(begins), np.nan)
        x[0::3], x[1::3] = t[begins], t[ends]
        self._figure.add_trace(
            go.Scatter(
                x=light(x), y=[lane] * max(len(x), 1), mode="lines", line={"color": color, "width": 9},
                name=lane, hovertemplate=f"{lane}<br>%{{x:.2f}} s<extra></extra>",
            )
        )  # fmt: skip

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

    def figure(self, range_s: Sequence[float] | None = None) -> go.Figure | None:
        """Return the figure, at first with this range of the axis; ``None`` without a lane."""
        figure, names = self._figure, list(self._names)
        if not names:
            return None
        layout(figure, 116 + _ROW_PX * len(names))
        time_axis(figure, self._axis)
        figure.update_layout(hovermode="closest", showlegend=False, margin={"t": 32, "b": 50, "l": 150})
        if range_s is not None:
            figure.update_xaxes(range=range_s)
        figure.update_yaxes(categoryorder="array", categoryarray=names[::-1], showgrid=True, automargin=True)
        return figure


def timeline(flight: Flight) -> go.Figure | None:
    """Draw the whole log; ``None`` without steps and without events."""
    axis, offset_s, steps = axis_of([flight]), -zero_s(flight), flight.steps
    lanes = _Lanes(axis)
    lanes.phases("phase", flight, offset_s)
    if steps is not None:
        refused = (steps.gate != GateVerdict.APPROVED) & (steps.gate != GateVerdict.NOT_IN_CONTROL)
        for name, mask, color in (
            ("set-points sent", steps.setpoint_sent, COMMAND),
            ("barrier active", steps.barrier_active, BOUNDARY),
            ("refused by the gate", refused, FAULT),
            ("target missing or old", ~steps.target_valid, FAULT),
            ("own state missing or old", ~steps.own_valid, FAULT),
            ("link silent", ~steps.link_valid, FAULT),
        ):
            if color is not FAULT or mask.any():
                lanes.mask(name, steps.t_s + offset_s, mask, color)
    lanes.faults("fault injected", flight, offset_s)
    lanes.events(flight.events, offset_s)
    return lanes.figure(axis.whole)


def compared_timeline(sides: Sequence[Side]) -> go.Figure | None:
    """Draw phases and faults of several flights."""
    lanes = _Lanes(axis_of([side.flight for side in sides]))
    for side in sides:
        lanes.phases(f"{side.name} phase", side.flight, -zero_s(side.flight))
        lanes.faults(f"{side.name} fault", side.flight, -zero_s(side.flight))
    return lanes.figure()


def fleet_timeline(fleet: Fleet, messages: FleetMessages) -> go.Figure | None:
    """Draw phases and right of way of all members, silent members, and events."""
    lanes = _Lanes(fleet_axis(fleet))
    for member, flight in fleet.flights.items():
        lanes.phases(f"{member} phase", flight, shift_s(fleet, flight), f"{member}: ")
        for span in messages.spans[member]:
            name, others = span.intent.name.lower(), ", ".join(span.gives_way_to)
            color = NOMINAL if span.waits else _INTENT_COLORS[span.intent]
            text = f"{member}: {name}" + (f", gives way to {others}" if others else "")
            label = f"waits for {others}" if span.waits else name
            lanes.bar(f"{member} right of way", (span.begin_s, span.end_s), color, text, label)
    for link in [link for link in messages.links if link.silent][:_SILENT_MAX]:
        for ends in link.silent:
            text = f"{link.receiver} received no message from {link.sender}"
            lanes.bar(f"{link.receiver} misses {link.sender}", ends, FAULT, text)
    lanes.events(fleet.events, 0.0)
    return lanes.figure()
