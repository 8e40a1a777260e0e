"""The ground robot of a landing in one process: true poses for the deck, samples for the onboard process.

Numbers pass as over Zenoh: CDR carries doubles, so only the turning of frames at both ends is left to do.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple, cast

from bridge import frames
from bridge.frames import Quat
from flightstack.common.pacing import EPOCH_NS, NO_GO, RUN_AHEAD_TICKS
from flightstack.compiled.jit import jitted
from flightstack.core.types import TargetSample, Vec3
from flightstack.onboard.runner import NOTHING, Arrived
from sim.clock import TickGrid
from sim.robot.target import TargetMeasurement
from sim.robot.target_motion import TargetMotion
from sim.runners.deck import DeckState, LockstepDeck
from sim.scenarios.scenario import Scenario

WorldSample = tuple[float, str, str, Vec3, Vec3, float, float]  # a target sample but for when it arrives

# the very formulas of both ends, compiled
_quaternion = cast("Callable[[float], Quat]", jitted(frames.quaternion_from_yaw))
_yaw = cast("Callable[[Quat], float]", jitted(frames.yaw_from_quaternion))
_turn = cast("Callable[[Quat, Vec3], Vec3]", jitted(frames.world_from_body))


@jitted
def _deck_twist(yaw: float, vx: float, vy: float, vz: float) -> tuple[float, Vec3]:
    """Heading and velocity of a true pose as they arrive."""
    q = _quaternion(yaw)
    return _yaw(q), _turn(q, (vx, vy, vz))


@jitted
def _sample_twist(yaw: float, vx: float, vy: float, vz: float, rate: float) -> tuple[float, Vec3, float]:
    """The same of a sample, and turn rate; here the receiver scales the quaternion to one."""
    w, x, y, z = _quaternion(yaw)
    scale = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    q = (w * scale, x * scale, y * scale, z * scale)
    return _yaw(q), _turn(q, (vx, vy, vz)), _turn(q, (0.0, 0.0, rate))[2]


class Ahead(NamedTuple):
    """What the robot will say at a tick."""

    deck: DeckState
    samples: list[WorldSample]


class DirectTarget(LockstepDeck):
    """Hands out true poses and samples, tick by tick.

    The robot drives some ticks ahead, at most as far as in lockstep: the tick at which it drives off lies
    beyond that and is known in time. Many ticks at once cost half of what they cost one by one.
    """

    def __init__(self, scenario: Scenario, seed: int, grid: TickGrid) -> None:
        self.bad = 0
        self._go_tick = NO_GO
        self._grid = grid
        self._motion = TargetMotion(scenario, seed, grid)
        self._driving = self._motion.drives_at_once
        self._samples: list[WorldSample] = []
        self._ahead = deque([self._show()])
        self._taken = -1

    def has(self, tick: int) -> bool:
        """Always."""
        del tick
        return True

    def take(self, tick: int) -> DeckState | None:
        """Go on to this tick; true pose there."""
        if tick > self._taken + len(self._ahead):
            self._drive(tick + RUN_AHEAD_TICKS - 1)
        deck, samples = self._ahead.popleft()
        self._taken = tick
        if samples:
            self._samples += samples
        return deck

    def ahead(self, tick: int) -> Sequence[Ahead]:
        """What the robot says at this tick, the next one, and at those after it as far as it has driven."""
        if not self._ahead:
            self._drive(tick + RUN_AHEAD_TICKS - 1)
        return self._ahead

    def drop(self, count: int) -> DeckState:
        """Leave out so many ticks, which somebody else has flown; true pose at the last of them."""
        for _ in range(count):
            deck = self._ahead.popleft().deck
        self._taken += count
        return deck

    def _drive(self, until_tick: int) -> None:
        motion = self._motion
        while motion.tick < until_tick:
            if NO_GO < self._go_tick <= motion.tick + 1:
                motion.faults.landing_began(self._grid.ns(self._go_tick))
                self._driving = True
            motion.step(self._driving)
            self._ahead.append(self._show())

    def _show(self) -> Ahead:
        model = self._motion.model
        position, yaw = model.pose
        yaw, velocity = _deck_twist(yaw, *model.velocity_body_m_s)
        due, self._motion.due = self._motion.due, []
        deck = DeckState(position, yaw, velocity, model.yaw_rate_rad_s, b"")
        return Ahead(deck, [in_world(sample) for sample in due])

    def samples(self, now_s: float) -> Arrived:
        """Odometry released since the last call."""
        if not self._samples:
            return NOTHING
        due, self._samples = self._samples, []
        return Arrived(tuple([TargetSample(now_s, *sample) for sample in due]))

    def landing_began(self, tick: int) -> None:
        """Drive off after the last tick that may have been computed already."""
        self._go_tick = tick + RUN_AHEAD_TICKS + 1


def in_world(sample: TargetMeasurement) -> WorldSample:
    """Equal to ``bridge.target.odometry.sample_from_cdr`` of the encoded sample, which a test holds."""
    time_s, position, yaw, velocity, rate = sample
    yaw, velocity, rate = _sample_twist(yaw, *velocity, rate)
    source_time_s = (EPOCH_NS + round(time_s * 1e9)) / 1e9
    return source_time_s, "map", "target", position, velocity, yaw, rate
