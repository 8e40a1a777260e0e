"""The ground robot beside its vehicle: true poses for the deck, samples for a controller in this process.

The true poses of a robot in another process arrive over Zenoh and move the deck.

Values equal those received over Zenoh: CDR carries doubles, so only the frame rotations are computed.
"""

from __future__ import annotations

import contextlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import NamedTuple, cast

import numpy as np

from bridge import frames
from bridge.frames import Quat, world_from_body, yaw_from_quaternion
from bridge.ros2.cdr import OdometryError, decode_odometry
from bridge.zenoh import zenoh_link
from flightstack.common.pacing import EPOCH_NS, NO_GO, RUN_AHEAD_TICKS
from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, I64
from flightstack.core.types import ZERO, TargetSample, Vec3
from flightstack.onboard.runner import NOTHING, Arrived
from sim.clock import TickGrid
from sim.plant.states import Truth
from sim.robot.target_motion import TargetMotion
from sim.scenarios.scenario import Scenario

DRIVES_TICKS = 64  # maximum number of computed future ticks; on average half of them are unused at the end
WorldSample = tuple[float, str, str, Vec3, Vec3, float, float]  # a target sample without its arrival time

STALE_S = 0.5  # age of the newest true pose after which the deck stops, s
_PULL_1_S = 5.0  # correcting velocity divided by position error, 1/s; a jump would throw the vehicle off
_SNAP_M = 0.3  # position error above which the deck jumps, m; timing cannot cause a larger error


class DeckState(NamedTuple):
    """Pose and velocity of the pad centre, ENU, and the message that contained them."""

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
    """A deck that follows received true poses: dead reckoning with the last twist, and smooth correction."""

    def __init__(self, session: zenoh_link.Session, namespace: str) -> None:
        self._subscriber = zenoh_link.ring_subscriber(session, truth_key(namespace))
        self._last: DeckState | None = None
        self._last_s = 0.0
        self._stopped = False  # whether the deck stopped for lack of poses, and its warning was sent

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
    # The chord is turned by half the turn of the velocity; it is almost as long as the arc.
    c, s = math.cos(0.5 * turn), math.sin(0.5 * turn)
    there = (x + (c * vx - s * vy) * age_s, y + (s * vx + c * vy) * age_s, z + vz * age_s)
    c, s = math.cos(turn), math.sin(turn)
    velocity = (c * vx - s * vy, s * vx + c * vy, vz)
    return DeckState(there, last.yaw_rad + turn, velocity, last.yaw_rate_rad_s, last.payload)


def truth_key(namespace: str) -> str:
    """Return the Zenoh key of the robot's true pose."""
    return f"{namespace}/sim/target/truth"


# compiled forms of the frame formulas of sender and receiver
_quaternion = cast("Callable[[float], Quat]", jitted(frames.quaternion_from_yaw))
_yaw = cast("Callable[[Quat], float]", jitted(frames.yaw_from_quaternion))
_turn = cast("Callable[[Quat, Vec3], Vec3]", jitted(frames.world_from_body))


@jitted
def _turn_samples(samples: F64, rows: F64) -> None:
    """Compute heading, velocity and turn rate as the receiver decodes them, with normalised quaternions."""
    for n in range(len(samples)):
        sample, row = samples[n], rows[n]
        w, x, y, z = _quaternion(sample[4])
        scale = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
        q = (w * scale, x * scale, y * scale, z * scale)
        velocity = _turn(q, (sample[5], sample[6], sample[7]))
        for i in range(3):
            row[1 + i], row[4 + i] = sample[1 + i], velocity[i]
        row[7], row[8] = _yaw(q), _turn(q, (0.0, 0.0, sample[8]))[2]


@jitted
def _decks(pads: F64, decks: F64) -> None:
    """Compute true poses as the receiver decodes them, one in each row."""
    for n in range(len(pads)):
        pad, deck, q = pads[n], decks[n], _quaternion(pads[n, 4])
        velocity = _turn(q, (pad[5], pad[6], pad[7]))
        for i in range(3):
            deck[i], deck[4 + i] = pad[1 + i], velocity[i]
        deck[3], deck[7] = _yaw(q), pad[11]


def deck_rows(pads: F64) -> F64:
    """Return position, heading, velocity and turn rate of the pad, (n, 8), from its motion, (n, 12)."""
    decks = np.empty((len(pads), 8))
    _decks(pads, decks)
    return decks


class Robot(ABC):
    """A robot that drives tick by tick or computes future ticks; it may wait for the start of the landing.

    The number of future ticks is limited, so that the start of driving is known in time. A tick in a batch
    takes a fifth of the time of a single tick.
    """

    def __init__(self, scenario: Scenario, seed: int, grid: TickGrid) -> None:
        self._go_tick = NO_GO  # tick from which the robot drives
        self._grid = grid
        self._motion = motion = TargetMotion(scenario, seed, grid)
        self._driving = motion.drives_at_once

    def begin(self) -> None:  # noqa: B027
        """Wait for the conditions of tick 0. Raises NoAnswerError: time-out."""

    def _keep_first(self) -> None:
        """Store the motion of tick 0."""
        self._keep(*self._motion.first)

    @property
    def waits(self) -> bool:
        """Whether the start of the landing can still change its path or its faults."""
        return not self._driving or self._motion.faults.waits_for_landing

    def _drive(self, until_tick: int) -> None:
        """Compute the motion of the robot, driving or at rest, up to a tick."""
        motion = self._motion
        while motion.tick < until_tick:
            end, goes_at = until_tick, self._go_tick
            if NO_GO < goes_at <= motion.tick + 1:
                motion.faults.landing_began(self._grid.ns(goes_at))
                if not self._driving:
                    self._driving = True
                    self._drives_off(motion.tick + 1)
            elif goes_at > NO_GO:
                end = min(end, goes_at - 1)  # faults with times relative to the landing start at that tick
            self._keep(*motion.run(end - motion.tick, self._driving))

    @abstractmethod
    def _keep(self, pads: F64, due: Sequence[int], new: F64) -> None:
        """Store the motion of the next n ticks (``TargetMotion.run``)."""

    def await_credit(self, tick: int) -> None:  # noqa: B027
        """Wait until the companion permits to compute this tick, if the robot depends on the companion."""

    @abstractmethod
    def take(self, tick: int) -> DeckState:
        """Advance to the next tick; return the true pose there."""

    def run_ahead(self, tick: int) -> None:  # noqa: B027
        """Compute future ticks while the companion computes, if that saves time."""

    def _drives_off(self, tick: int) -> None:  # noqa: B027
        """Called with the tick from which the robot drives."""


class Ahead(NamedTuple):
    """Pad states and odometry samples of the robot at the next n ticks."""

    decks: F64  # (n, 8) position, heading, velocity and turn rate of the pad
    samples: F64  # (m, 9) time, position, velocity, heading and turn rate of the target
    come_before: int  # number of samples before the first tick
    come: I64  # (n,) number of samples up to each tick


class DirectTarget(Robot):
    """A robot that returns its true poses and samples directly, tick by tick."""

    def __init__(self, scenario: Scenario, seed: int, grid: TickGrid) -> None:
        self._samples: list[WorldSample] = []  # samples that the onboard process has not read yet
        # data of the computed ticks, and number of those ticks already returned
        self._ahead, self._at = Ahead(np.empty((0, 8)), np.empty((0, 9)), 0, np.empty(0, np.int64)), 0
        # rows of ``Ahead.decks`` (pad motion) as lists; a list is read faster than an array row
        self._decks: list[list[float]] = []
        self._come: list[int] = []
        super().__init__(scenario, seed, grid)
        self._keep_first()

    def take(self, tick: int) -> DeckState:
        """Advance to this tick; return the true pose there."""
        if self._at == len(self._come):
            self._drive(tick + self._ahead_ticks - 1)
        first, end = self._come_before, self._come[self._at]
        if first != end:
            self._samples += [world_sample(row) for row in self._ahead.samples[first:end].tolist()]
        self._at += 1
        x, y, z, yaw, vx, vy, vz, rate = self._decks[self._at - 1]
        return DeckState((x, y, z), yaw, (vx, vy, vz), rate, b"")

    def ahead(self, tick: int, count: int) -> Ahead:
        """Return states and samples of the robot for up to ``count`` ticks, beginning at ``tick``."""
        if len(self._come) - self._at < count:
            self._drive(tick + self._ahead_ticks - 1)
        these, (decks, samples, _, come) = slice(self._at, self._at + count), self._ahead
        return Ahead(decks[these], samples, self._come_before, come[these])

    def skip(self, count: int) -> None:
        """Skip ticks that were flown as a batch."""
        self._at += count

    @property
    def _ahead_ticks(self) -> int:
        """Number of future ticks to compute; larger once no later input can change the path."""
        return RUN_AHEAD_TICKS if self.waits else DRIVES_TICKS

    @property
    def _come_before(self) -> int:
        """Number of samples up to the last returned tick."""
        return self._come[self._at - 1] if self._at else 0

    def _keep(self, pads: F64, due: Sequence[int], new: F64) -> None:
        """Append states and samples of new ticks; drop those already returned."""
        decks = deck_rows(pads)
        before, left = self._come_before, self._ahead
        samples = left.samples[before:]
        come = len(samples) + np.searchsorted(due, np.arange(len(pads)), side="right")
        if due:
            samples = np.concatenate((samples, sample_rows(new)))
        if self._at < len(self._come):
            decks = np.concatenate((left.decks[self._at :], decks))
            come = np.concatenate((left.come[self._at :] - before, come))
        self._at, self._ahead = 0, Ahead(decks, samples, 0, come)
        self._decks, self._come = decks.tolist(), come.tolist()

    def samples(self, now_s: float) -> Arrived:
        """Return the odometry released since the last call."""
        if not self._samples:
            return NOTHING
        due, self._samples = self._samples, []
        return Arrived(tuple([TargetSample(now_s, *sample) for sample in due]))

    def landing_began(self, tick: int) -> None:
        """Start to drive after the last tick that may already have been computed."""
        self._go_tick = tick + RUN_AHEAD_TICKS + 1


def sample_rows(samples: F64) -> F64:
    """Return the values of samples, (m, 9), as ``bridge.target.odometry.sample_of`` decodes them."""
    rows = np.empty_like(samples)
    rows[:, 0] = (EPOCH_NS + np.rint(samples[:, 0] * 1e9).astype(np.int64)) / 1e9
    _turn_samples(samples, rows)
    return rows


def world_sample(row: Sequence[float]) -> WorldSample:
    """Return the sample with these nine values."""
    source_time_s, x, y, z, vx, vy, vz, yaw, rate = row
    return source_time_s, "map", "target", (x, y, z), (vx, vy, vz), yaw, rate
