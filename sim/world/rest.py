"""Moves a vehicle at rest with the pad, without MuJoCo, until the forces or the deck's motion change.

On a real pad static friction holds the vehicle. MuJoCo's contact is soft, so a vehicle at rest creeps under a
steady side force. MuJoCo also takes ten times as long as all other parts of a step.
"""

from __future__ import annotations

import math

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Quaternion, Record, Vector
from sim.plant.params import Params
from sim.plant.states import rotation_axes
from sim.world.bodies import BodyRecord, DeckRecord, WrenchRecord, move_deck

WAIT_STEPS = 50  # consecutive steps of 1 ms at rest before the pad carries the vehicle; a bounce is shorter
STILL_M = 1e-4  # largest motion relative to the pad in these steps, m
DIAGONAL = 1.4143  # ratio of a square's diagonal to its side, rounded up: the feet are at the corners
SAME_RAD = 0.002  # largest change of attitude in these steps, rad
UPRIGHT = 0.99  # smallest cosine of the tilt at which the vehicle stands on all feet
LOADED = 0.5  # smallest fraction of the weight that loads the feet
HOLDS = 0.25  # largest used fraction of the holding force of friction and weight; above it MuJoCo is used
TICK_S = 0.01  # time in which the deck changes to a new velocity, s; the velocity is set in steps
MOVED_M, TURNED_RAD = 1e-4, 1e-3  # largest motion of the deck in one step; more: the deck was moved


class RestRecord(Record):
    """Number of steps at rest on the pad, and the vehicle's pose on the pad."""

    wait_steps: int  # ``WAIT_STEPS``; a value above the steps of a flight disables the resting state
    steps: int  # number of consecutive steps at rest
    friction: float
    gravity: float  # gravitational acceleration, m/s^2
    feet_m: float  # distance of the feet from the centre of mass along body x and y
    pad_radius_m: float
    place: Vector  # position from the pad's centre, along the pad's axes, m
    attitude: Quaternion  # attitude in the pad's axes
    deck_position: Vector  # position of the deck after the last step
    deck_velocity: Vector
    deck_yaw: float
    deck_rate: float


def set_up_rest(r: RestRecord, params: Params, pad_radius_m: float) -> None:
    """Fill in the constant values of a record."""
    r.wait_steps, r.friction = WAIT_STEPS, params.contact.friction
    r.gravity, r.pad_radius_m = params.contact.gravity_m_s2, pad_radius_m
    r.feet_m = params.geometry.foot_offset_m


@jitted
def _note_deck(r: RestRecord, deck: DeckRecord) -> None:
    r.deck_yaw, r.deck_rate = deck.yaw, deck.rate
    for i in range(3):
        r.deck_position[i], r.deck_velocity[i] = deck.position[i], deck.velocity[i]


@jitted
def _change(now: F64, before: F64) -> tuple[float, float]:
    """Return the horizontal and the vertical size of a vector's change."""
    x, y = now[0] - before[0], now[1] - before[1]
    return math.sqrt(x * x + y * y), abs(now[2] - before[2])


@jitted
def _holds(r: RestRecord, wrench: WrenchRecord, deck: DeckRecord) -> bool:
    """Return whether friction and weight hold the vehicle with margin; False for NaN."""
    force, torque, down = wrench.force, wrench.torque, -wrench.force[2]
    moved_m, raised_m = _change(deck.position, r.deck_position)
    faster_m_s, rises_m_s = _change(deck.velocity, r.deck_velocity)
    speed_m_s = math.sqrt(deck.velocity[0] * deck.velocity[0] + deck.velocity[1] * deck.velocity[1])
    sideways = math.sqrt(force[0] * force[0] + force[1] * force[1]) + wrench.mass * (
        faster_m_s / TICK_S + abs(deck.rate) * speed_m_s
    )
    lever = HOLDS * r.feet_m * down
    return bool(
        down > LOADED * wrench.mass * r.gravity
        and moved_m < MOVED_M
        and raised_m < MOVED_M
        and abs(deck.yaw - r.deck_yaw) < TURNED_RAD
        and abs(deck.rate - r.deck_rate) * r.feet_m < HOLDS * r.friction * r.gravity * TICK_S
        and rises_m_s < HOLDS * r.gravity * TICK_S
        and sideways < HOLDS * r.friction * down
        and abs(torque[0]) < lever
        and abs(torque[1]) < lever
        and abs(torque[2]) < r.friction * lever
    )


@jitted
def _turned(q: F64, yaw: float) -> tuple[float, float, float, float]:
    """Return an attitude (w, x, y, z) that is turned about the vertical by ``yaw``, rad."""
    c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return c * q[0] - s * q[3], c * q[1] - s * q[2], c * q[2] + s * q[1], c * q[3] + s * q[0]


@jitted
def look(r: RestRecord, body: BodyRecord, deck: DeckRecord, on_pad: bool) -> None:
    """Count a step at rest; called at the end of a step, after the deck has moved.

    ``body``: the vehicle; ``on_pad``: whether in this step the vehicle touched the top of the pad and nothing
    else.
    """
    q = body.quaternion
    x, y = body.position[0] - deck.position[0], body.position[1] - deck.position[1]
    upright = rotation_axes(q)[8] > UPRIGHT
    if not (on_pad and upright and math.sqrt(x * x + y * y) + DIAGONAL * r.feet_m < r.pad_radius_m):
        r.steps = 0
        return
    c, s = math.cos(deck.yaw), math.sin(deck.yaw)
    x, y, z = c * x + s * y, c * y - s * x, body.position[2] - deck.position[2]
    place, attitude, now = r.place, r.attitude, _turned(q, -deck.yaw)
    dx, dy, dz = x - place[0], y - place[1], z - place[2]
    product = now[0] * attitude[0] + now[1] * attitude[1] + now[2] * attitude[2] + now[3] * attitude[3]
    same = abs(product) > 1.0 - SAME_RAD * SAME_RAD / 8.0  # cosine of half the angle between both attitudes
    if not (same and dx * dx + dy * dy + dz * dz < STILL_M * STILL_M):
        r.steps = 0
    r.steps += 1
    if r.steps == 1 or r.steps == r.wait_steps:
        place[0], place[1], place[2] = x, y, z
        attitude[0], attitude[1], attitude[2], attitude[3] = now
    if r.steps == r.wait_steps:
        _note_deck(r, deck)


@jitted
def carried(r: RestRecord, wrench: WrenchRecord, body: BodyRecord, deck: DeckRecord) -> bool:
    """Advance the deck and a resting vehicle by one step; if it does not rest, only return False."""
    if r.steps < r.wait_steps:
        return False
    if not _holds(r, wrench, deck):
        r.steps = 0
        return False
    move_deck(deck)
    _note_deck(r, deck)
    c, s = math.cos(deck.yaw), math.sin(deck.yaw)
    x, y = c * r.place[0] - s * r.place[1], s * r.place[0] + c * r.place[1]
    p, v, q = body.position, body.velocity, body.quaternion
    p[0], p[1], p[2] = deck.position[0] + x, deck.position[1] + y, deck.position[2] + r.place[2]
    v[0], v[1], v[2] = deck.velocity[0] - deck.rate * y, deck.velocity[1] + deck.rate * x, deck.velocity[2]
    q[0], q[1], q[2], q[3] = _turned(r.attitude, deck.yaw)
    axes = rotation_axes(q)
    for i in range(3):
        body.rates[i] = axes[2 + 3 * i] * deck.rate
    return True
