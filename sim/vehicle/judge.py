"""Quantities for the verdict of a flight: smallest barrier function values, tumbling, contacts, encounters.

An encounter is the smallest distance of two vehicles between two ticks. The shape of a vehicle is an upright
cylinder around rotors and body. Between two ticks the relative position follows the cubic through the
positions and velocities at both ticks. There are two distances: the distance between the centres of mass, and
the norm of an ellipsoid around the other vehicle; this norm is 1 on the surface of the ellipsoid.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, I64, Record, Vector, copy
from flightstack.core.numeric import twin
from flightstack.core.safety.barrier import boundary_height
from logs.verdict.types import RADIUS_ABOVE_M, RADIUS_BESIDE_M
from sim.plant.params import STEP_S, Params
from sim.world.step import GROUND, PAD, WorldRecord, tumbled

GAP_MS = 30  # maximum gap within a contact, ms; a bounce is shorter
NONE_MS = -1_000_000
BESIDE_M, ABOVE_M = 2.0 * RADIUS_BESIDE_M, 2.0 * RADIUS_ABOVE_M  # semi-axes of the ellipsoid, m


class JudgeRecord(Record):
    """Barrier of the verdict, and extreme values since the last call of ``write_truth``."""

    alpha_1_m: float
    beta_m: float
    pad_radius: float
    h_min: float
    h_min_outside: float  # smallest h outside the pad's radius
    tumbled: bool


_height = twin(boundary_height, jitted)  # height of the boundary, as in the controller


@jitted
def judge(j: JudgeRecord, world: WorldRecord) -> None:
    """Update the smallest h and the tumble flag."""
    p, d = world.body.position, world.deck.position
    ex, ey = p[0] - d[0], p[1] - d[1]
    square = ex * ex + ey * ey
    h = p[2] - d[2] - _height(j.alpha_1_m, j.beta_m, math.sqrt(square))
    j.h_min = min(j.h_min, h)
    if square > j.pad_radius * j.pad_radius:
        j.h_min_outside = min(j.h_min_outside, h)
    if tumbled(world.body.quaternion):
        j.tumbled = True


class ContactRecord(Record):
    """Simulated times of contacts, ms; ``NONE_MS``: no contact."""

    bits: int  # bits of all contacts since the last call of ``write_truth``
    since_ms: int  # start of the current contact with pad or ground
    pad_ms: int  # time of the last contact with the pad's top
    ground_ms: int
    judging: bool  # whether the next touch of the pad counts as the first touch
    touch_ms: int  # time of the first touch
    touch_e: Vector  # vehicle minus pad centre at the start of the step of the touch, m
    touch_velocity: Vector  # velocity of the vehicle relative to the point of the pad below it, m/s


@jitted
def note_contact(
    c: ContactRecord, world: WorldRecord, now_ms: int, before_e: F64, before_velocity: F64
) -> None:
    """Update contact times; store the state before the first judged touch of the pad.

    ``before_e`` (vehicle minus pad centre, m) and ``before_velocity`` are those at the start of the step.
    """
    deck, bits = world.deck, world.contacts
    c.bits |= bits
    if bits & (PAD | GROUND):
        if now_ms - max(c.pad_ms, c.ground_ms) > GAP_MS:
            c.since_ms = now_ms
        if bits & PAD:
            c.pad_ms = now_ms
        if bits & GROUND:
            c.ground_ms = now_ms
    if bits & PAD and c.judging and c.touch_ms == NONE_MS:
        c.touch_ms = now_ms
        copy(before_e, c.touch_e)
        c.touch_velocity[0] = before_velocity[0] - (deck.velocity[0] - deck.rate * before_e[1])
        c.touch_velocity[1] = before_velocity[1] - (deck.velocity[1] + deck.rate * before_e[0])
        c.touch_velocity[2] = before_velocity[2] - deck.velocity[2]


@dataclass(frozen=True, slots=True)
class Shape:
    """Collision shape of a vehicle: an upright cylinder."""

    radius_m: float  # distance from the axis to the rotor tips
    bottom_m: float  # lowest point, relative to the centre of mass; negative
    top_m: float  # highest point, relative to the centre of mass

    @classmethod
    def of(cls, params: Params) -> Shape:
        """Return the cylinder around rotors and body at level attitude, from a vehicle's file."""
        g, r = params.geometry, params.rotor
        half_x, half_y, half_z = g.body_half_size_m
        return cls(
            max(math.sqrt(2.0) * r.arm_m + r.radius_m, math.hypot(half_x, half_y)),
            min(g.foot_bottom_m, g.body_centre_z_m - half_z),
            max(r.above_com_m + g.propeller_half_thickness_m, g.body_centre_z_m + half_z),
        )


@jitted
def _nearest(
    before: F64, after: F64, steps: int, radii_m: float, down_m: float, up_m: float
) -> tuple[float, float, int]:
    nearest_m, ellipsoid, overlap = math.inf, math.inf, -1
    length_s = steps * STEP_S
    for step in range(1, steps + 1):
        t = step / steps
        a, b = (2.0 * t - 3.0) * t * t + 1.0, ((t - 2.0) * t + 1.0) * t * length_s
        c, d = (3.0 - 2.0 * t) * t * t, (t - 1.0) * t * t * length_s
        x = a * before[0] + b * before[3] + c * after[0] + d * after[3]
        y = a * before[1] + b * before[4] + c * after[1] + d * after[4]
        z = a * before[2] + b * before[5] + c * after[2] + d * after[5]
        nearest_m = min(nearest_m, math.sqrt(x * x + y * y + z * z))
        norm = math.sqrt((x * x + y * y) / (BESIDE_M * BESIDE_M) + z * z / (ABOVE_M * ABOVE_M))
        ellipsoid = min(ellipsoid, norm)
        if overlap < 0 and x * x + y * y < radii_m * radii_m and down_m < z < up_m:
            overlap = step
    return nearest_m, ellipsoid, overlap


@jitted
def _follow(
    before: F64, after: F64, flew: I64, steps: int, shapes: F64, least: F64, inside: I64, overlap: I64, i: int
) -> bool:
    """Update the pairs of vehicle ``i`` with later vehicles; arguments and result as in ``Team.follow``."""
    number, seen = len(shapes), False
    pair = i * number - i * (i + 1) // 2
    for j in range(i + 1, number):
        radii_m = shapes[i, 0] + shapes[j, 0]
        down_m, up_m = shapes[i, 1] - shapes[j, 2], shapes[i, 2] - shapes[j, 1]
        found = _nearest(before[j] - before[i], after[j] - after[i], steps, radii_m, down_m, up_m)
        least[pair, 0] = min(least[pair, 0], found[0])
        inside[pair], overlap[pair] = 0, found[2]
        if flew[i] and flew[j]:
            least[pair, 1] = min(least[pair, 1], found[0])
            least[pair, 2] = min(least[pair, 2], found[1])
            inside[pair] = found[1] < 1.0
        seen = seen or inside[pair] != 0 or overlap[pair] >= 0
        pair += 1
    return seen


class Team:
    """Tracks the P pairs of a team, in the order (0, 1), (0, 2) and so on."""

    def __init__(self, shapes: Sequence[Shape]) -> None:
        number = len(shapes) * (len(shapes) - 1) // 2
        self._shapes = np.array([(each.radius_m, each.bottom_m, each.top_m) for each in shapes])
        # (P, 3) smallest values, infinite at first: distance of the centres of mass, m; this distance while
        # both vehicles flew; norm of the ellipsoid while both flew
        self.least = np.full((number, 3), np.inf)
        # inside: (P,) whether both flew in the last call and one was in the other's ellipsoid; overlap_ms:
        # (P,) time from the first tick of that call to the first overlap of the shapes, ms; -1: no overlap
        self.inside, self.overlap_ms = np.zeros(number, dtype=np.int64), np.full(number, -1, dtype=np.int64)

    def follow(self, before: F64, after: F64, flew: I64, steps: int) -> bool:
        """Update all pairs over ``steps`` ms; return whether any was inside an ellipsoid or overlapped.

        ``before``, ``after``: (N, 6) positions (m) and velocities (m/s), ENU; ``flew``: (N,) at both ticks.
        """
        found, seen = (self.least, self.inside, self.overlap_ms), False
        for one in range(len(self._shapes) - 1):  # without a pair nothing is called or compiled
            seen |= _follow(before, after, flew, steps, self._shapes, *found, one)
        return bool(seen)


def overlapping(shapes: Sequence[Shape], places: F64) -> list[tuple[int, int]]:
    """Return pairs of members (lower number first) whose shapes overlap at the (N, 3) positions, ENU, m."""
    team, still = Team(shapes), np.hstack((places, np.zeros_like(places)))
    team.follow(still, still, np.zeros(len(shapes), dtype=np.int64), 1)
    pairs = combinations(range(len(shapes)), 2)
    return [pair for pair, at_ms in zip(pairs, team.overlap_ms, strict=True) if at_ms >= 0]
