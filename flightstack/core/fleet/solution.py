"""Exact velocity u nearest to the nominal velocity u' under several constraints (``Row``).

    min |u - u'|^2   subject to   lower <= u <= upper,   g_k . u >= b_k

``by_active_set`` is a dual active-set method in plain floats (Goldfarb and Idnani, Mathematical Programming
27, 1983). It starts at the clipped u', where sides of the box are active. It adds the constraint with the
largest violation until no constraint is violated, and removes a constraint whose multiplier would become
negative. Its result is used only if it satisfies the Karush-Kuhn-Tucker conditions, which are checked here.
If not, ``by_all_sets`` tries all active sets: in three dimensions at most three constraints are active at the
minimiser. ``least_slack`` relaxes constraints if no point satisfies all. The result depends only on the data
of this tick, and OSQP shares no code with this module.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from flightstack.core.safety.position_loop import clip_to_box
from flightstack.core.types import ZERO, Vec3

TOLERANCE_M_S = 1e-9  # allowed violation of a constraint, m/s
STEPS_MAX = 60  # maximum number of steps; after it the search ends without a result
_CONFIRMED_M_S = 2e-9  # allowed violation of an optimality condition, m/s
_DEPENDS = 1e-12  # squared length of a unit vector's orthogonal part below which the vector is dependent
_PARALLEL = 1e-10  # determinant below which constraints count as dependent: they have no common vertex
_MULTIPLIER_LEAST = -1e-9  # multipliers above this value count as positive
_LEAST_LENGTH = 1e-9  # length of a gradient below which the gradient has no direction
_SIDES: tuple[Vec3, ...] = (
    (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0),  # lower sides of the box
    (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0),  # upper sides of the box
)  # fmt: skip


class Row(NamedTuple):
    """A linear constraint g . u >= b on the velocity u."""

    g: Vec3  # gradient g of the constraint, without unit
    bound_m_s: float  # bound b of the constraint, m/s

    def missing_m_s(self, u: Vec3) -> float:
        """Return the violation of the constraint by a velocity, m/s; 0 or less: it is satisfied."""
        return self.bound_m_s - (self.g[0] * u[0] + self.g[1] * u[1] + self.g[2] * u[2])


Nearest = tuple[Vec3, tuple[float, ...]]  # minimiser, m/s; one multiplier for each ``Row``, 0 if inactive


class Found(NamedTuple):
    """The minimiser, or constraints that no velocity satisfies together."""

    point: Vec3 | None  # minimiser, m/s; ``None``: no point satisfies all constraints
    # multipliers, in the order of the input; if point is None: multipliers of contradictory
    # constraints, whose gradients times these multipliers sum to 0
    multipliers: tuple[float, ...]
    lacking_m_s: float = 0.0  # violation of the contradictory constraints if point is None, m/s


def by_active_set(nominal: Vec3, rows: Sequence[Row], lower: Vec3, upper: Vec3) -> Found | None:
    """Return the minimiser of the program, or ``None`` if the result cannot be confirmed."""
    count = len(rows)
    normals, bounds, lengths = [], [], []
    for (gx, gy, gz), bound in rows:
        length = math.sqrt(gx * gx + gy * gy + gz * gz)
        if not length > _LEAST_LENGTH:  # without a gradient, all velocities or none satisfy the constraint
            gx = gy = gz = 0.0
            length = 1.0
        lengths.append(length)
        normals.append((gx / length, gy / length, gz / length))
        bounds.append(bound / length)
    normals.extend(_SIDES)
    bounds.extend((*lower, -upper[0], -upper[1], -upper[2]))
    point = clip_to_box(nominal, lower, upper)
    active: list[int] = []
    factors: list[float] = []
    for axis in (0, 1, 2):
        beyond = point[axis] - nominal[axis]
        if beyond != 0.0:
            active.append(count + axis if beyond > 0.0 else count + 3 + axis)
            factors.append(abs(beyond))
    x, y, z = point
    for _ in range(STEPS_MAX):
        worst, most = -1, TOLERANCE_M_S
        for k, (nx, ny, nz) in enumerate(normals):
            missing = bounds[k] - (nx * x + ny * y + nz * z)
            if missing > most and k not in active:
                worst, most = k, missing
        if worst < 0:
            return _confirmed(nominal, (x, y, z), active, factors, normals, bounds, lengths)
        nx, ny, nz = normals[worst]
        factor, leaves = 0.0, 0
        while leaves >= 0:
            parts, (zx, zy, zz) = _split((nx, ny, nz), [normals[k] for k in active])
            left = zx * zx + zy * zy + zz * zz
            whole = most / left if left > _DEPENDS else math.inf
            step, leaves = whole, -1
            for n, part in enumerate(parts):
                if part > 0.0 and factors[n] < step * part:
                    step, leaves = factors[n] / part, n
            if step == math.inf:
                return _impossible(worst, active, parts, bounds, lengths)
            factor += step
            factors = [each - step * part for each, part in zip(factors, parts, strict=True)]
            if whole < math.inf:
                x, y, z = x + step * zx, y + step * zy, z + step * zz
            if leaves >= 0:
                del active[leaves], factors[leaves]
                most = max(0.0, bounds[worst] - (nx * x + ny * y + nz * z))
        active.append(worst)
        factors.append(factor)
    return None


def _split(n: Vec3, others: Sequence[Vec3]) -> tuple[tuple[float, ...], Vec3]:
    """Split a unit vector: return its parts along up to three other unit vectors, and the orthogonal part."""
    if not others:
        return (), n
    (nx, ny, nz), (ax, ay, az) = n, others[0]
    if len(others) == 1:
        p = ax * nx + ay * ny + az * nz
        return (p,), (nx - p * ax, ny - p * ay, nz - p * az)
    a, b = others[0], others[1]
    wx, wy, wz = w = _cross(a, b)
    along = nx * wx + ny * wy + nz * wz
    if len(others) == 2:
        square = wx * wx + wy * wy + wz * wz
        p, q = _dot(_cross(n, b), w) / square, _dot(_cross(a, n), w) / square
        along /= square
        return (p, q), (along * wx, along * wy, along * wz)
    c = others[2]
    volume = _dot(c, w)
    p, q = _dot(_cross(n, b), c) / volume, _dot(_cross(a, n), c) / volume
    return (p, q, along / volume), ZERO


def _cross(a: Vec3, b: Vec3) -> Vec3:
    (ax, ay, az), (bx, by, bz) = a, b
    return (ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def _dot(a: Vec3, b: Vec3) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _confirmed(
    nominal: Vec3, point: Vec3, active: Sequence[int], factors: Sequence[float], normals: Sequence[Vec3],
    bounds: Sequence[float], lengths: Sequence[float],
) -> Found | None:  # fmt: skip
    """Return the minimiser if the optimality conditions hold; the caller has checked the constraints."""
    x, y, z = nominal
    multipliers = [0.0] * len(lengths)
    scale = _CONFIRMED_M_S
    for k, factor in zip(active, factors, strict=True):
        nx, ny, nz = normals[k]
        x, y, z = x + factor * nx, y + factor * ny, z + factor * nz
        scale += _CONFIRMED_M_S * factor
        if factor < 0.0 or abs(bounds[k] - _dot(normals[k], point)) > _CONFIRMED_M_S:
            return None
        if k < len(lengths):
            multipliers[k] = factor / lengths[k]
    if max(abs(x - point[0]), abs(y - point[1]), abs(z - point[2])) > scale:
        return None
    return Found(point, tuple(multipliers))


def _impossible(
    worst: int, active: Sequence[int], parts: Sequence[float], bounds: Sequence[float],
    lengths: Sequence[float],
) -> Found:  # fmt: skip
    """Return ``Found`` without a velocity: one constraint contradicts a sum of the active constraints."""
    multipliers, lacking_m_s = [0.0] * len(lengths), bounds[worst]
    if worst < len(lengths):
        multipliers[worst] = 1.0 / lengths[worst]
    for k, part in zip(active, parts, strict=True):
        lacking_m_s -= part * bounds[k]
        if k < len(lengths):
            multipliers[k] = max(0.0, -part) / lengths[k]
    return Found(None, tuple(multipliers), lacking_m_s)


def by_all_sets(nominal: Vec3, rows: Sequence[Row], lower: Vec3, upper: Vec3) -> Nearest | None:
    """Return the minimiser of the program, or ``None`` if no point of the box satisfies all constraints."""
    point, count, start = clip_to_box(nominal, lower, upper), len(rows), np.array(nominal)
    if all(row.missing_m_s(point) <= 0.0 for row in rows):
        return point, (0.0,) * count
    opposite = [(count + k, count + 3 + k) for k in range(3)]  # two sides of one axis are never both active
    normals = np.vstack([np.array([row.g for row in rows]).reshape(-1, 3), np.array(_SIDES)])
    bounds = np.array([*(row.bound_m_s for row in rows), *lower, *(-side for side in upper)])
    lengths = np.linalg.norm(normals, axis=1)
    lengths[lengths == 0.0] = 1.0
    unit, limit = normals / lengths[:, None], bounds / lengths
    best, least = None, np.inf
    for size in (1, 2, 3):
        every = combinations(range(count + 6), size)
        chosen = np.array([s for s in every if not any(low in s and high in s for low, high in opposite)])
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
    return clip_to_box(at.tolist(), lower, upper), tuple(found)


def nearest(nominal: Vec3, rows: Sequence[Row], lower: Vec3, upper: Vec3) -> Nearest | None:
    """Return minimiser and multipliers, or ``None`` if no point of the box satisfies all constraints."""
    x, y, z = point = clip_to_box(nominal, lower, upper)
    for (gx, gy, gz), bound_m_s in rows:
        if gx * x + gy * y + gz * z < bound_m_s:
            break
    else:
        return point, (0.0,) * len(rows)
    found = by_active_set(nominal, rows, lower, upper)
    if found is None:
        return by_all_sets(nominal, rows, lower, upper)
    return None if found.point is None else (found.point, found.multipliers)


def least_slack(firm: Sequence[Row], soft: Sequence[Row], lower: Vec3, upper: Vec3) -> tuple[float, Vec3]:
    """Return the smallest common slack of the soft constraints, m/s, and a velocity that satisfies them.

    Each set of contradictory constraints gives a lower bound of the slack. The search is repeated with this
    bound as slack until no such set is left: the slack is then the smallest sufficient one. The slack is
    infinite if none is sufficient.
    """
    slack_m_s, middle, free = 0.0, clip_to_box(ZERO, lower, upper), len(firm)
    for _ in range(STEPS_MAX):
        eased = [*firm, *(Row(g, bound - slack_m_s) for g, bound in soft)]
        found = by_active_set(middle, eased, lower, upper)
        if found is not None and found.point is not None:
            return slack_m_s, clip_to_box(found.point, lower, upper)
        gives = sum(found.multipliers[free:]) if found is not None else 0.0
        if found is None or not gives > 0.0 or not found.lacking_m_s > 0.0:
            break
        slack_m_s += found.lacking_m_s / gives
    return _lowest_vertex(firm, soft, lower, upper)


def _lowest_vertex(firm: Sequence[Row], soft: Sequence[Row], lower: Vec3, upper: Vec3) -> tuple[float, Vec3]:
    """Return the result of ``least_slack`` if rounding errors hide its bounds, as for near-parallel rows.

    The result is the lowest vertex of a linear program in four variables. Each vertex is the intersection of
    four constraints; the function tries all vertices, which takes some milliseconds.
    """
    sides = zip(_SIDES, (*lower, *(-side for side in upper)), strict=True)
    given = [(row, 1.0) for row in soft] + [(row, 0.0) for row in (*firm, *sides)]
    matrix = np.array([[*g, gives] for (g, _), gives in given] + [[0.0, 0.0, 0.0, 1.0]])
    bounds = np.array([bound for (_, bound), _ in given] + [0.0])
    chosen = np.array(list(combinations(range(len(matrix)), 4)))
    with np.errstate(divide="ignore"):
        chosen = chosen[np.abs(np.linalg.det(matrix[chosen])) > _PARALLEL]
    points = np.linalg.solve(matrix[chosen], bounds[chosen][..., None])[..., 0]
    points = points[(points @ matrix.T >= bounds - TOLERANCE_M_S).all(axis=1)]
    if not len(points):
        return math.inf, clip_to_box(ZERO, lower, upper)
    x, y, z, slack_m_s = points[int(np.argmin(points[:, 3]))].tolist()
    return max(0.0, slack_m_s), clip_to_box((x, y, z), lower, upper)
