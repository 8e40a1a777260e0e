"""The pose of one frame in another from transforms that come edge by edge, as on ROS 2's ``/tf``.

A pose is given out for each new transform of the tracked frame itself, at its stamp. The edges above it are
taken as they were last, and must not be older than ``EDGE_AGE_MAX_S`` against it: a localisation that died
must not go on steering by the wheels alone.
"""

from __future__ import annotations

from collections.abc import Iterable

from bridge.frames import Quat, world_from_body
from bridge.pose_cdr import Pose, Transform

EDGE_AGE_MAX_S = 1.0  # AMCL sends map -> odom at the rate of the laser, 5 Hz on a TurtleBot3
FRAMES_MAX = 256  # kept; further ones are ignored
DEPTH_MAX = 16  # edges from the tracked frame to the world's


class TransformChain:
    """Follows one frame.

    Args:
        frame_id: in which the pose is wanted.
        child_frame_id: whose pose it is.
    """

    def __init__(self, frame_id: str, child_frame_id: str) -> None:
        self._frame, self._child = frame_id, child_frame_id
        self._edges: dict[str, Pose] = {}  # child: its pose in its parent
        self.problem = f"no transform of {child_frame_id!r} yet"  # why there is no pose, "" when there is

    def take(self, transforms: Iterable[Transform]) -> list[Pose]:
        """Take the transforms of one message; returns the poses that they make known, oldest first."""
        poses: list[Pose] = []
        tracked: list[Pose] = []
        for transform in transforms:
            child = transform.child_frame_id.removeprefix("/")  # tf of ROS 1 began names with a slash
            edge = transform.pose._replace(frame_id=transform.pose.frame_id.removeprefix("/"))
            if child == self._child:
                tracked.append(edge)
            elif child in self._edges or len(self._edges) < FRAMES_MAX:
                self._edges[child] = edge
        for edge in tracked:
            pose = self._climb(edge)
            if pose is not None:
                poses.append(pose)
        return poses

    def _climb(self, edge: Pose) -> Pose | None:
        pose = edge
        for _ in range(DEPTH_MAX):
            if pose.frame_id == self._frame:
                self.problem = ""
                return pose
            above = self._edges.get(pose.frame_id)
            if above is None:
                self.problem = (
                    f"{self._child!r} is known in {pose.frame_id!r}, but nothing says where that is in "
                    f"{self._frame!r}"
                )
                return None
            age_s = (edge.stamp_ns - above.stamp_ns) / 1e9
            if age_s > EDGE_AGE_MAX_S:
                self.problem = (
                    f"the transform of {pose.frame_id!r} in {above.frame_id!r} is {age_s:.1f} s older than "
                    f"that of {self._child!r}: at most {EDGE_AGE_MAX_S:g} s are allowed"
                )
                return None
            pose = _compose(above, pose)
        self.problem = f"{self._child!r} is more than {DEPTH_MAX} transforms below, or they make a circle"
        return None


def _compose(above: Pose, pose: Pose) -> Pose:
    """A pose in the frame that ``above`` is given in; the stamp stays that of the lower one."""
    x, y, z = world_from_body(above.orientation_wxyz, pose.position_m)
    ax, ay, az = above.position_m
    return Pose(
        pose.stamp_ns,
        above.frame_id,
        (ax + x, ay + y, az + z),
        _product(above.orientation_wxyz, pose.orientation_wxyz),
    )


def _product(a: Quat, b: Quat) -> Quat:
    """First the turn ``b``, then ``a`` (Hamilton)."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
