"""The page of a comparison: criteria, what was left out, and pictures; one HTML file, no network needed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from logs.report.page import block, details, header, html, need_libraries, page, paragraph, section, table

if TYPE_CHECKING:
    import plotly.graph_objects as go

Told = dict[str, Any]

_CRITERIA = (
    "Ratios of rms errors where nothing else is said. Found: over flights, with an interval of 95 % by "
    "bootstrap over flights. Open: outside the limit, but chance explains it, or nobody flew so."
)
_OPEN_LOOP = (
    "Started every 0.1 s from the recorded state, with the recorded motor commands and voltage. "
    "Bars: median over flights of the rms error in a flight; lines on them: 95 % interval."
)
_RATIOS = (
    "Each flight: error of the model over that of constant velocity. Dashed: the limit for the median flight "
    "after 0.1 and 0.25 s."
)
_CLOSED_LOOP = (
    "Each flight, flown again by the simulated firmware from the recorded set-points. On the line "
    "simulation and recording agree; dashed: the limits of the criteria."
)
_FLIGHTS = (
    "Open loop: error of position after 0.1 / 0.25 / 0.5 s. Tracking (level) and delay of the estimated "
    "position: recorded / simulated."
)
_SENSING = (
    "Error of the vehicle's own estimate along the same true path, recorded and simulated; constant delay "
    "and offset are taken out of errors and spectrum. Lines on the bars: 95 % interval."
)


def render(told: Told) -> str:
    """Return the page as text.

    ``told``: what ``summary`` returns.
    Raises ReportError: the plotting or the template library is not installed.
    """
    need_libraries()
    title = f"{told['vehicle']} beside recorded flights"
    badge, style = ("passed", "good") if told["passed"] else ("not passed", "bad")
    sub = f"{told['used']} of {told['flights']} flights, {told['used_s']:.0f} s · {told['folder']}"
    rows = [
        (one["part"], one["text"], one["limit"], one["found"], one["word"], one["reason"])
        for one in told["criteria"]
    ]  # fmt: skip
    head = ("part", "criterion", "limit", "found", "", "reason of the limit")
    body = (
        header(title, badge, style, sub),
        block("causes", "Why it did not pass", "", html("".join(map(paragraph, told["causes"]))))
        if told["causes"]
        else "",
        block("criteria", "Criteria", _CRITERIA, table(head, rows, numbers=(2, 3), row_class=4)),
        block("left_out", "Left out", "What was not compared, and why.", _left_out(told)),
        *_figures(told),
        block("flights", "Flights", _FLIGHTS, _flights(told)),
        f"<section>{details('Everything as JSON', _json(told), 'validate.json')}</section>",
    )  # fmt: skip
    return page(title, "".join(body))


def _json(told: Told) -> str:
    import json

    return json.dumps({key: value for key, value in told.items() if key != "by_flight"}, indent=1)


def _left_out(told: Told) -> str:
    rows = [
        (each["name"], what, "; ".join(each["reasons"]))
        for key, what in (("left_out", "whole"), ("cut", "parts"))
        for each in told[key]
    ]
    return table(("flight", "what", "reasons"), rows) if rows else "Nothing."


def _flights(told: Told) -> str:
    def number(text: str, value: float | None, scale: float = 1.0) -> str:
        return text.format(scale * value) if value is not None else ""

    rows = []
    for one in told["by_flight"]:
        horizons = (one["open_loop"] or {}).get("horizons", [])
        errors = [number("{:.0f}", h["position_m"]["model"], 1000.0) for h in horizons]
        closed, sensed = one["closed_loop"], one["sensing"]
        tracking = [
            number("{:.0f}", closed[side]["horizontal_m"], 1000.0) if closed else "" for side in _SIDES
        ]
        delay = [
            number("{:.0f}", sensed[side]["position"]["delay_s"], 1000.0) if sensed else "" for side in _SIDES
        ]
        rows.append((one["name"], f"{one['used_s']:.1f}", closed["controller"] if closed else "",
                     " / ".join(errors), " / ".join(tracking), " / ".join(delay)))  # fmt: skip
    head = (
        "flight", "used [s]", "controller", "open loop [mm]", "tracking [mm]", "delay [ms]",
    )  # fmt: skip
    return table(head, rows, numbers=(1, 3, 4, 5))


_SIDES = ("recorded", "simulated")


def _figures(told: Told) -> list[str]:
    drawn: tuple[tuple[str, str, str, Callable[[Told], go.Figure | None]], ...] = (
        ("open_loop", "Open loop", _OPEN_LOOP, open_loop),
        ("ratios", "Open loop, flight by flight", _RATIOS, ratios),
        ("closed_loop", "Closed loop", _CLOSED_LOOP, closed_loop),
        ("sensing", "Own state", _SENSING, sensing),
    )
    return [section(key, title, "", note, draw(told)) for key, title, note, draw in drawn]


def _bars(
    names: Sequence[str], found: Sequence[Told], color: str, name: str, scale: float, **more: Any
) -> Any:
    """Bars with the interval of each value."""
    import plotly.graph_objects as go

    values = [scale * f["value"] if f["value"] is not None else None for f in found]
    ends = [
        [scale * end if end is not None and f["value"] is not None else None for end in f["interval"]]
        for f in found
    ]
    up = [e[1] - v if e[1] is not None and v is not None else None for e, v in zip(ends, values, strict=True)]
    down = [
        v - e[0] if e[0] is not None and v is not None else None for e, v in zip(ends, values, strict=True)
    ]
    return go.Bar(
        x=list(names), y=values, name=name, legendgroup=name, marker={"color": color},
        error_y={"type": "data", "array": up, "arrayminus": down, "color": "#1f2933", "thickness": 1}, **more,
    )  # fmt: skip


def _titled(figure: go.Figure) -> go.Figure:
    """Make room for the titles of subplots below the buttons, in smaller type."""
    figure.update_layout(margin={"t": 64})
    figure.update_annotations(font={"size": 13})
    return figure


def open_loop(told: Told) -> go.Figure | None:
    """Errors of model, constant velocity and ideal body after each horizon."""
    from plotly.subplots import make_subplots

    from logs.report.style import LIMIT, NOMINAL, TRUE, layout

    if not any(one["open_loop"] for one in told["by_flight"]):
        return None
    shown = (("position_m", "position [mm]", 1000.0), ("velocity_m_s", "velocity [mm/s]", 1000.0),
             ("attitude_rad", "attitude [degrees]", 57.29578))  # fmt: skip
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


def ratios(told: Told) -> go.Figure | None:
    """Ratio of the model's error of position and velocity to that of constant velocity, by flight."""
    from plotly.subplots import make_subplots

    from logs.report.style import BOUNDARY, COMMAND, ESTIMATED, TRUE, layout

    flights = [one for one in told["by_flight"] if one["open_loop"]]
    if not flights:
        return None
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    names = [one["name"] for one in flights]
    for row, (quantity, text) in enumerate((("position_m", "position"), ("velocity_m_s", "velocity")), 1):
        for place, color in enumerate((ESTIMATED, TRUE, COMMAND)):
            each = [one["open_loop"]["horizons"][place] for one in flights]
            figure.add_scatter(
                x=names, y=[h[quantity]["model"] / h[quantity]["constant_velocity"] for h in each],
                mode="markers", marker={"color": color, "size": 7}, name=f"{each[0]['seconds']:g} s",
                legendgroup=str(place), showlegend=row == 1, row=row, col=1,
            )  # fmt: skip
        figure.add_hline(y=0.5, line={"color": BOUNDARY, "dash": "dash", "width": 1}, row=row, col=1)
        figure.update_yaxes(title_text=text, rangemode="tozero", row=row, col=1)
    layout(figure, 620)
    figure.update_layout(margin={"b": 170}, legend={"y": 1.0, "yanchor": "bottom"})
    figure.update_xaxes(tickangle=90, tickfont={"size": 10}, automargin=True)
    return figure


_FLOWN = (
    ("tracking error, level [mm]", "horizontal_m", 1000.0, (0.75, 1.25)),
    ("tracking error, vertical [mm]", "vertical_m", 1000.0, (0.75, 1.25)),
    ("mean PWM [%]", "duty", 100.0, (0.97, 1.03)),
    ("time with a saturated motor [%]", "saturated", 100.0, (0.5, 2.0)),
    ("tilt, rms [degrees]", "tilt_rms_rad", 57.29578, ()),
    ("fall of the battery [mV/s]", "sag_v_s", 1000.0, ()),
)


def closed_loop(told: Told) -> go.Figure | None:
    """Simulated over recorded values of each flight."""
    from plotly.subplots import make_subplots

    from logs.report.style import BOUNDARY, FLOWN, LIMIT, TRUE, layout

    flights = [one for one in told["by_flight"] if one["closed_loop"]]
    if not flights:
        return None
    figure = make_subplots(
        rows=2, cols=3, subplot_titles=[text for text, *_ in _FLOWN], vertical_spacing=0.16
    )
    colors = dict(
        zip(sorted({one["closed_loop"]["controller"] for one in flights}), (FLOWN, TRUE), strict=False)
    )
    for place, (_, key, scale, limits) in enumerate(_FLOWN):
        where = {"row": place // 3 + 1, "col": place % 3 + 1}
        recorded, simulated = ([scale * one["closed_loop"][side][key] for one in flights] for side in _SIDES)
        low, high = min(*recorded, *simulated), max(*recorded, *simulated)
        low, high = low - 0.05 * (high - low), high + 0.05 * (high - low)
        for factor in (1.0, *limits):
            style = (
                {"color": LIMIT, "width": 1}
                if factor == 1.0
                else {"color": BOUNDARY, "dash": "dash", "width": 1}
            )
            figure.add_scatter(
                x=[low, high], y=[factor * low, factor * high], mode="lines", line=style, hoverinfo="skip",
                showlegend=False, **where,
            )  # fmt: skip
        for controller, color in colors.items():
            chosen = [i for i, one in enumerate(flights) if one["closed_loop"]["controller"] == controller]
            figure.add_scatter(
                x=[recorded[i] for i in chosen], y=[simulated[i] for i in chosen], mode="markers",
                marker={"color": color, "size": 7}, text=[flights[i]["name"] for i in chosen],
                name=controller, legendgroup=controller, showlegend=place == 0, **where,
            )  # fmt: skip
        figure.update_xaxes(title_text="recorded", range=[low, high], **where)
        figure.update_yaxes(title_text="simulated" if where["col"] == 1 else "", range=[low, high], **where)
    return _titled(layout(figure, 700))


def sensing(told: Told) -> go.Figure | None:
    """Error by speed, spectrum, and delay of each flight, for position and velocity."""
    from plotly.subplots import make_subplots

    from logs.report.style import FLOWN, TRUE, layout

    flights = [one for one in told["by_flight"] if one["sensing"]]
    if not flights:
        return None
    rows = (("position", "mm"), ("velocity", "mm/s"))
    titles = [
        text
        for name, unit in rows
        for text in (
            f"{name}: level error [{unit}] by speed [m/s]",
            f"{name}: share of power by band [Hz]",
            f"{name}: delay [ms]",
        )
    ]
    figure = make_subplots(rows=2, cols=3, subplot_titles=titles, vertical_spacing=0.2)
    for row, (name, _) in enumerate(rows, 1):
        found = told["sensing"][name]
        edges, bands = found["speed_m_s"], found["bands_hz"]
        parts = [f"{low:g}–{high:g}" for low, high in bands]
        speeds = [f"{low:g}–{high:g}" for low, high in pairwise(edges)]
        for side, color in zip(_SIDES, (FLOWN, TRUE), strict=True):
            shown = {"showlegend": row == 1}
            by_speed, spectrum = found[side]["by_speed"], found[side]["spectrum"]
            figure.add_trace(_bars(speeds, by_speed, color, side, 1000.0, **shown), row=row, col=1)
            figure.add_trace(_bars(parts, spectrum, color, side, 1.0, showlegend=False), row=row, col=2)
            figure.add_box(
                y=[1000.0 * one["sensing"][side][name]["delay_s"] for one in flights], name=side,
                boxpoints="all", text=[one["name"] for one in flights], marker={"color": color, "size": 4},
                showlegend=False, legendgroup=side, row=row, col=3,
            )  # fmt: skip
    return _titled(layout(figure, 720))
