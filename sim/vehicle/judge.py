"""Quantities for the verdict of a flight: smallest barrier function values, tumbling, contacts."""

from __future__ import annotations

import math

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Record, Vector
from flightstack.core.numeric import twin
from flightstack.core.safety.barrier import boundary_height
from sim.world.step import GROUND, PAD, WorldRecord, tumbled

GAP_MS = 30  # shortest gap that ends a contact, ms; a bounce is shorter
NONE_MS = -1_000_000


class JudgeRecord(Record):
    """Barrier of the verdict, and extreme values since the last reading."""

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

    bits: int  # bits of all contacts since the last reading
    since_ms: int  # start of the current contact with pad or ground
    pad_ms: int  # time of the last contact with the pad's top
    ground_ms: int
    judging: bool  # whether the next touch of the pad counts as the first touch
    touch_ms: int  # time of the first touch
    touch_e: Vector  # vehicle minus pad centre at the start of the touch's step, m
    touch_velocity: Vector  # velocity of the vehicle relative to the pad below it, m/s


@jitted
def note_contact(
    c: ContactRecord, world: WorldRecord, now_ms: int, before_e: F64, before_velocity: F64
) -> None:
    """Update contact times; store the state before the first judged touch of the pad.

    The arguments are valid at the start of the step: ``now_ms``; ``before_e``: vehicle minus pad centre, m;
    ``before_velocity``: velocity of the vehicle, m/s.
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
        c.touch_e[:] = before_e
        c.touch_velocity[0] = before_velocity[0] - (deck.velocity[0] - deck.rate * before_e[1])
        c.touch_velocity[1] = before_velocity[1] - (deck.velocity[1] + deck.rate * before_e[0])
        c.touch_velocity[2] = before_velocity[2] - deck.velocity[2]
