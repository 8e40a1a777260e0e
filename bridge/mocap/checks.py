"""Checks the order, age, rate and jumps of motion capture poses; options of the bridges that receive poses.

The Crazyflie's estimator does not reject outliers (firmware mm_pose.c): one pair of swapped markers makes the
vehicle flip. So a pose is forwarded only if the vehicle can have moved to this pose from the last good pose.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, NamedTuple

from bridge.frames import Quat
from bridge.ros2.cdr import Pose
from flightstack.common.options import Option
from flightstack.config import options as shared
from flightstack.core.sender_clock import PATIENCE_S, Reading, SenderClock


class Refusal(Enum):
    """Reason to reject a pose; the value is the text for the operator."""

    UNREADABLE = "not a geometry_msgs/msg/PoseStamped"
    FRAME = "in another frame: --frame must name the vehicle's east-north-up frame"
    STAMP = "stamped outside of the years 1970 to 2106"
    ORDER = "not newer than the one before: are there two senders?"
    AHEAD = "a time stamp from the future: are there two senders?"
    LATE = "delayed: is the network or the mocap computer too slow?"
    ROOM = "outside the room: too far from its origin"
    JUMP = "a jump no vehicle can make: markers swapped, or another body?"


@dataclass(frozen=True, slots=True)
class Limits:
    frame_id: str | None = None  # required frame of the poses; None: any frame is accepted
    late_max_s: float = 0.1  # maximum delay relative to the fastest recent sample, s
    # time for which poses must agree on a changed clock of their sender before a pose is used, s
    clock_proof_s: float = 0.3
    gap_max_s: float = 0.2  # age of the last good pose above which a problem is reported, s
    rate_min_hz: float = 20.0  # rate of the poses below which a warning is sent, Hz; PX4 needs 30 to 50 Hz
    rate_max_hz: float = 100.0  # maximum rate of forwarded poses, Hz
    speed_max_m_s: float = 5.0  # maximum speed of the body, m/s
    jump_m: float = 0.05  # allowance for noise, which is added to the allowed distance, m
    turn_rate_max_rad_s: float = 20.0  # maximum rotation rate of the body, rad/s
    turn_rad: float = 0.2  # allowance for noise, which is added to the allowed angle, rad
    room_m: float = 100.0  # half side of the room, m; the Crazyflie's estimator resets beyond 100 m
    gap_counted_s: float = 1.0  # maximum time between poses that counts for the possible motion, s
    return_m: float = 0.5  # maximum distance from the last good pose after rejected poses, m
    settle_s: float = 1.0  # time at a new place after which this place is accepted, s; only if disarmed


class Passed(NamedTuple):
    pose: Pose
    measured_s: float  # time of measurement on the local clock, s: arrival minus delay
    resets: int  # number of restarts of the series of poses


_RATE_WINDOW_S = 1.0
_REFUSALS = {
    Reading.UNUSABLE: Refusal.STAMP,
    Reading.REPEATED: Refusal.ORDER,
    Reading.OUT_OF_ORDER: Refusal.ORDER,
    Reading.AHEAD: Refusal.AHEAD,
    Reading.LATE: Refusal.LATE,
}


class PoseChecks:
    """Checks the poses of one body; the loop calls ``step`` in every iteration."""

    def __init__(self, limits: Limits = Limits()) -> None:
        self.limits = limits
        self.counts = Counter[Refusal]()  # rejected poses by reason
        self.thinned = self.passed = 0  # number of poses omitted to limit the rate; number of forwarded poses
        self._clock = SenderClock(limits.late_max_s, limits.clock_proof_s)
        self._last: Passed | None = None
        self._sent_s = -math.inf
        self._resets = 0
        self._elsewhere: Passed | None = None  # newest pose of the series that follows a jump
        self._elsewhere_since_s = 0.0
        self._refused: Refusal | None = None  # reason why the newest pose was rejected; None: a good pose
        self._window_s, self._in_window = -math.inf, 0
        self._rate_hz: float | None = None

    def step(self, poses: Sequence[Pose | None], now_s: float, *, armed: bool) -> tuple[Passed, ...]:
        """Return the good poses among ``poses``, oldest first; a pose None is an unreadable message.

        No jump is accepted if the vehicle is armed.
        """
        good, kept = 0, list[Passed]()
        for pose in poses:
            found = self._judged(pose, now_s, armed)
            if isinstance(found, Refusal):
                self.counts[found] += 1
                self._refused = found
                continue
            good += 1
            self._last, self._elsewhere, self._refused = found, None, None
            if found.measured_s - self._sent_s >= 0.75 / self.limits.rate_max_hz:  # 0.75 allows jitter
                self._sent_s = found.measured_s
                kept.append(found)
        self._count_rate(good, now_s)
        self.passed += len(kept)
        self.thinned += good - len(kept)
        return tuple(kept)

    def _judged(self, pose: Pose | None, now_s: float, armed: bool) -> Passed | Refusal:
        limits = self.limits
        if pose is None:
            return Refusal.UNREADABLE
        if limits.frame_id is not None and pose.frame_id != limits.frame_id:
            return Refusal.FRAME
        if max(map(abs, pose.position_m)) > limits.room_m:
            return Refusal.ROOM
        stamp_s = pose.stamp_ns / 1e9
        reading = self._clock.accept(stamp_s, now_s, math.inf if armed else PATIENCE_S)
        if not reading.good:
            return _REFUSALS[reading]
        passed = Passed(pose, now_s - self._clock.lateness_s(stamp_s, now_s), self._resets)
        last, before = self._last, self._elsewhere
        if last is None:
            return passed
        returns = before is None or _apart(last, passed) < _apart(before, passed)
        if returns and self._reaches(last, passed, math.inf if before is None else limits.return_m):
            return passed
        continues = before is not None and self._reaches(before, passed, math.inf)
        if armed or not continues:
            self._elsewhere_since_s = passed.measured_s
        self._elsewhere = passed
        if not continues or passed.measured_s - self._elsewhere_since_s < limits.settle_s:
            return Refusal.JUMP
        self._resets += 1  # the vehicle, disarmed and at one place for ``settle_s``, was carried there
        return passed._replace(resets=self._resets)

    def _reaches(self, before: Passed, after: Passed, most_m: float) -> bool:
        limits = self.limits
        dt_s = min(max(0.0, after.measured_s - before.measured_s), limits.gap_counted_s)
        moved_m = math.dist(before.pose.position_m, after.pose.position_m)
        turned_rad = angle_between(before.pose.orientation_wxyz, after.pose.orientation_wxyz)
        fits = moved_m <= min(limits.jump_m + limits.speed_max_m_s * dt_s, most_m)
        return fits and turned_rad <= limits.turn_rad + limits.turn_rate_max_rad_s * dt_s

    def _count_rate(self, count: int, now_s: float) -> None:
        self._in_window += count
        span_s = now_s - self._window_s
        if span_s >= _RATE_WINDOW_S:
            self._rate_hz = self._in_window / span_s if math.isfinite(span_s) else None
            self._window_s, self._in_window = now_s, 0

    def problem(self, now_s: float) -> str | None:
        """Return the reason why there is no good pose, or None."""
        if self._last is None:
            return f"mocap: no pose yet{self._because()}"
        age_s = now_s - self._last.measured_s
        if age_s > self.limits.gap_max_s:
            return f"mocap: no pose for {age_s:.1f} s{self._because()}"
        if self._rate_hz is not None and self._rate_hz < self.limits.rate_min_hz:
            return f"mocap: {self._rate_hz:.0f} Hz, {self.limits.rate_min_hz:g} Hz needed"
        return None

    def _because(self) -> str:
        return f"; the last was {self._refused.value}" if self._refused is not None else ""


def _apart(a: Passed, b: Passed) -> float:
    """Return the distance of two poses: distance in m plus angle in rad."""
    turned_rad = angle_between(a.pose.orientation_wxyz, b.pose.orientation_wxyz)
    return math.dist(a.pose.position_m, b.pose.position_m) + turned_rad


def angle_between(a: Quat, b: Quat) -> float:
    """Return the angle of the rotation from one unit quaternion to another, 0 to pi."""
    along = abs(sum(x * y for x, y in zip(a, b, strict=True)))
    across = math.sqrt(max(0.0, 1.0 - along * along))
    return 2.0 * math.atan2(across, along)


POSE_TYPES = ("pose", "pose-covariance")


@dataclass(frozen=True, kw_only=True)
class PoseOptions(shared.Zenoh, shared.Signing):
    """Options of a bridge: motion-capture poses, and MAVLink and Zenoh links."""

    pose_type: Annotated[
        str, Option("--pose-type", "PoseStamped or PoseWithCovarianceStamped.", choices=POSE_TYPES)
    ] = POSE_TYPES[0]
    frame_id: Annotated[str | None, Option("--frame", "Required frame of the poses.", "NAME")] = None
    offset_flu_m: Annotated[tuple[float, float, float], Option(
        "--offset", "Offset from the markers' centre to the vehicle's, m, forward left up.", "X Y Z"
    )] = (0.0, 0.0, 0.0)  # fmt: skip
    pose_speed_m_s: Annotated[float, Option(
        "--pose-speed-max", "Reject a pose beyond this speed as a jump.", "M/S", span=(0.1, 50.0)
    )] = 5.0  # fmt: skip
    ros_domain: shared.RosDomain = 0
    duration_s: shared.Duration = None


@dataclass(frozen=True, kw_only=True)
class MocapOptions(PoseOptions, shared.Vehicle):
    pose_key: Annotated[str, Option(
        "--key",
        "Source of the poses: a Zenoh key, ros2:/TOPIC (rmw_zenoh), ros2dds:/TOPIC (docs/how_to/mocap.md).",
        "KEY"
    )]  # fmt: skip
    origin: Annotated[tuple[float, float, float] | None, Option(
        "--origin",
        "Position on earth of the room's origin, degrees and m; ArduPilot needs one for its position.",
        "LAT LON ALT"
    )] = None  # fmt: skip
