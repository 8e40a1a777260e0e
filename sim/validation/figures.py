"""Figures of a comparison with recorded flights."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from logs.curves import BOUNDARY, FLOWN, LIMIT, NOMINAL, TRUE
from logs.report.style import layout

Summary = dict[str, Any]
DEGREES = 57.29578
_SIDES = ("recorded", "simulated")


def _bars(
    names: Sequence[str], found: Sequence[Summary], color: str, name: str, scale: float, **more: Any
) -> Any:
    """Return bars with the interval of each value."""
    each = np.array([(f["value"], *f["interval"]) for f in found], dtype=np.float64)  # None becomes NaN
    values, low, high = scale * each.T
    return go.Bar(
        x=list(names), y=values, name=name, legendgroup=name, marker={"color": color},
        error_y={"type": "data", "array": high - values, "arrayminus": values - low, "color": "#1f2933",
                 "thickness": 1}, **more,
    )  # fmt: skip


def _titled(figure: go.Figure) -> go.Figure:
    """Make room for the subplots' titles below the buttons, in a smaller font."""
    figure.update_layout(margin={"t": 64})
    figure.update_annotations(font={"size": 13})
    return figure


def open_loop(told: Summary) -> go.Figure | None:
    """Return the errors of model, constant velocity and ideal body after each horizon."""
    if not any(one["open_loop"] for one in told["by_flight"]):
        return None
    shown = (("position_m", "position [mm]", 1000.0), ("velocity_m_s", "velocity [mm/s]", 1000.0),
             ("attitude_rad", "attitude [degrees]", DEGREES))  # fmt: skip
    figure = make_subplots(rows=1, cols=3, subplot_titles=[text for _, text, _ in shown])
    names = [f"{seconds} s" for seconds in told["open_loop"]]
    colors = {"model": TRUE, "constant_velocity": LIMIT, "ideal": NOMINAL}
    for column, (quantity, _, scale) in enumerate(shown, 1):
        for predictor, color in colors.items():
            found = [
                {"value": each[quantity][predictor], "interval": each[quantity]["interval"][predictor]}
                for each in told["open_loop"].values()
            ]
            figure.add_trace(
                _bars(names, found, color, predictor.replace("_", " "), scale, showlegend=column == 1),
                row=1, col=column,
            )  # fmt: skip
    return _titled(layout(figure, 400))


_FLOWN = (
    ("tracking error, level [mm]", "horizontal_m", 1000.0, (0.75, 1.25)),
    ("tracking error, vertical [mm]", "vertical_m", 1000.0, (0.75, 1.25)),
    ("mean PWM [%]", "duty", 100.0, (0.97, 1.03)),
    ("time with a saturated motor [%]", "saturated", 100.0, (0.5, 2.0)),
    ("tilt, rms [degrees]", "tilt_rms_rad", DEGREES, ()),
    ("fall of the battery [mV/s]", "sag_v_s", 1000.0, ()),
)


def closed_loop(told: Summary) -> go.Figure | None:
    """Return the ratio of simulated to recorded values of each flight."""
    flights = [one for one in told["by_flight"] if one["closed_loop"]]
    if not flights:
        return None
    figure = make_subplots(
        rows=2, cols=3, subplot_titles=[text for text, *_ in _FLOWN], vertical_spacing=0.16
    )
    for place, (_, key, scale, limits) in enumerate(_FLOWN):
        where = {"row": place // 3 + 1, "col": place % 3 + 1}
        recorded, simulated = ([scale * one["closed_loop"][side][key] for one in flights] for side in _SIDES)
        low, high = min(*recorded, *simulated), max(*recorded, *simulated)
        low, high = low - 0.05 * (high - low), high + 0.05 * (high - low)
        for factor in (1.0, *limits):
            style = {"color": LIMIT} if factor == 1.0 else {"color": BOUNDARY, "dash": "dash"}
            figure.add_scatter(
                x=[low, high], y=[factor * low, factor * high], mode="lines", line=style | {"width": 1},
                hoverinfo="skip", showlegend=False, **where,
            )  # fmt: skip
        figure.add_scatter(
            x=recorded, y=simulated, mode="markers", marker={"color": FLOWN, "size": 7},
            text=[one["name"] for one in flights], showlegend=False, **where,
        )  # fmt: skip
        figure.update_xaxes(title_text="recorded", range=[low, high], **where)
        figure.update_yaxes(title_text="simulated" if where["col"] == 1 else "", range=[low, high], **where)
    return _titled(layout(figure, 700))


def sensing(told: Summary) -> go.Figure | None:
    """Return the error by speed, and the delay of each flight, for position and velocity."""
    flights = [one for one in told["by_flight"] if one["sensing"]]
    if not flights:
        return None
    rows = (("position", "mm"), ("velocity", "mm/s"))
    titles = [
        text
        for name, unit in rows
        for text in (f"{name}: level error [{unit}] by speed [m/s]", f"{name}: delay [ms]")
    ]
    figure = make_subplots(rows=2, cols=2, subplot_titles=titles, vertical_spacing=0.2)
    for row, (name, _) in enumerate(rows, 1):
        found = told["sensing"][name]
        speeds = [f"{low:g}–{high:g}" for low, high in pairwise(found["speed_m_s"])]
        for side, color in zip(_SIDES, (FLOWN, TRUE), strict=True):
            bars = _bars(speeds, found[side]["by_speed"], color, side, 1000.0, showlegend=row == 1)
            figure.add_trace(bars, row=row, col=1)
            figure.add_box(
                y=[1000.0 * one["sensing"][side][name]["delay_s"] for one in flights], name=side,
                boxpoints="all", text=[one["name"] for one in flights], marker={"color": color, "size": 4},
                showlegend=False, legendgroup=side, row=row, col=2,
            )  # fmt: skip
    return _titled(layout(figure, 720))
