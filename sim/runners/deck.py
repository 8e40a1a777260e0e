"""Moves the deck of the vehicle process by the robot's true poses, which arrive over Zenoh."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from typing import NamedTuple

from bridge.frames import world_from_body, yaw_from_quaternion
from bridge.ros2.cdr import OdometryError, decode_odometry
from bridge.zenoh import zenoh_link
from flightstack.core.types import ZERO, Vec3
from sim.plant.vehicle_types import Truth

STALE_S = 0.5  # age of the newest true pose after which the deck stops
_PULL_1_S = 5.0  # velocity per position error; a jump would throw the vehicle off the deck
_SNAP_M = 0.3  # larger errors are corrected by a jump: timing cannot cause them


class DeckState(NamedTuple):
    """Pose and velocity of the pad centre, ENU, and the message that carried them."""

    position_enu_m: Vec3
    yaw_rad: float
    velocity_enu_m_s: Vec3
    yaw_rate_rad_s: float
    payload: bytes


def deck_state(payload: bytes) -> DeckState:
    """Decode a true pose. Raises OdometryError: malformed message, or a number is not finite."""
    found = decode_odometry(payload)
    position, q, velocity, rate = (
        found.position_m, found.orientation_wxyz, found.linear_m_s, found.angular_rad_s[2]
    )  # fmt: skip
    if not math.isfinite(sum((*position, *q, *velocity, rate))):
        raise OdometryError("true pose of the robot holds a number that is not finite")
    return DeckState(position, yaw_from_quaternion(q), world_from_body(q, velocity), rate, payload)


class RealTimeDeck:
    """Follows true poses that arrive at any time: dead reckoning with the last twist, smoothly corrected."""

    def __init__(self, session: zenoh_link.Session, namespace: str) -> None:
        self._subscriber = zenoh_link.ring_subscriber(session, truth_key(namespace))
        self._last: DeckState | None = None
        self._last_s = 0.0
        self._stopped = False  # whether the warning was sent

    def move(
        self, now_s: float, truth: Truth, log: Callable[[bytes], None], warn: Callable[[str], None]
    ) -> DeckState | None:
        """Read new poses and return the next state of the deck; None before the first pose.

        ``truth``: true state with the deck's current pose; ``log``: called with each message.
        """
        payloads = [sample.payload.to_bytes() for sample in zenoh_link.drain(self._subscriber)]
        for payload in payloads:
            log(payload)
        for payload in reversed(payloads):
            with contextlib.suppress(OdometryError):
                self._last, self._last_s = deck_state(payload), now_s
                break
        if self._last is None:
            return None
        position_enu_m, yaw_rad, age_s = truth.pad_position_enu_m, truth.pad_yaw_rad, now_s - self._last_s
        stopped, self._stopped = self._stopped, age_s > STALE_S
        if not self._stopped:
            return follow(self._last, age_s, position_enu_m, yaw_rad)
        if not stopped:
            warn("Robot's pose too old: deck stopped")
        return DeckState(position_enu_m, yaw_rad, ZERO, 0.0, b"")


def follow(last: DeckState, age_s: float, position_enu_m: Vec3, yaw_rad: float) -> DeckState:
    """Return the deck state that corrects its position error smoothly, or by a jump if the error is large.

    ``last``: the newest true pose; ``position_enu_m``, ``yaw_rad``: pose of the simulated deck.
    """
    there = reckon(last, age_s)
    x, y, z = position_enu_m
    ex, ey, ez = there.position_enu_m[0] - x, there.position_enu_m[1] - y, there.position_enu_m[2] - z
    if math.hypot(ex, ey, ez) > _SNAP_M:
        return there
    vx, vy, vz = there.velocity_enu_m_s
    pulled = (vx + _PULL_1_S * ex, vy + _PULL_1_S * ey, vz + _PULL_1_S * ez)
    turn = _PULL_1_S * math.remainder(there.yaw_rad - yaw_rad, math.tau)
    return DeckState(position_enu_m, yaw_rad, pulled, there.yaw_rate_rad_s + turn, last.payload)


def reckon(last: DeckState, age_s: float) -> DeckState:
    """Return the state after ``age_s`` of dead reckoning on an arc of constant twist."""
    turn = last.yaw_rate_rad_s * age_s
    vx, vy, vz = last.velocity_enu_m_s
    x, y, z = last.position_enu_m
    # The chord of the arc turns by half the angle of the velocity; its length is almost the arc's.
    c, s = math.cos(0.5 * turn), math.sin(0.5 * turn)
    there = (x + (c * vx - s * vy) * age_s, y + (s * vx + c * vy) * age_s, z + vz * age_s)
    c, s = math.cos(turn), math.sin(turn)
    velocity = (c * vx - s * vy, s * vx + c * vy, vz)
    return DeckState(there, last.yaw_rad + turn, velocity, last.yaw_rate_rad_s, last.payload)


def truth_key(namespace: str) -> str:
    """Return the Zenoh key of the robot's true pose."""
    return f"{namespace}/sim/target/truth"
