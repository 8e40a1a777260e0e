"""Last check before a set-point is sent; only this check makes an ``ApprovedSetpoint``.

The default is to deny. The bridge sends only velocities of this type, and only ``Gate`` can build objects of
this type. The gate builds a new object in each tick, so that no stored set-point is sent twice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from flightstack.core.numeric import hypot
from flightstack.core.safety.barrier import ActiveBarrier
from flightstack.core.safety.qp_filter import RESIDUAL_MAX_M_S
from flightstack.core.types import FilterStatus, Vec3

_KEY = object()
BOX_TOLERANCE_M_S = 1e-9  # allowed excess over a velocity limit, m/s
SOLVER_TOLERANCE_M_S = 2.0 * RESIDUAL_MAX_M_S  # allowed violation of eq. 11, m/s, with rounding errors


class GateVerdict(IntEnum):
    """Result of the gate: the reason why a set-point is sent or rejected."""

    APPROVED = 0
    NOT_IN_CONTROL = 1  # this phase sends no set-point
    OWN_STALE = 2  # the vehicle state is missing, too old or implausible
    TARGET_STALE = 3  # the target state is too old or implausible, and the filter is active
    NOT_FINITE = 4
    OUTSIDE_BOX = 5  # a velocity limit is exceeded
    BARRIER = 6  # h of the next tick would be lower than the filter guarantees
    TOO_HIGH = 7  # the vehicle is above the maximum altitude, and the command is a climb


class ApprovedSetpoint:
    """Velocity that passed the gate in this tick; immutable."""

    __slots__ = ("velocity_enu_m_s", "yaw_rad")
    velocity_enu_m_s: Vec3
    yaw_rad: float

    def __init__(self, key: object, velocity_enu_m_s: Vec3, yaw_rad: float) -> None:
        if key is not _KEY:
            raise TypeError("an ApprovedSetpoint is made by the gate only")
        _fill(self, "velocity_enu_m_s", velocity_enu_m_s)
        _fill(self, "yaw_rad", yaw_rad)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"an ApprovedSetpoint is not changed: {name} = {value!r} is not approved")

    def __delattr__(self, name: str) -> None:
        raise AttributeError(f"an ApprovedSetpoint is not changed: {name} stays")


_fill = object.__setattr__


class BarrierCheck(NamedTuple):
    """Data for the gate's check of the active barrier, and the status of the filter's result."""

    barrier: ActiveBarrier
    e_m: Vec3
    target_velocity_enu_m_s: Vec3
    status: FilterStatus


@dataclass(frozen=True, slots=True)
class Gate:
    """Check of each set-point against the limits; only this class approves set-points."""

    omega_1_s: float
    velocity_max_m_s: Vec3
    altitude_max_m: float
    period_s: float

    def check(
        self, velocity: Vec3, setpoint: Vec3, yaw_rad: float, *, own_fresh: bool, target_fresh: bool,
        altitude_m: float, barrier_check: BarrierCheck | None,
    ) -> tuple[GateVerdict, ApprovedSetpoint | None]:  # fmt: skip
        """Approve a velocity, or return the reason for its rejection."""
        verdict = self.verdict(velocity, yaw_rad, own_fresh, target_fresh, altitude_m)
        kept = barrier_check is None or self.keeps_promise(velocity, barrier_check)
        if verdict is GateVerdict.APPROVED and not kept:
            verdict = GateVerdict.BARRIER
        if verdict is GateVerdict.APPROVED and setpoint != velocity:
            verdict = self.verdict(setpoint, yaw_rad, own_fresh, target_fresh, altitude_m)
        if verdict is GateVerdict.APPROVED:
            return verdict, ApprovedSetpoint(_KEY, setpoint, yaw_rad)
        return verdict, None

    def stop(self, yaw_rad: float, *, own_fresh: bool) -> ApprovedSetpoint | None:
        """Return zero velocity in place of a rejected command; ``None`` without a recent vehicle state."""
        if not own_fresh or not math.isfinite(yaw_rad):
            return None
        return ApprovedSetpoint(_KEY, (0.0, 0.0, 0.0), yaw_rad)

    def verdict(
        self, velocity: Vec3, yaw_rad: float, own_fresh: bool, target_fresh: bool, altitude_m: float
    ) -> GateVerdict:
        """Check a velocity except for the barrier; the arguments are those of ``check``."""
        if not own_fresh:
            return GateVerdict.OWN_STALE
        if not target_fresh:
            return GateVerdict.TARGET_STALE
        vx, vy, vz = velocity
        if not math.isfinite(vx + vy + vz + yaw_rad + altitude_m):
            return GateVerdict.NOT_FINITE
        mx, my, mz = self.velocity_max_m_s
        if (
            abs(vx) > mx + BOX_TOLERANCE_M_S
            or abs(vy) > my + BOX_TOLERANCE_M_S
            or abs(vz) > mz + BOX_TOLERANCE_M_S
        ):
            return GateVerdict.OUTSIDE_BOX
        if altitude_m > self.altitude_max_m and vz > 0.0:
            return GateVerdict.TOO_HIGH
        return GateVerdict.APPROVED

    def keeps_promise(self, velocity: Vec3, check: BarrierCheck) -> bool:
        """Whether h of the next tick, predicted with constant velocities, satisfies the bound of eq. 11.

        The bound is linear. A valid filter result can violate this bound only by two effects: the boundary's
        curvature, and the slope that the gradient neglects at the apex (docs/how_it_works/robust_filter.md).
        """
        status, hopeless = check.status, check.status is FilterStatus.INFEASIBLE
        solved = status is FilterStatus.SOLVED or status is FilterStatus.CLOSED_FORM
        own = status is FilterStatus.OWN  # a user's class guarantees nothing
        if not (solved or hopeless or own or status is FilterStatus.CROWDED):
            return False
        t = self.period_s
        (ex, ey, ez), (tx, ty, tz), (vx, vy, vz) = check.e_m, check.target_velocity_enu_m_s, velocity
        now = check.barrier.h(check.e_m)
        then = check.barrier.h((ex + (vx - tx) * t, ey + (vy - ty) * t, ez + (vz - tz) * t))
        if not math.isfinite(now + then):
            return False
        if hopeless or own:
            return True  # if the program is infeasible, the box contains no better velocity
        missing_m = now * (1.0 - self.omega_1_s * t) - then - SOLVER_TOLERANCE_M_S * t
        # missing_m is usually <= 0; the tolerance is then not computed
        return missing_m <= 0.0 or missing_m <= check.barrier.linearisation_bound_m(
            check.e_m, hypot(vx - tx, vy - ty) * t
        )
