"""Exact solution of the quadratic program with several rows, by enumeration of its active sets.

    min |u - u'|^2   subject to   lower <= u <= upper,   g_k . u >= b_k

In three dimensions at most three constraints are active at the minimiser. The clipped u' is tried first, then
the exact projection on the box and one row, then every set of up to three rows and sides of the box. The
result meets all constraints with multipliers that are not negative: these Karush-Kuhn-Tucker conditions are
sufficient here. If no point meets all rows, the least common slack is the lowest vertex of a linear program
in four variables. The solver shares no code with this module.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from flightstack.core.safety.position_loop import clip_to_box
from flightstack.core.safety.projection import EMPTY, projected
from flightstack.core.types import Vec3

TOLERANCE_M_S = 1e-9  # allowed violation of a constraint
_PARALLEL = 1e-10  # determinant of unit vectors below which the vectors count as dependent
_MULTIPLIER_LEAST = -1e-9
_SIDES = np.vstack([np.eye(3), -np.eye(3)])


class Row(NamedTuple):
    """A linear constraint g . u >= b on the velocity u."""

    g: Vec3  # gradient g, without unit
    bound_m_s: float  # bound b

    def missing_m_s(self, u: Vec3) -> float:
        """Return the violation of the row by a velocity, m/s; it is not positive if the row is met."""
        return self.bound_m_s - (self.g[0] * u[0] + self.g[1] * u[1] + self.g[2] * u[2])


class Nearest(NamedTuple):
    point: Vec3  # minimiser, m/s
    multipliers: tuple[float, ...]  # one multiplier for each row; 0 for inactive rows


def nearest(nominal: Vec3, rows: Sequence[Row], lower: Vec3, upper: Vec3) -> Nearest | None:
    """Return the minimiser of the program, or ``None`` if no point of the box meets all rows."""
    point = clip_to_box(nominal, lower, upper)
    missed = [k for k, row in enumerate(rows) if row.missing_m_s(point) > 0.0]
    if not missed:
        return Nearest(point, (0.0,) * len(rows))
    for k in missed:
        at, multiplier = projected(nominal, rows[k].g, rows[k].bound_m_s, lower, upper)
        if multiplier == EMPTY:
            return None
        if all(row.missing_m_s(at) <= TOLERANCE_M_S for row in rows) and multiplier < np.inf:
            return Nearest(at, tuple(multiplier if n == k else 0.0 for n in range(len(rows))))
    return _of_all_sets(nominal, rows, lower, upper)


@cache
def _sets(rows: int, size: int) -> Any:
    """Return the sets of ``size`` rows and sides (rows, lower, upper), without two sides of one axis."""
    sides = [(rows + k, rows + 3 + k) for k in range(3)]
    every = itertools.combinations(range(rows + 6), size)
    return np.array([s for s in every if not any(low in s and high in s for low, high in sides)])


def prepare(neighbours: int) -> None:
    """Compute the sets of all programs with at most this number of neighbours before the flight."""
    for rows in range(1, neighbours + 3):
        for size in (1, 2, 3):
            _sets(rows, size)
    for soft in range(1, neighbours + 1):
        for firm in (0, 1, 2):
            _corners(soft, firm)


def _of_all_sets(nominal: Vec3, rows: Sequence[Row], lower: Vec3, upper: Vec3) -> Nearest | None:
    count, start = len(rows), np.array(nominal)
    normals = np.vstack([np.array([row.g for row in rows]).reshape(-1, 3), _SIDES])
    bounds = np.array([*(row.bound_m_s for row in rows), *lower, *(-side for side in upper)])
    lengths = np.linalg.norm(normals, axis=1)
    lengths[lengths == 0.0] = 1.0
    unit, limit = normals / lengths[:, None], bounds / lengths
    best, least = None, np.inf
    for size in (1, 2, 3):
        chosen = _sets(count, size)
        a = unit[chosen]
        gram = a @ a.transpose(0, 2, 1)
        with np.errstate(divide="ignore"):  # the determinant of a dependent set is zero
            kept = np.linalg.det(gram) > _PARALLEL
        chosen, a, gram = chosen[kept], a[kept], gram[kept]
        lacking = limit[chosen] - a @ start
        multipliers = np.linalg.solve(gram, lacking[..., None])[..., 0]
        steps = np.einsum("ks,ksx->kx", multipliers, a)
        points = start + steps
        meets = (points @ unit.T >= limit - TOLERANCE_M_S).all(axis=1)
        good = np.flatnonzero(meets & (multipliers >= _MULTIPLIER_LEAST).all(axis=1))
        for k in good:
            far = float(steps[k] @ steps[k])
            if far < least:
                least, best = far, (points[k], chosen[k], multipliers[k])
    if best is None:
        return None
    at, members, factors = best
    found = [0.0] * count
    for member, factor in zip(members.tolist(), factors.tolist(), strict=True):
        if member < count:
            found[member] = max(0.0, factor) / float(lengths[member])
    return Nearest(clip_to_box(at.tolist(), lower, upper), tuple(found))


def least_slack(firm: Sequence[Row], soft: Sequence[Row], lower: Vec3, upper: Vec3) -> tuple[float, Vec3]:
    """Return the least slack s >= 0 of all soft rows, g . u + s >= b, and a velocity that meets them."""
    rows = [*soft, *firm]
    slack = [1.0] * len(soft) + [0.0] * (len(firm) + 6) + [1.0]
    normals = np.vstack([np.array([row.g for row in rows]).reshape(-1, 3), _SIDES, np.zeros((1, 3))])
    bounds = np.array([*(row.bound_m_s for row in rows), *lower, *(-side for side in upper), 0.0])
    matrix = np.column_stack([normals, np.array(slack)])
    chosen = _corners(len(soft), len(firm))
    a = matrix[chosen]
    with np.errstate(divide="ignore"):
        kept = np.abs(np.linalg.det(a)) > _PARALLEL
    points = np.linalg.solve(a[kept], bounds[chosen[kept]][..., None])[..., 0]
    meets = (points @ matrix.T >= bounds - TOLERANCE_M_S).all(axis=1)
    points = points[meets]
    if not len(points):
        return np.inf, lower
    x, y, z, s = points[int(np.argmin(points[:, 3]))].tolist()
    return max(0.0, s), clip_to_box((x, y, z), lower, upper)


@cache
def _corners(soft: int, firm: int) -> Any:
    """Return the sets of four constraints that can form a vertex; one of each set bounds the slack s."""
    rows = soft + firm
    last, sides = rows + 6, [(rows + k, rows + 3 + k) for k in range(3)]
    every = itertools.combinations(range(rows + 7), 4)
    bounded = (s for s in every if s[0] < soft or s[-1] == last)
    return np.array([s for s in bounded if not any(low in s and high in s for low, high in sides)])
