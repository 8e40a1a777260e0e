"""Computes the pose of one frame in another from single transforms, as on ROS 2's ``/tf``.

Each new transform of the tracked frame gives a pose at its stamp; if the frame is fixed to another frame
(``/tf_static``), each new transform of that frame does. The newest transforms of the frames above are used.
They must be fixed, or at most ``EDGE_AGE_MAX_S`` older: after a failure of the localisation the wheel
odometry must not be used alone.
"""

from __future__ import annotations

from collections.abc import Iterable

from bridge.frames import Quat, world_from_body
from bridge.ros2.cdr import Pose, Transform

EDGE_AGE_MAX_S = 1.0  # s; AMCL sends map -> odom at the rate of the laser, 5 Hz on a TurtleBot3
FRAMES_MAX = 256  # further frames are ignored
DEPTH_MAX = 16  # greatest number of edges from the tracked frame to the world frame


class TransformChain:
    """Tracks the pose of the frame ``child_frame_id`` in ``frame_id``."""

    def __init__(self, frame_id: str, child_frame_id: str) -> None:
        self._frame, self._child = frame_id, child_frame_id
        self._edges: dict[str, Pose] = {}  # pose in the parent frame, by child frame
        self._fixed: dict[str, Pose] = {}  # fixed pose in the parent frame, from ``/tf_static``
        self.problem = f"no transform of {child_frame_id!r} yet"  # reason why there is no pose, or ""

    def take_fixed(self, transforms: Iterable[Transform]) -> None:
        for transform in transforms:
            child, edge = _without_slash(transform)
            _keep(self._fixed, child, edge, child == self._child)

    def take(self, transforms: Iterable[Transform]) -> list[Pose]:
        """Use the transforms of one message; return the new poses, oldest first."""
        taken = [_without_slash(transform) for transform in transforms]
        for child, edge in taken:
            _keep(self._edges, child, edge, child == self._child)
        carrier, place = self._carrier()
        poses: list[Pose] = []
        for child, edge in taken:
            if child == carrier:
                there = edge if place is None else _compose(edge, place._replace(stamp_ns=edge.stamp_ns))
                pose = self._climb(there)
                if pose is not None:
                    poses.append(pose)
        if not poses and carrier not in self._edges:
            self.problem = f"no transform of {carrier!r} yet"
            if carrier != self._child:
                self.problem += f", to which {self._child!r} is fixed"
        return poses

    def _carrier(self) -> tuple[str, Pose | None]:
        """Return the nearest frame above (or itself) that is not fixed to another, and the pose in it."""
        frame, place = self._child, None
        for _ in range(DEPTH_MAX):
            fixed = self._fixed.get(frame)
            if fixed is None or frame in self._edges:
                break
            frame, place = fixed.frame_id, fixed if place is None else _compose(fixed, place)
        return frame, place

    def _climb(self, pose: Pose) -> Pose | None:
        for _ in range(DEPTH_MAX):
            if pose.frame_id == self._frame:
                self.problem = ""
                return pose
            above = self._edges.get(pose.frame_id)
            if above is None:
                fixed = self._fixed.get(pose.frame_id)
                if fixed is not None:
                    pose = _compose(fixed, pose)
                    continue
                self.problem = (
                    f"{self._child!r} is known in {pose.frame_id!r}, but there is no transform from that to "
                    f"{self._frame!r}"
                )
                return None
            age_s = (pose.stamp_ns - above.stamp_ns) / 1e9
            if age_s > EDGE_AGE_MAX_S:
                self.problem = (
                    f"the transform of {pose.frame_id!r} in {above.frame_id!r} is {age_s:.1f} s older than "
                    f"that of {self._child!r}: at most {EDGE_AGE_MAX_S:g} s are allowed"
                )
                return None
            pose = _compose(above, pose)
        self.problem = f"{self._child!r} is more than {DEPTH_MAX} transforms below, or they form a circle"
        return None


def _without_slash(transform: Transform) -> tuple[str, Pose]:
    """Return the transform's frame name without the leading slash of ROS 1's tf, and its pose."""
    pose = transform.pose
    return transform.child_frame_id.removeprefix("/"), pose._replace(frame_id=pose.frame_id.removeprefix("/"))


def _keep(edges: dict[str, Pose], child: str, edge: Pose, always: bool) -> None:
    if always or child in edges or len(edges) < FRAMES_MAX:
        edges[child] = edge


def _compose(above: Pose, pose: Pose) -> Pose:
    """Return a pose in the parent frame of ``above``, with the stamp of ``pose``."""
    x, y, z = world_from_body(above.orientation_wxyz, pose.position_m)
    ax, ay, az = above.position_m
    return Pose(
        pose.stamp_ns,
        above.frame_id,
        (ax + x, ay + y, az + z),
        _product(above.orientation_wxyz, pose.orientation_wxyz),
    )


def _product(a: Quat, b: Quat) -> Quat:
    """Return the rotation ``b`` followed by ``a`` (Hamilton product)."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
