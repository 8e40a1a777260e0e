"""Landing place of a vehicle that frees its pad: beside the paths of all pads, away from landed vehicles."""

from __future__ import annotations

import math
from collections.abc import Sequence

from flightstack.core.fleet.precedence import ON_GROUND, Pad
from flightstack.core.parameters.fleet import Fleet
from flightstack.core.types import ZERO, Neighbour, Vec3

DIRECTIONS = 16  # number of directions of the candidate places around the pad
RINGS = (1.4, 2.0, 2.6)  # distances of the candidate places from the pad, in units of ``wait_distance_m``
APART = 3.0  # required distance from a vehicle on the ground, in units of ``radius_xy_m``
KEPT_M = 0.2  # reduction of the required distances for a place that is already chosen, m


def place_beside(
    kept: Vec3 | None, own_enu_m: Vec3, pad: Pad, words: Sequence[Neighbour], fleet: Fleet
) -> Vec3:
    """Return the chosen place on the ground, or a new one if pads or vehicles come too near to it.

    The path of a pad is straight: from its position ``wait_max_s`` ago to its position in ``wait_max_s``. The
    nearest free place is chosen; if no place is free, the one with the most room. A chosen place is kept
    while it is free of the path of ``descent_s``: errors of a pad's velocity rotate the longer path too much.
    """
    pads = [pad]
    for word in words:
        if word.pad_position_enu_m is not None:
            pads.append(Pad(word.pad_position_enu_m, word.pad_velocity_enu_m_s or ZERO))
    grounded = [word.position_enu_m for word in words if word.intent in ON_GROUND]

    def room_m(place: Vec3, ahead_s: float) -> float:
        least_m = min(_from_way_m(each, place, ahead_s) for each in pads) - fleet.wait_distance_m
        for x, y, _ in grounded:
            least_m = min(least_m, math.hypot(x - place[0], y - place[1]) - APART * fleet.radius_xy_m)
        return least_m

    if kept is not None and room_m(kept, fleet.descent_s) >= -KEPT_M:
        return kept
    (x, y, _), found = pad.position_enu_m, []
    for ring in RINGS:
        for number in range(DIRECTIONS):
            d_m, angle = ring * fleet.wait_distance_m, number * math.tau / DIRECTIONS
            place = (x + d_m * math.cos(angle), y + d_m * math.sin(angle), 0.0)
            away_m = math.hypot(place[0] - own_enu_m[0], place[1] - own_enu_m[1])
            found.append((min(room_m(place, fleet.wait_max_s), 0.0), -away_m, place))
    return max(found)[2]


def _from_way_m(pad: Pad, place: Vec3, ahead_s: float) -> float:
    """Return the horizontal distance of a place from the path of a pad, ``ahead_s`` back and ahead."""
    (x, y, _), (vx, vy, _) = pad.position_enu_m, pad.velocity_enu_m_s
    ex, ey, speed2 = place[0] - x, place[1] - y, vx * vx + vy * vy
    at_s = min(max(-ahead_s, (ex * vx + ey * vy) / speed2), ahead_s) if speed2 > 0.0 else 0.0
    return math.hypot(ex - at_s * vx, ey - at_s * vy)
