"""Plausibility of target samples, and the current state of the target.

The default is to deny: a sample is accepted only if it is finite, of the configured robot, in time, newer
than the last sample, and reachable from the last sample. Rejected samples are counted.

A velocity that contradicts the positions, such as a twist in the wrong frame or a heading that is wrong by
half a turn, is detected over some samples. Position minus integrated velocity, summed with decay, is only
noise for correct samples; above the limit ``checks.target_drift_max_m`` the target is distrusted until the
sum is below half the limit. After the second contradiction the target remains distrusted, because a target
at rest shows no contradiction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from flightstack.core.memory import TrackMemory
from flightstack.core.numeric import STAND_INS, norm, rare
from flightstack.core.parameters.flight import Checks
from flightstack.core.sender_clock import PATIENCE_S, Reading, SenderClock
from flightstack.core.target.plausibility import SMOOTHING_S, TRUSTED_AGAIN, drifted, repeats, smoothed
from flightstack.core.types import TargetSample, Vec3

STANDING_M_S = 1e-3  # speed above which a target moves, m/s; at rest its position can repeat to the bit
DISTRUSTS_MAX = 2  # number of contradictions in a flight after which the target remains distrusted


class TargetState(NamedTuple):
    """State of the target at the requested time."""

    age_s: float  # age of the newest sample, s
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    yaw_rad: float
    position_sigma_m: float = 0.0  # standard deviation of x, which equals that of y, m; 0: not estimated
    position_sigma_z_m: float = 0.0


class TargetTrack:
    """Newest accepted sample, and counters of samples; ``memory`` is the complete state."""

    memory: TrackMemory
    # step of the sender's clock at the newest sample, s; positive: the clock jumped forwards; 0: no step
    stepped_s: float
    _checks: Checks  # limits of the configuration
    _clock: SenderClock

    def __init__(self, checks: Checks, tick_s: float = 0.0) -> None:
        self.memory = TrackMemory()
        self._checks = checks
        self._clock = SenderClock(checks.target_age_max_s, checks.recovery_time_s, tick_s, memory=self.memory)
        self.stepped_s = 0.0

    @property
    def newest(self) -> TargetSample:
        """Newest accepted sample, which must exist."""
        last = self.memory.last
        assert last is not None
        return last

    def accept(self, sample: TargetSample) -> Reading:
        """Check one sample; an accepted sample becomes the newest one."""
        verdict, memory = self._judge(sample), self.memory
        self.stepped_s = 0.0
        if verdict is Reading.FRESH:
            before_s = memory.offset_s
            if self._clock.take(sample.source_time_s, sample.arrival_s):
                self.stepped_s = before_s - memory.offset_s
            elif memory.last is not None:
                self._drift(memory.last, sample)
            memory.last = sample
            memory.accepted += 1
            if memory.refusal:
                self._note(verdict)
        else:
            memory.rejected += 1
            self._note(verdict)
        return verdict

    @rare
    def _note(self, verdict: Reading) -> None:
        self.memory.refusal = "" if verdict is Reading.FRESH else verdict.text

    @property
    def moves_m_s(self) -> Vec3:
        """Velocity of the target from its positions, m/s: reported velocity plus rate of the drift."""
        memory, memory_s = self.memory, self._checks.target_drift_memory_s
        velocity, drift, smooth = self.newest.velocity_enu_m_s, memory.drift_m, memory.drift_smooth_m
        x, y, z = (
            v + (d - s) / SMOOTHING_S + s / memory_s for v, d, s in zip(velocity, drift, smooth, strict=True)
        )
        return x, y, z

    def _drift(self, last: TargetSample, sample: TargetSample) -> None:
        checks, memory, dt_s = self._checks, self.memory, sample.source_time_s - last.source_time_s
        if not 0.0 < dt_s <= checks.target_age_max_s:
            return  # during a longer gap between the samples the velocity is unknown
        memory.drift_m = drifted(memory.drift_m, last, sample, dt_s, checks.target_drift_memory_s)
        memory.drift_smooth_m = smoothed(memory.drift_smooth_m, memory.drift_m, dt_s)
        drift_m, most_m = norm(memory.drift_smooth_m), checks.target_drift_max_m
        if memory.distrusted:
            memory.parted_m = max(memory.parted_m, drift_m)
            memory.distrusted = drift_m > TRUSTED_AGAIN * most_m or memory.distrusts >= DISTRUSTS_MAX
        elif drift_m > most_m:
            memory.distrusted, memory.parted_m = True, drift_m
            memory.distrusts += memory.settled

    def _judge(self, sample: TargetSample) -> Reading:
        checks, memory = self._checks, self.memory
        last = memory.last
        x, y, z = sample.position_enu_m
        vx, vy, vz = sample.velocity_enu_m_s
        if not math.isfinite(x + y + z + vx + vy + vz + sample.yaw_rad + sample.source_time_s):
            return Reading.NOT_FINITE
        if sample.frame_id != checks.target_frame or sample.child_frame_id != checks.target_child_frame:
            return Reading.WRONG_ROBOT
        if vx * vx + vy * vy + vz * vz > checks.target_speed_max_m_s * checks.target_speed_max_m_s:
            return Reading.TOO_FAST
        patience_s = math.inf if memory.settled else PATIENCE_S
        reading = self._clock.judge(sample.source_time_s, sample.arrival_s, patience_s)
        if reading is not Reading.FRESH and reading is not Reading.STEPPED:
            return reading
        if last is None:
            return Reading.FRESH
        if repeats(last.position_enu_m, sample.position_enu_m, sample.velocity_enu_m_s, STANDING_M_S):
            return Reading.FROZEN
        stepped = reading is Reading.STEPPED
        lost = sample.arrival_s - last.arrival_s > checks.target_age_max_s
        step_s = sample.source_time_s - last.source_time_s
        if lost or stepped or self._searches() or not self._near(last, sample, sample, step_s):
            return self._judge_anew(last, sample, lost, stepped)
        return Reading.FRESH

    @rare
    def _judge_anew(self, last: TargetSample, sample: TargetSample, lost: bool, stepped: bool) -> Reading:
        """Check the position of a sample that is far from the last one or follows a loss of the target."""
        checks, memory, away = self._checks, self.memory, self.memory.elsewhere
        gap_s = sample.arrival_s - last.arrival_s
        # if clock and position restart together, the odometry has restarted: the robot itself did not jump
        reach_m = checks.target_jump_max_m + checks.target_speed_max_m_s * gap_s
        free = not stepped or math.dist(last.position_enu_m, sample.position_enu_m) <= reach_m
        if lost and free and away is None:
            return Reading.FRESH  # after a loss any position of the target is possible
        step_s = gap_s if stepped else sample.source_time_s - last.source_time_s
        stays = away is not None and self._near(
            away, sample, sample, sample.source_time_s - away.source_time_s
        )
        # time for which samples at the new place must agree, s; longer than the age limit: HOLD starts first
        proof_s = checks.target_age_max_s + checks.recovery_time_s
        # after a loss, the current or the last velocity can explain a wrong position by chance; samples that
        # continue from the new place show that the target is really there
        if lost and stays:
            good = not memory.settled and sample.arrival_s - memory.elsewhere_since_s >= proof_s
        else:
            good = self._near(last, sample, last if lost else sample, step_s)
        memory.elsewhere = None if good else sample
        if not (good or stays):
            memory.elsewhere_since_s = sample.arrival_s
        return Reading.FRESH if good else Reading.JUMP

    def _searches(self) -> bool:
        """Whether the newest sample jumped to another place; such a tick does not run compiled."""
        return self.memory.elsewhere is not None

    def _near(self, before: TargetSample, after: TargetSample, at_last: TargetSample, step_s: float) -> bool:
        """Whether the mean of two velocities explains the target's motion between two samples.

        The mean is exact under constant acceleration.
        """
        (x0, y0, z0), (vx0, vy0, vz0) = before.position_enu_m, before.velocity_enu_m_s
        (x1, y1, z1), (vx1, vy1, vz1) = after.position_enu_m, at_last.velocity_enu_m_s
        half_s, most_m = 0.5 * step_s, self._checks.target_jump_max_m
        dx = x1 - x0 - (vx0 + vx1) * half_s
        dy = y1 - y0 - (vy0 + vy1) * half_s
        dz = z1 - z0 - (vz0 + vz1) * half_s
        return dx * dx + dy * dy + dz * dz <= most_m * most_m

    def age_s(self, sample: TargetSample, now_s: float) -> float:
        """Return the age of a sample minus the shortest delay, which is unknown because the clocks differ."""
        return self._clock.lateness_s(sample.source_time_s, now_s)

    def at(self, now_s: float) -> TargetState:
        """Return the target state, extrapolated to now with its last velocity, after an accepted sample."""
        last = self.newest
        age_s = self.age_s(last, now_s)
        ahead_s = min(age_s, self._checks.target_age_max_s)
        (x, y, z), (vx, vy, vz) = last.position_enu_m, last.velocity_enu_m_s
        position = (x + vx * ahead_s, y + vy * ahead_s, z + vz * ahead_s)
        return TargetState(age_s, position, last.velocity_enu_m_s, last.yaw_rad, 0.0, 0.0)


def _never(_one: TargetTrack) -> bool:
    return False


STAND_INS[TargetTrack._searches] = _never
