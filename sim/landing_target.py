"""The ground robot of a landing in one process: true poses for the deck, samples for the onboard process.

Numbers pass as over Zenoh: CDR carries doubles, so only the turning of frames at both ends is left to do.
"""

from __future__ import annotations

import math

from bridge.frames import (
    Quat,
    quaternion_from_yaw,
    world_from_body,
    world_from_body_velocity,
    yaw_from_quaternion,
)
from flightstack.pacing import EPOCH_NS, NO_GO
from flightstack.types import TargetSample
from sim.pacing import TickGrid
from sim.process_deck import DeckState, LockstepDeck
from sim.scenario import Scenario
from sim.target import TargetMeasurement
from sim.target_motion import TargetMotion


class DirectTarget(LockstepDeck):
    """Drives when it is asked for a tick's pose; ``go_tick`` is set by the onboard side, as in lockstep."""

    def __init__(self, scenario: Scenario, seed: int, grid: TickGrid) -> None:
        self.bad = 0
        self.go_tick = NO_GO
        self._grid = grid
        self._motion = TargetMotion(scenario, seed, grid)
        self._driving = self._motion.drives_at_once

    def has(self, tick: int) -> bool:
        """Always."""
        del tick
        return True

    def take(self, tick: int) -> DeckState | None:
        """Go on to this tick; true pose there."""
        motion = self._motion
        while motion.tick < tick:
            if NO_GO < self.go_tick <= motion.tick + 1:
                motion.faults.landing_began(self._grid.ns(self.go_tick))
                self._driving = True
            motion.step(self._driving)
        model = motion.model
        q = quaternion_from_yaw(model.pose.yaw_rad)
        return DeckState(
            model.pose.position_enu_m,
            yaw_from_quaternion(q),
            world_from_body(q, model.velocity_body_m_s),
            model.yaw_rate_rad_s,
            b"",
        )

    def samples(self, arrival_s: float) -> tuple[TargetSample, ...]:
        """Odometry released since the last call."""
        motion = self._motion
        if not motion.due:
            return ()
        due, motion.due = motion.due, []
        return tuple(received(sample, arrival_s) for sample in due)


def received(sample: TargetMeasurement, arrival_s: float) -> TargetSample:
    """Equal to ``bridge.odometry.sample_from_cdr`` of the encoded sample, which a test holds."""
    w, x, y, z = quaternion_from_yaw(sample.yaw_rad)
    scale = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    q: Quat = (w * scale, x * scale, y * scale, z * scale)
    return TargetSample(
        arrival_s=arrival_s,
        source_time_s=(EPOCH_NS + round(sample.time_s * 1e9)) / 1e9,
        frame_id="map",
        child_frame_id="target",
        position_enu_m=sample.position_enu_m,
        velocity_enu_m_s=world_from_body_velocity(q, sample.velocity_body_m_s),
        yaw_rad=yaw_from_quaternion(q),
        yaw_rate_rad_s=world_from_body(q, (0.0, 0.0, sample.yaw_rate_rad_s))[2],
    )
