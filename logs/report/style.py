"""Common style of the report's figures: layout, phase bands, thinning."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from flightstack.common.text import one_line
from flightstack.core.types import Phase
from logs.curves import INK
from logs.reader.flight_data import Floats, phase_name
from logs.report.derived import Side, fault_spans

UNSAFE = "rgba(213, 94, 0, 0.13)"
GRID = "#e4e7eb"
FAULT = "#b00020"

# colours of the phases: red, green, blue, and opacity of the band behind curves
_PHASES: dict[Phase | int, tuple[int, int, int, float]] = {
    Phase.WAIT: (150, 150, 150, 0.10),
    Phase.TAKEOFF: (150, 150, 150, 0.20),
    Phase.APPROACH: (86, 180, 233, 0.12),
    Phase.LAND: (0, 158, 115, 0.14),
    Phase.TOUCHDOWN: (240, 228, 66, 0.40),
    Phase.LANDED: (0, 158, 115, 0.05),
    Phase.HOLD: (230, 159, 0, 0.22),
    Phase.CLIMB: (204, 121, 167, 0.20),
    Phase.ABORT: (213, 94, 0, 0.22),
    Phase.LEAVE: (86, 180, 233, 0.22),
}
_SPACE_PX = 640  # height of a spatial figure, pixels
_TOP_PX, _BOTTOM_PX, _LEGEND_PX = 40, 96, 54  # margins, and distance of the legend below the axis, pixels
POINTS_MAX = 4000  # maximum number of points of a line; more points are not visible and make the page large
_FAULT_STRIP = 0.965  # lower edge of the strip that marks a fault, as a fraction of the figure's height
LABEL_SHARE = 0.05  # minimum width of a band with a name, as a fraction of the axis
BEFORE_S, AFTER_S = 1.0, 3.0  # time shown initially before and after the landing, s
_LAST = (Phase.LANDED, Phase.ABORT)


def layout(figure: go.Figure, height_px: int) -> go.Figure:
    """Apply the common layout to a figure; the legend is below the title of the time axis."""
    plot_px = height_px - _TOP_PX - _BOTTOM_PX
    figure.update_layout(
        template="plotly_white",
        height=height_px,
        margin={"l": 64, "r": 20, "t": _TOP_PX, "b": _BOTTOM_PX},
        font={"family": "Inter, Segoe UI, Helvetica, Arial, sans-serif", "size": 13, "color": INK},
        legend={
            "orientation": "h",
            "x": 0.0,
            "y": -_LEGEND_PX / plot_px,
            "yanchor": "top",
            "traceorder": "normal",
        },
        hovermode="closest",
        paper_bgcolor="white",
        plot_bgcolor="white",
    )
    figure.update_xaxes(gridcolor=GRID, zeroline=False, linecolor="#9aa5b1", showline=True, ticks="outside")
    figure.update_yaxes(gridcolor=GRID, zeroline=False, linecolor="#9aa5b1", showline=True, ticks="outside")
    return figure


def layout_3d(figure: go.Figure, titles: tuple[str, str, str], **scene: Any) -> go.Figure:
    layout(figure, _SPACE_PX)
    axis = {"gridcolor": GRID, "backgroundcolor": "white", "zerolinecolor": GRID}
    axes = {
        f"{name}axis": {"title": {"text": title}, **scene.pop(f"{name}axis", {}), **axis}
        for name, title in zip("xyz", titles, strict=True)
    }
    return figure.update_layout(
        margin={"l": 0, "r": 0, "t": 10, "b": 40}, legend={"y": -0.02}, scene={**axes, **scene}
    )


def phase_color(phase: Phase | int, *, bar: bool = False) -> str:
    """Return the colour of a phase for the band behind curves, or a stronger colour for a bar."""
    red, green, blue, opacity = _PHASES.get(phase, (102, 102, 102, 0.05))
    return f"rgba({red}, {green}, {blue}, {0.2 + 1.5 * opacity if bar else opacity:.3g})"


class Axis(NamedTuple):
    """A time axis; the page moves all figures with the same axis together."""

    title: str
    landing: list[float]  # range of the page's button "Landing"
    whole: list[float]  # range of the page's button "Whole flight"
    first: list[float]  # initial range of the axis


def axis_of(sides: Sequence[Side]) -> Axis:
    """Return the axis of a page; zero is the start of the first landing, or else the start of the log."""
    began = any(side.flight.landing_start_s is not None for side in sides)
    whole = [min(s.offset_s for s in sides), max(s.flight.duration_s + s.offset_s for s in sides)]
    landing = whole
    if began:  # the range covers all landings, and some seconds before the first and after the last
        landing = [max(-BEFORE_S, whole[0]), max(map(_landing_end_s, sides))]
    return Axis(f"time since the {'first landing' if began else 'log'} began [s]", landing, whole, landing)


def _landing_end_s(side: Side) -> float:
    """Return the time on the page, s, at which the range of a landing ends."""
    duration_s = side.flight.duration_s
    ends_s = (begin_s + AFTER_S for phase, begin_s, _ in side.flight.phase_spans() if phase in _LAST)
    return min(next(ends_s, duration_s), duration_s) + side.offset_s


def _add_phases(figure: go.Figure, axis: Axis, side: Side) -> None:
    """Shade the phases in a figure, write their names above the figure, and mark the faults by a strip."""
    (low, high), offset_s, spans = axis.first, side.offset_s, side.flight.phase_spans()
    bands = [(begin_s, end_s, 0.0, phase_color(phase)) for phase, begin_s, end_s in spans]
    bands += [(fault.begin_s, fault.end_s, _FAULT_STRIP, FAULT) for fault in fault_spans(side.flight)]
    # all shapes are added at once, because plotly checks all of them at each addition
    figure.layout.shapes += tuple(
        go.layout.Shape(
            type="rect", xref="x", yref="paper", x0=begin_s + offset_s, x1=end_s + offset_s, y0=bottom, y1=1,
            fillcolor=color, line={"width": 0}, layer="below",
        )
        for begin_s, end_s, bottom, color in bands
    )  # fmt: skip
    names = []
    for phase, begin_s, end_s in spans:
        left, right = max(begin_s + offset_s, low), min(end_s + offset_s, high)
        if right - left >= LABEL_SHARE * (high - low):
            names.append(
                go.layout.Annotation(
                    x=(left + right) / 2, y=1.0, xref="x", yref="paper", yanchor="bottom", showarrow=False,
                    text=phase_name(phase), font={"size": 10, "color": "#616e7c"},
                )
            )  # fmt: skip
    figure.layout.annotations += tuple(names)


def chart(
    axis: Axis, height_px: int, traces: Iterable[tuple[int, go.Scatter]], *axes: dict[str, Any],
    side: Side | None = None, hovermode: str = "x unified",
) -> go.Figure:  # fmt: skip
    """Draw traces over time, each in its row (1 is the top).

    ``axes``: y axis of each row; ``side``: flight whose phases and faults are marked; None: no marks.
    """
    rows = len(axes)
    figure = make_subplots(rows=rows, cols=1, shared_xaxes=True, vertical_spacing=0.05)
    for row, trace in traces:
        figure.add_trace(trace, row=row, col=1)
    layout(figure, height_px)
    if side is not None:
        _add_phases(figure, axis, side)
    time = {"time": True, "rows": rows, "landing": axis.landing, "whole": axis.whole}
    figure.update_layout(hovermode=hovermode, meta=time)
    figure.update_xaxes(range=axis.first)
    figure.update_xaxes(title_text=axis.title, row=rows, col=1)
    for row, y_axis in enumerate(axes, 1):
        figure.update_yaxes(**y_axis, row=row, col=1)
    return figure


def line(x: Floats, y: Floats, name: str, color: str, **more: Any) -> go.Scatter:
    """Return a thinned line; keyword arguments set the line (``dash``, ``width``) or the trace."""
    keep = thin(len(x))
    style = {"color": color, "width": more.pop("width", 1.8), "dash": more.pop("dash", "solid")}
    return go.Scatter(x=light(x[keep]), y=light(y[keep]), name=name, mode="lines", line=style, **more)


def thin(n: int) -> slice:
    """Return a slice that selects every k-th of n points, so that at most ``POINTS_MAX`` remain."""
    return slice(None, None, max(1, -(-n // POINTS_MAX)))


def value_range(axis: Axis, shown: list[tuple[Floats, Floats]]) -> list[float]:
    """Return the range of values within the initial time range, including zero and a margin."""
    low_s, high_s = axis.first
    inside = np.concatenate(
        [h[(t >= low_s) & (t <= high_s) & np.isfinite(h)] for t, h in shown] + [np.zeros(1)]
    )
    low, high = float(inside.min()), float(inside.max())
    air = 0.06 * max(high - low, 0.02)
    return [low - air, high + air]


def low_envelope(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Thin a curve: keep the smallest value of each block of samples, so that no minimum is lost."""
    step = max(1, -(-len(x) // POINTS_MAX))
    starts = np.arange(0, len(x), step)
    return x[starts], np.fmin.reduceat(y, starts) if len(x) else y


def light(values: Floats) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Convert numbers to four-byte floats: seven digits suffice on a screen and halve the page's size."""
    return np.asarray(values, dtype=np.float32)


def words(text: str) -> str:
    """Escape a text for a figure, where plotly interprets some HTML and ``%{...}``."""
    escaped = html.escape(one_line(text), quote=False)
    return escaped.replace("%{", "%&#123;")
