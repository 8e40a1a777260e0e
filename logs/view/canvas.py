"""A Rerun recording and its layout; it takes a whole log, or rows piece by piece in flight."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

import rerun as rr
import rerun.blueprint as rrb

from logs.derive.markers import Path
from logs.view.read import Ints

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


class Canvas:
    """A recording stream with what it has to remember between two pieces of a flight.

    Attributes:
        stream: the recording.
        paths: where vehicle and target have been, by entity.
        phase: that was shown last.

    Args:
        stream: the recording.
        origin_ns: log time at which the time line of the flight begins.
    """

    def __init__(self, stream: rr.RecordingStream, origin_ns: int) -> None:
        self.stream = stream
        self.paths: dict[str, Path] = {}
        self.phase: int | None = None
        self._origin_ns = origin_ns
        self._styled: set[str] = set()
        self._slots: dict[str, int] = {}

    def style(self, entity: str, archetype: rr.AsComponents) -> None:
        """Send what does not change with time; the first time only."""
        if entity not in self._styled:
            self._styled.add(entity)
            self.stream.log(entity, archetype, static=True)

    def columns(self, entity: str, at_ns: Ints, columns: Iterable[Any]) -> None:
        """Send values of an entity at log times in ns."""
        self.stream.send_columns(
            entity,
            (
                rr.TimeColumn(FLIGHT, duration=(at_ns - self._origin_ns).astype("timedelta64[ns]")),
                rr.TimeColumn(LOG_TIME, timestamp=at_ns.astype("datetime64[ns]")),
            ),
            columns,
        )

    def due(self, name: str, period_ns: int, at_ns: int) -> bool:
        """Whether this is the first time in a period, by name."""
        slot = at_ns // period_ns
        if self._slots.get(name) == slot:
            return False
        self._slots[name] = slot
        return True
