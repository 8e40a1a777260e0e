"""How Rerun lays a landing out: the scene at the left, curves in tabs at the right, events below."""

from __future__ import annotations

from typing import Any, Literal

import rerun.blueprint as rrb

FLIGHT = "flight"  # timeline: seconds since the first step
LOG_TIME = "log_time"  # timeline: date and time of the log
EVENTS, RUN, WORLD, PHASE = "/events", "/run", "/world", "/phase"
AXES = ("x", "y", "z")
Corner = Literal["LeftTop", "RightTop", "RightBottom"]


def blueprint(center_m: tuple[float, float, float], size_m: float) -> Any:
    """Return the layout.

    Args:
        center_m: what the camera looks at.
        size_m: extent of the flight; the camera stands away from it accordingly.
    """
    away_m = max(1.0, size_m)
    x, y, z = center_m
    eye = rrb.EyeControls3D(
        position=(x - 0.5 * away_m, y - 0.8 * away_m, z + 0.35 * away_m),
        look_target=center_m,
        eye_up=(0, 0, 1),
    )
    scene = rrb.Spatial3DView(
        origin=WORLD, name="Scene: ENU, metres", eye_controls=eye, line_grid=rrb.LineGrid3D(spacing=0.25)
    )
    safety = rrb.Vertical(
        _plot("/safety/h", "Barrier h [m], safe above 0", "RightBottom"),
        _plot("/distance", "Vehicle to landing spot [m]"),
        rrb.StateTimelineView(origin=PHASE, name="Phase"),
        row_shares=[4, 3, 1.5],
        name="Safety",
    )
    velocity = rrb.Vertical(
        *(_plot(f"/velocity/{axis}", f"Velocity {axis} [m/s]", "LeftTop") for axis in AXES), name="Velocity"
    )
    constraint = rrb.Vertical(
        _plot("/safety/slack", "Slack of the barrier constraint [m/s]"),
        _plot("/safety/dh_dt", "dh/dt, motion of the target [m/s]"),
        _plot("/safety/active", "Filter active"),
        name="Filter",
    )
    loop = rrb.Vertical(
        _plot("/loop", "Loop [ms]: lateness, work, solver"),
        _plot("/age", "Age of the states [ms]"),
        _plot("/samples", "Target samples, sum"),
        name="Loop and links",
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                scene,
                rrb.Tabs(
                    rrb.TextLogView(
                        origin=EVENTS,
                        name="Events",
                        columns=rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"]),
                    ),
                    rrb.TextDocumentView(origin=RUN, name="Run"),
                ),
                row_shares=[3, 1],
            ),
            rrb.Tabs(safety, velocity, constraint, loop, active_tab=0),
            column_shares=[3, 2],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=FLIGHT),
        auto_views=False,
        auto_layout=False,
    )


def _plot(origin: str, name: str, legend: Corner = "RightTop") -> Any:
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=rrb.PlotLegend(corner=legend))
