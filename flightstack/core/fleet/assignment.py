"""Assignment of pads to vehicles with the minimum sum of horizontal distances, once before the flight.

Two straight paths that cross are longer in sum than the two paths without a crossing. Straight approaches of
this assignment therefore never cross in the horizontal plane.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from flightstack.core.types import Vec3

UNIT_M = 1e-6  # unit of the integer distances, m; a sum of integers does not depend on its order
FAR_M = 1e6  # largest coordinate, m; sums of larger distances would not be exact


def assign(starts_enu_m: Sequence[Vec3], pads_enu_m: Sequence[Vec3]) -> tuple[int, ...]:
    """Return the index of the pad of each vehicle.

    If assignments have equal sums, each vehicle in turn takes the pad with its index, then the lowest index.
    """
    count, pads = len(starts_enu_m), len(pads_enu_m)
    if pads < count:
        raise ValueError(f"found {pads} pads for {count} vehicles; each vehicle needs one of its own")
    for place in (*starts_enu_m, *pads_enu_m):
        if not all(abs(each) <= FAR_M for each in place):
            raise ValueError(f"found the place {tuple(place)} m; allowed are coordinates up to {FAR_M:g} m")
    cost = [
        [round(math.hypot(px - x, py - y) / UNIT_M) for px, py, _ in pads_enu_m] for x, y, _ in starts_enu_m
    ]
    free, found, left = list(range(pads)), [], _least(cost)
    for vehicle, row in enumerate(cost):
        for pad in ([vehicle] if vehicle in free else []) + [each for each in free if each != vehicle]:
            others = [each for each in free if each != pad]
            rest = _least([[line[each] for each in others] for line in cost[vehicle + 1 :]])
            if row[pad] + rest == left:
                found.append(pad)
                free, left = others, rest
                break
    return tuple(found)


def _least(cost: Sequence[Sequence[int]]) -> int:
    """Return the minimum sum of one integer from each row, each from a different column."""
    if not cost:
        return 0
    # imported here, since only an assignment needs scipy
    import numpy as np
    from scipy.optimize import linear_sum_assignment

    table: Any = np.array(cost, dtype=np.float64)
    return int(table[linear_sum_assignment(table)].sum())
