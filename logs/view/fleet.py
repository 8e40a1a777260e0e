"""What a Rerun recording has of a fleet beside its members: distances, and lines between near ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from logs.derive.markers import Color
from logs.verdict.pairs import PairSeries
from logs.view.canvas import PAIRS, WORLD, Canvas
from logs.view.scene import rgba

PERIOD_S = 0.1  # of the lines
NEAR = 3.0  # in the ellipsoid's measure; a line joins two that fly and are nearer
WARN = 1.5  # the same; below it the line is orange, and red inside the ellipsoid
LINE_RADIUS_M = 0.003
FAR_COLOR: Color = (0.6, 0.6, 0.6, 1.0)
WARN_COLOR: Color = (0.9, 0.6, 0.0, 1.0)
INSIDE_COLOR: Color = (0.84, 0.15, 0.16, 1.0)
# as in the report: Okabe and Ito (2008), and Tol
MEMBER_COLORS: tuple[Color, ...] = (
    (0.0, 0.45, 0.70, 1.0), (0.84, 0.37, 0.0, 1.0), (0.0, 0.62, 0.45, 1.0), (0.80, 0.47, 0.65, 1.0),
    (0.90, 0.62, 0.0, 1.0), (0.34, 0.71, 0.91, 1.0), (0.53, 0.13, 0.33, 1.0), (0.27, 0.67, 0.60, 1.0),
)  # fmt: skip
PAIR_COLORS: tuple[Color, ...] = (
    (0.20, 0.13, 0.53, 1.0), (0.67, 0.27, 0.60, 1.0), (0.07, 0.47, 0.20, 1.0), (0.60, 0.60, 0.20, 1.0),
    (0.40, 0.07, 0.0, 1.0), (0.40, 0.60, 0.80, 1.0), (0.87, 0.80, 0.47, 1.0), (0.53, 0.53, 0.53, 1.0),
)  # fmt: skip


def pairs(canvas: Canvas, series: Sequence[PairSeries], origin_ns: int) -> None:
    """Send the distances of all pairs and the lines between those that are near."""
    for number, pair in enumerate(series):
        name = pair.name.replace("–", "_")
        at_ns = origin_ns + np.round(pair.t_s * 1e9).astype(np.int64)
        color = [rgba(PAIR_COLORS[number % len(PAIR_COLORS)])]
        for what, values in (("measure", pair.measure), ("distance", pair.distance_m)):
            entity = f"{PAIRS}/{what}/{name}"
            canvas.style(entity, rr.SeriesLines(colors=color, names=[name]))
            canvas.columns(entity, at_ns, rr.Scalars.columns(scalars=values))
        every = np.flatnonzero(np.diff(pair.t_s // PERIOD_S, prepend=-1.0))
        near = (pair.flying & (pair.measure < NEAR))[every]
        shown = every[near]
        strips = np.stack([pair.one_m[shown], pair.other_m[shown]], axis=1)
        colors = [rgba(_line_color(float(measure))) for measure in pair.measure[shown]]
        lines = rr.LineStrips3D.columns(strips=list(strips), colors=colors)
        entity = f"{WORLD}/pairs/{name}"
        if len(shown):
            canvas.columns(entity, at_ns[every], lines.partition(near.astype(int)))
            canvas.style(entity, rr.LineStrips3D.from_fields(radii=[LINE_RADIUS_M]))
    if series:
        ends = np.array([min(p.t_s[0] for p in series), max(p.t_s[-1] for p in series)])
        limit = f"{PAIRS}/measure/limit"
        canvas.style(limit, rr.SeriesLines(colors=[rgba(INSIDE_COLOR)], names=["limit"]))
        at_ns = origin_ns + np.round(ends * 1e9).astype(np.int64)
        canvas.columns(limit, at_ns, rr.Scalars.columns(scalars=np.ones(2)))


def _line_color(measure: float) -> Color:
    return INSIDE_COLOR if measure < 1.0 else WARN_COLOR if measure < WARN else FAR_COLOR
