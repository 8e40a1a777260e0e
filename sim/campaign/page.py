"""Writes the page of a campaign: distributions, map of h and worst seeds in one HTML file without links."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from logs.report.page import Page, Panel, details, need_libraries, table, write
from logs.verdict.types import VIOLATION_LIMIT_M
from sim.campaign.rows import CELL_M, D_CELLS, E_Z_CELLS, E_Z_LOW_M, Row, cell_map
from sim.campaign.summary import apart, lines

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from sim.campaign.run import Flown, Plan

_BINS = 60
_JUDGED = (
    "Judged from true states at every physics step. The upper bound of the violation rate is the one-sided "
    "bound of Clopper and Pearson; what is not known counts as a violation."
)
_ALONE = "Each command flies one of them alone, to the same end."
_MAP = (
    "Each cell shows the lowest true h of all landings there; the line is the boundary h = 0. "
    "Cells below it were entered on the last centimetres over the pad, or by a violation."
)

_HISTOGRAMS: tuple[tuple[str, str, str, float, Callable[[Row], float | None]], ...] = (
    ("error", "Touchdown error", "d at first contact [cm]", 100.0, lambda r: r.touchdown_error_m),
    (
        "vertical", "Touchdown speed, vertical", "relative to the pad, downwards [m/s]", 1.0,
        lambda r: r.touchdown_speed_vertical_m_s,
    ),
    (
        "horizontal", "Touchdown speed, horizontal", "relative to the pad [m/s]", 1.0,
        lambda r: r.touchdown_speed_horizontal_m_s,
    ),
    ("time", "Time to land", "begin of the landing to first contact [s]", 1.0, lambda r: r.time_to_land_s),
    ("h", "Lowest h outside the pad", "h [mm]", 1000.0, lambda r: r.h_min_outside_pad_m),
)  # fmt: skip


def write_page(path: Path, wanted: Plan, flown: Flown) -> None:
    """Write the page; ``flown`` has a summary. Raises ReportError: the plotting library is not installed."""
    need_libraries()
    write(path, campaign_page(wanted, flown))


def campaign_page(wanted: Plan, flown: Flown) -> Page:
    summary = flown.summary or {}
    bad = summary["crashes"] or summary["violations"] or summary["undeclared_misses"] or flown.missing
    style = "bad" if bad else "good" if summary["landed"] == summary["runs"] else "fair"
    seeds = f"seeds {wanted.first_seed} to {wanted.first_seed + wanted.runs - 1}"
    lacking = f" · {flown.missing} landings are missing" if flown.missing else ""
    shown = lines(summary)
    worst = [(str(w["seed"]), w["why"], w["command"]) for w in summary["worst"]]
    first = ("barrier violated, or not known", "lowest h outside the pad", "touchdown error, 95 %",
             "time to land, median")  # fmt: skip
    return Page(
        f"{wanted.scenario.name}, filter {wanted.filter_name}",
        (f"{summary['landed']} of {summary['runs']} landed", style),
        f"{wanted.scenario.description} · {seeds}{lacking}",
        [line for line in shown if line[0] in first],
        [
            Panel("map", "Lowest h over d and e_z", _MAP, h_map(wanted, flown.rows)),
            Panel(
                "result", "Result", _JUDGED, table(("result", "value", "unit"), shown, numbers=(1,))
            ),
            Panel("worst", "Worst seeds", _ALONE, table(("seed", "why", "command"), worst, numbers=(0,))),
            *_histograms(flown.rows),
            Panel("scenario", "", "", details("Scenario", wanted.scenario_toml, "scenario.toml")),
        ],
        apart(summary),
    )  # fmt: skip


def _histograms(rows: Sequence[Row]) -> list[Panel]:
    found = []
    for key, title, axis, scale, value in _HISTOGRAMS:
        values = [scale * v for row in rows if (v := value(row)) is not None]
        figure = histogram(values, axis, 1e3 * VIOLATION_LIMIT_M if key == "h" else None) if values else None
        found.append(Panel(key, title, f"{len(values)} of {len(rows)} landings have this value.", figure))
    return found


def histogram(values: Sequence[float], axis: str, limit: float | None) -> go.Figure:
    """Return the histogram of a value, with its limit as a line."""
    import plotly.graph_objects as go

    from logs.report.style import BOUNDARY, TRUE, layout

    counts, edges = np.histogram(values, bins=_BINS)
    bars = go.Bar(x=0.5 * (edges[:-1] + edges[1:]), y=counts, width=np.diff(edges), marker={"color": TRUE})
    figure = layout(go.Figure(bars), 300)
    figure.update_layout(bargap=0.0, showlegend=False)
    figure.update_xaxes(title_text=axis)
    figure.update_yaxes(title_text="landings")
    if limit is not None:
        figure.add_vline(x=limit, line={"color": BOUNDARY, "dash": "dash"})
    return figure


def h_map(wanted: Plan, rows: Sequence[Row]) -> go.Figure:
    """Return the map of the lowest h, with the boundary."""
    import plotly.graph_objects as go

    from logs.report.style import BOUNDARY, layout

    lowest_m, visits = cell_map(rows)
    d_m = (np.arange(D_CELLS) + 0.5) * CELL_M
    e_z_m = E_Z_LOW_M + (np.arange(E_Z_CELLS) + 0.5) * CELL_M
    figure = layout(
        go.Figure(
            go.Heatmap(
                x=d_m, y=e_z_m, z=1e3 * lowest_m, customdata=visits, zmin=-300, zmax=300, colorscale="RdBu",
                colorbar={"title": "h [mm]"},
                hovertemplate="d %{x:.2f} m, e_z %{y:.2f} m<br>lowest h %{z:.0f} mm<br>%{customdata} landings"
                "<extra></extra>",
            )
        ),
        460,
    )  # fmt: skip
    at = np.linspace(0.0, D_CELLS * CELL_M, 200)
    height = list(map(wanted.first.judged_by.height, at))
    figure.add_scatter(
        x=at, y=height, mode="lines", line={"color": BOUNDARY, "width": 2}, name="boundary h = 0"
    )
    figure.update_xaxes(title_text="d [m]", range=[0.0, D_CELLS * CELL_M])
    figure.update_yaxes(title_text="e_z [m]", range=[E_Z_LOW_M, E_Z_LOW_M + E_Z_CELLS * CELL_M])
    return figure
