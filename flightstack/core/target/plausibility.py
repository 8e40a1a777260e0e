"""Plausibility of the vehicle state, and whether the vehicle follows the commanded velocity.

``drifted`` and ``smoothed`` judge the target's samples, too (``track.py``).

A link that delivers fresh time stamps can still deliver nonsense. Three things are known without a second
sensor:

* numbers that repeat to the last bit while they report motion, or for ``STILL_MAX_S`` while the vehicle
  flies set-points, are no new measurement: such a state ages. A vehicle at rest repeats its numbers;
* the position changes by the integrated velocity: the difference, summed with forgetting, is noise of both;
* the vehicle follows its set-points within its lag: velocity minus the velocity wanted, summed with a memory,
  is a distance it lags behind, at most its lag at full speed (``checks`` holds memories and bounds).

An error that is the same in position and velocity, such as an offset from the start, is not detected by any
of them.
"""

from __future__ import annotations

import math

from flightstack.core.memory import PlausibilityMemory
from flightstack.core.numeric import norm, numeric
from flightstack.core.parameters.flight import Checks, FlightConfig
from flightstack.core.types import ZERO, OwnState, Vec3

SMOOTHING_S = 0.2  # time constant, s: noise of 2 cm in each of 20 samples a second becomes 1 cm
TRUSTED_AGAIN = 0.5  # share of the bound; an offset of 0.3 m is rejected for some seconds
# Slower, equal numbers may be a vehicle at rest: firmware truncates to millimetres and shows the bias of its
# accelerometer as a velocity, 9 mm/s on a Crazyflie.
STANDING_M_S = 0.05
STILL_MAX_S = 0.5  # no vehicle hovers still to the millimetre for longer


@numeric
def repeats(before: Vec3, after: Vec3, velocity_m_s: Vec3, standing_m_s: float = STANDING_M_S) -> bool:
    """Whether a position is the last one to the bit, though it reports to move."""
    return before == after and norm(velocity_m_s) > standing_m_s


class Plausibility:
    """Checks vehicle state and set-points; ``memory`` is all of its state."""

    memory: PlausibilityMemory
    # bound of ``tracking_lag_m``: ``checks.follow_lag_max_s`` at the highest horizontal velocity
    tracking_lag_max_m: float
    period_s: float
    kept: float
    _checks: Checks

    def __init__(self, config: FlightConfig) -> None:
        self.memory = PlausibilityMemory()
        self._checks = config.checks
        vx, vy, _ = config.limits.velocity_max_m_s
        self.tracking_lag_max_m = config.checks.follow_lag_max_s * max(vx, vy)
        period_s = 1.0 / config.loop.rate_hz
        self.period_s, self.kept = period_s, math.exp(-period_s / config.checks.follow_memory_s)

    @property
    def drift_m(self) -> float:
        """Change of the position that the velocity does not explain."""
        return norm(self.memory.drift_m)

    @property
    def tracking_lag_m(self) -> float:
        """Distance by which the vehicle lags behind the commanded velocity."""
        return norm(self.memory.missed_m)

    def take(self, own: OwnState, flies: bool = False) -> None:
        """Check the newest vehicle state; a repeated one is ignored."""
        memory, last = self.memory, self.memory.last
        if last is not None and own.arrival_s == last.arrival_s:
            return
        if last is None or not flies or last.position_enu_m != own.position_enu_m:
            memory.moved_s = own.arrival_s
        elif own.arrival_s - memory.moved_s > STILL_MAX_S:
            return
        if last is not None and repeats(last.position_enu_m, own.position_enu_m, own.velocity_enu_m_s):
            return
        if last is not None:
            self._drift(last, own)
        memory.last = own
        drift_m = self.drift_m
        most_m = self._checks.own_drift_max_m
        memory.distrusted = drift_m > (TRUSTED_AGAIN * most_m if memory.distrusted else most_m)

    def believes(self, now_s: float) -> bool:
        """Whether the vehicle state is usable now."""
        last = self.memory.last
        if last is None or self.memory.distrusted:
            return False
        return now_s - last.arrival_s <= self._checks.own_age_max_s

    def follow(self, wanted_m_s: Vec3, velocity_m_s: Vec3) -> None:
        """Compare the velocity with the command of the last tick; call it once a tick."""
        t, kept = self.period_s, self.kept
        (mx, my, mz), (wx, wy, wz), (vx, vy, vz) = self.memory.missed_m, wanted_m_s, velocity_m_s
        self.memory.missed_m = (
            kept * (mx + t * (wx - vx)), kept * (my + t * (wy - vy)), kept * (mz + t * (wz - vz)),
        )  # fmt: skip

    def forget(self) -> None:
        """Restart the sum of ``follow``: the vehicle flew none of our set-points."""
        self.memory.missed_m = ZERO

    @property
    def follows(self) -> bool:
        """Whether the vehicle flies the commanded velocity."""
        return self.tracking_lag_m <= self.tracking_lag_max_m

    def _drift(self, last: OwnState, own: OwnState) -> None:
        dt_s = own.arrival_s - last.arrival_s
        if not 0.0 < dt_s <= self._checks.own_age_max_s:
            return  # lost in between: so old a state does not limit the present position
        self.memory.drift_m = drifted(
            self.memory.drift_m, last.position_enu_m, own.position_enu_m,
            last.velocity_enu_m_s, own.velocity_enu_m_s, dt_s, self._checks.own_drift_memory_s,
        )  # fmt: skip


@numeric
def drifted(d: Vec3, p0: Vec3, p: Vec3, v0: Vec3, v: Vec3, dt_s: float, memory_s: float) -> Vec3:
    """Change of the position that no velocity explains, after another state."""
    kept, half = math.exp(-dt_s / memory_s), 0.5 * dt_s
    return (
        kept * (d[0] + (p[0] - p0[0]) - half * (v[0] + v0[0])),
        kept * (d[1] + (p[1] - p0[1]) - half * (v[1] + v0[1])),
        kept * (d[2] + (p[2] - p0[2]) - half * (v[2] + v0[2])),
    )


@numeric
def smoothed(before: Vec3, now: Vec3, dt_s: float) -> Vec3:
    """Low-pass of a drift, after a sample."""
    share = dt_s / (dt_s + SMOOTHING_S)
    (x0, y0, z0), (x, y, z) = before, now
    return (x0 + share * (x - x0), y0 + share * (y - y0), z0 + share * (z - z0))
