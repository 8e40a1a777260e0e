"""Which target samples to believe, and where the target is now.

Default deny: a sample counts only if it is finite, of the right robot, newer than the last, in time and where
the last one could have gone. What was refused is counted by reason.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

from flightstack.config import Checks
from flightstack.types import TargetSample, Vec3

RESTART_S = 10.0  # stamps this far apart after a silence: the sender's clock started anew


class Verdict(Enum):
    """What became of a sample."""

    ACCEPTED = "accepted"
    NOT_FINITE = "not finite"
    WRONG_ROBOT = "from another robot or frame"
    REPEATED = "repeated"
    OUT_OF_ORDER = "out of order"
    LATE = "too late"
    TOO_FAST = "faster than allowed"
    JUMP = "jumped"


class TargetState(NamedTuple):
    """The target at the time asked for."""

    age_s: float
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    yaw_rad: float


class TargetTrack:
    """Newest believed sample, and the counts of the others."""

    def __init__(self, checks: Checks) -> None:
        self._checks = checks
        self._last: TargetSample | None = None
        self._offset_s = math.inf  # smallest arrival - stamp seen: clock offset plus the shortest delay
        self._elsewhere: TargetSample | None = None  # newest of samples that jumped but agree with each other
        self._elsewhere_since_s = 0.0
        self.accepted = 0
        self.rejected = 0

    def accept(self, sample: TargetSample) -> Verdict:
        """Take or refuse one sample."""
        verdict = self._judge(sample)
        if verdict is Verdict.ACCEPTED:
            self._last = sample
            self._offset_s = min(self._offset_s, sample.arrival_s - sample.source_time_s)
            self.accepted += 1
        else:
            self.rejected += 1
        return verdict

    def _judge(self, sample: TargetSample) -> Verdict:
        checks, last = self._checks, self._last
        x, y, z = sample.position_enu_m
        vx, vy, vz = sample.velocity_enu_m_s
        if not math.isfinite(x + y + z + vx + vy + vz + sample.yaw_rad + sample.source_time_s):
            return Verdict.NOT_FINITE
        if sample.frame_id != checks.target_frame or sample.child_frame_id != checks.target_child_frame:
            return Verdict.WRONG_ROBOT
        if vx * vx + vy * vy + vz * vz > checks.target_speed_max_m_s**2:
            return Verdict.TOO_FAST
        if last is None:
            return Verdict.ACCEPTED
        step_s = sample.source_time_s - last.source_time_s
        lost = sample.arrival_s - last.arrival_s > checks.target_age_max_s
        if lost and abs(step_s - (sample.arrival_s - last.arrival_s)) > RESTART_S:
            self._offset_s = math.inf
            return Verdict.ACCEPTED
        if step_s == 0.0:
            return Verdict.REPEATED
        if step_s < 0.0:
            return Verdict.OUT_OF_ORDER
        if sample.arrival_s - sample.source_time_s - self._offset_s > checks.target_age_max_s:
            return Verdict.LATE
        if lost and self._elsewhere is None:
            return Verdict.ACCEPTED  # nothing so old binds where it is now
        if self._near(last, sample) or self._proved(sample, lost):
            self._elsewhere = None
            return Verdict.ACCEPTED
        return Verdict.JUMP

    def _near(self, before: TargetSample, after: TargetSample) -> bool:
        """Whether the target could have gone from one sample to the other."""
        step_s = after.source_time_s - before.source_time_s
        (x0, y0, z0), (vx, vy, vz), (x, y, z) = (
            before.position_enu_m,
            before.velocity_enu_m_s,
            after.position_enu_m,
        )
        dx, dy, dz = x - x0 - vx * step_s, y - y0 - vy * step_s, z - z0 - vz * step_s
        return dx * dx + dy * dy + dz * dz <= self._checks.target_jump_max_m**2

    def _proved(self, sample: TargetSample, lost: bool) -> bool:
        """Whether samples elsewhere have agreed with each other for long enough, the old track being lost."""
        if self._elsewhere is None or not self._near(self._elsewhere, sample):
            self._elsewhere, self._elsewhere_since_s = sample, sample.arrival_s
            return False
        self._elsewhere = sample
        # longer than the age limit, so that the vehicle holds in between
        proof_s = self._checks.target_age_max_s + self._checks.recovery_time_s
        return lost and sample.arrival_s - self._elsewhere_since_s >= proof_s

    def at(self, now_s: float) -> TargetState | None:
        """Target moved on to now with its last velocity; ``None`` before the first sample.

        The age counts from the measurement, less the shortest delay seen (clocks of two machines differ).
        """
        last = self._last
        if last is None:
            return None
        age_s = max(0.0, now_s - last.source_time_s - self._offset_s)
        ahead_s = min(age_s, self._checks.target_age_max_s)
        x, y, z = last.position_enu_m
        vx, vy, vz = last.velocity_enu_m_s
        position = (x + vx * ahead_s, y + vy * ahead_s, z + vz * ahead_s)
        return TargetState(age_s, position, last.velocity_enu_m_s, last.yaw_rad)
