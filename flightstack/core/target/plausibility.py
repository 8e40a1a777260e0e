"""Plausibility of the vehicle state, and whether the vehicle follows the commanded velocity.

``track.py`` uses ``drifted`` and ``smoothed`` for the target's samples, too.

A link that delivers recent time stamps can still deliver wrong data. Three checks need no second
sensor:

* a state that repeats to the last bit while it reports motion, or for ``STILL_MAX_S`` while the vehicle
  follows set-points, is not a new measurement, so its age grows. Only a vehicle at rest repeats its state;
* the integrated velocity equals the change of position; their difference, summed with decay, is only noise;
* the vehicle follows its set-points with a lag. Commanded velocity minus velocity, summed with decay, is the
  distance by which the vehicle lags, at most that at full speed (``checks`` has decay times and limits).

No check detects errors of position and velocity that agree, such as a constant offset of the position.
"""

from __future__ import annotations

import math

from flightstack.core.memory import PlausibilityMemory
from flightstack.core.numeric import norm
from flightstack.core.parameters.flight import Checks, FlightConfig
from flightstack.core.types import ZERO, OwnState, TargetSample, Vec3

SMOOTHING_S = 0.2  # time constant of the drift's low-pass, s; noise of 2 cm at 20 Hz becomes 1 cm
TRUSTED_AGAIN = 0.5  # fraction of the maximum allowed drift below which a state is trusted again
# Speed below which a vehicle with equal positions can be at rest, m/s: firmware truncates positions to
# millimetres and reports the bias of its accelerometer as a velocity, 9 mm/s on a Crazyflie.
STANDING_M_S = 0.05
STILL_MAX_S = 0.5  # maximum time for which a hovering vehicle may report equal positions, s


def repeats(before: Vec3, after: Vec3, velocity_m_s: Vec3, standing_m_s: float = STANDING_M_S) -> bool:
    """Whether a position equals the last one to the last bit, although motion is reported."""
    return before == after and norm(velocity_m_s) > standing_m_s


class Plausibility:
    """Checks of vehicle state and set-points; ``memory`` is their complete state."""

    memory: PlausibilityMemory
    # bound of ``tracking_lag_m``, m: ``checks.follow_lag_max_s`` at the maximum horizontal velocity
    tracking_lag_max_m: float
    period_s: float
    kept: float  # fraction of the tracking lag that remains after a tick
    _checks: Checks

    def __init__(self, config: FlightConfig) -> None:
        checks, (vx, vy, _) = config.checks, config.limits.velocity_max_m_s
        self.memory, self._checks, self.period_s = PlausibilityMemory(), checks, 1.0 / config.loop.rate_hz
        self.tracking_lag_max_m = checks.follow_lag_max_s * max(vx, vy)
        self.kept = math.exp(-self.period_s / checks.follow_memory_s)

    @property
    def drift_m(self) -> float:
        """Length of the position change that the reported velocity does not explain, m."""
        return norm(self.memory.drift_m)

    @property
    def tracking_lag_m(self) -> float:
        """Distance by which the vehicle lags behind the commanded velocity, m."""
        return norm(self.memory.missed_m)

    def take(self, own: OwnState, flies: bool = False) -> None:
        """Check the newest vehicle state; a state that was already checked is ignored."""
        memory, last, checks = self.memory, self.memory.last, self._checks
        if last is not None and own.arrival_s == last.arrival_s:
            return
        if last is None or not flies or last.position_enu_m != own.position_enu_m:
            memory.moved_s = own.arrival_s
        elif own.arrival_s - memory.moved_s > STILL_MAX_S:
            return
        if last is not None:
            if repeats(last.position_enu_m, own.position_enu_m, own.velocity_enu_m_s):
                return
            dt_s = own.arrival_s - last.arrival_s
            if 0.0 < dt_s <= checks.own_age_max_s:  # during a longer gap the velocity is unknown
                memory.drift_m = drifted(memory.drift_m, last, own, dt_s, checks.own_drift_memory_s)
        memory.last = own
        most_m = checks.own_drift_max_m
        memory.distrusted = self.drift_m > (TRUSTED_AGAIN * most_m if memory.distrusted else most_m)

    def trusts(self, now_s: float) -> bool:
        """Whether the vehicle state is usable now."""
        last = self.memory.last
        fresh = last is not None and now_s - last.arrival_s <= self._checks.own_age_max_s
        return fresh and not self.memory.distrusted

    def follow(self, wanted_m_s: Vec3, velocity_m_s: Vec3) -> None:
        """Compare the velocity with the command of the last tick; call this method once a tick."""
        t, kept = self.period_s, self.kept
        (mx, my, mz), (wx, wy, wz), (vx, vy, vz) = self.memory.missed_m, wanted_m_s, velocity_m_s
        self.memory.missed_m = (
            kept * (mx + t * (wx - vx)), kept * (my + t * (wy - vy)), kept * (mz + t * (wz - vz)),
        )  # fmt: skip

    def forget(self) -> None:
        """Reset the sum of ``follow``, because the vehicle did not follow set-points of this stack."""
        self.memory.missed_m = ZERO

    @property
    def follows(self) -> bool:
        """Whether the vehicle follows the commanded velocity."""
        return self.tracking_lag_m <= self.tracking_lag_max_m


def drifted(
    d: Vec3, last: OwnState | TargetSample, new: OwnState | TargetSample, dt_s: float, memory_s: float
) -> Vec3:
    """Return the unexplained position change, m, updated with a new state ``dt_s`` after the last one."""
    p0, v0, p, v = last.position_enu_m, last.velocity_enu_m_s, new.position_enu_m, new.velocity_enu_m_s
    kept, half = math.exp(-dt_s / memory_s), 0.5 * dt_s
    return (
        kept * (d[0] + (p[0] - p0[0]) - half * (v[0] + v0[0])),
        kept * (d[1] + (p[1] - p0[1]) - half * (v[1] + v0[1])),
        kept * (d[2] + (p[2] - p0[2]) - half * (v[2] + v0[2])),
    )


def smoothed(before: Vec3, now: Vec3, dt_s: float) -> Vec3:
    """Return the low-pass filtered drift after a new sample."""
    share = dt_s / (dt_s + SMOOTHING_S)
    (x0, y0, z0), (x, y, z) = before, now
    return (x0 + share * (x - x0), y0 + share * (y - y0), z0 + share * (z - z0))
