"""A Rerun recording and its layout, for a complete log or for the rows that arrive during a flight."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from logs.curves import CHARTS
from logs.reader.flight_data import Flight, Floats, Ints, shape
from logs.recorder.markers import OWN_COLOR, Color, Path

FLIGHT = "flight"  # timeline of seconds since the first step
LOG_TIME = "log_time"  # timeline of date and time in the log
EVENTS, RUN, WORLD, PHASE = "/events", "/run", "/world", "/phase"


def blueprint(members: Sequence[str] = ()) -> Any:
    """Return the layout of the viewer, which places the camera by itself."""
    scene = rrb.Spatial3DView(origin=WORLD, name="Scene: ENU, metres", line_grid=rrb.LineGrid3D(spacing=0.25))
    if members:
        tabs = [_fleet(members), *(rrb.Tabs(*_tabs(m), name=m, active_tab=0) for m in members)]
    else:
        tabs = list(_tabs(""))
    runs = [(of_member(RUN, m), f"Run of {m}") for m in members] or [(RUN, "Run")]
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
                    *(rrb.TextDocumentView(origin=origin, name=name) for origin, name in runs),
                ),
                row_shares=[3, 1],
            ),
            rrb.Tabs(*tabs, active_tab=0),
            column_shares=[3, 2],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=FLIGHT),
        auto_views=False,
        auto_layout=False,
    )


def _tabs(member: str) -> Iterator[Any]:
    """Yield a tab for each chart with the curves of a flight; the first one also shows the phases."""
    for number, chart in enumerate(CHARTS):
        origins = {of_member(f"/{chart.key}/{row.key}", member): row.title for row in chart.rows}
        views: list[Any] = [rrb.TimeSeriesView(origin=origin, name=name) for origin, name in origins.items()]
        if not number:
            views.append(rrb.StateTimelineView(origin=of_member(PHASE, member), name="Phase"))
        yield rrb.Vertical(*views, name=chart.key.capitalize())


def _fleet(members: Sequence[str]) -> Any:
    """Return the view with the phases of all members."""
    phases = [of_member(PHASE, member) for member in members]
    return rrb.StateTimelineView(origin="/", contents=[f"+ {each}" for each in phases], name="Fleet")


def of_member(entity: str, member: str) -> str:
    """Return the name of a member's entity: below the common world, or else below the member's name."""
    if not member or entity == WORLD:
        return entity
    return (
        f"{WORLD}/{member}{entity[len(WORLD) :]}" if entity.startswith(f"{WORLD}/") else f"/{member}{entity}"
    )


class Canvas:
    """A Rerun recording stream, with the state that is needed between two parts of a flight."""

    def __init__(
        self, stream: rr.RecordingStream, origin_ns: int, member: str = "", own_color: Color | str = OWN_COLOR
    ) -> None:
        self.stream, self.member, self.own_color = stream, member, own_color
        self.paths: dict[str, Path] = {}  # past positions of vehicle and target, by entity
        self.phase: int | None = None  # newest phase in the viewer
        self._origin_ns = origin_ns
        self._styled: set[str] = set()

    def style(self, entity: str, archetype: rr.AsComponents, *, again: bool = False) -> None:
        """Send data that do not change with time; only the first call sends them, or one with ``again``."""
        if again or entity not in self._styled:
            self._styled.add(entity)
            self.stream.log(of_member(entity, self.member), archetype, static=True)

    def columns(self, entity: str, at_ns: Ints, columns: Iterable[Any]) -> None:
        """Send values of an entity at log times in ns."""
        self.stream.send_columns(
            of_member(entity, self.member),
            (
                rr.TimeColumn(FLIGHT, duration=(at_ns - self._origin_ns).astype("timedelta64[ns]")),
                rr.TimeColumn(LOG_TIME, timestamp=at_ns.astype("datetime64[ns]")),
            ),
            columns,
        )


def times(origin_ns: int, t_s: Floats) -> Ints:
    """Convert times since the origin into log times in ns, (n,)."""
    return origin_ns + np.round(t_s * 1e9).astype(np.int64)


def rgba(color: Color | str) -> tuple[int, int, int, int]:
    """Return a colour as four numbers from 0 to 255 for Rerun, from fractions or from hexadecimal."""
    if isinstance(color, str):
        red, green, blue = bytes.fromhex(color.removeprefix("#"))
        return red, green, blue, 255
    r, g, b, opacity = (round(255 * part) for part in color)
    return r, g, b, opacity


def run_of(flight: Flight) -> dict[str, str]:
    """Return the metadata of the run, and barrier and pad of the configuration."""
    known = {} if flight.config is None else shape(flight.config)
    return known | flight.metadata.get("run", {})
