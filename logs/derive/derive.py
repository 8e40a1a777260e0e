"""Standard ROS messages made from controller steps, so that any viewer shows the flight in 3-D.

They hold nothing that the steps and the run's metadata do not hold. What is made, and when, depends on the
log time of the steps alone: two runs with equal steps give equal messages. Frames: ``map`` is the ENU world,
``map_ned`` the same place in NED axes, ``<ns>/base_link`` the vehicle (heading only), ``target`` the pad with
its heading, ``target_pad`` the pad without heading, in which the barrier stands still.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from types import MappingProxyType

from logs.derive.diagnostics import Health
from logs.derive.markers import Scene
from logs.schema.codec import CDR_HEADER, ControllerStepRow, Vec3, unpack_controller_step
from logs.schema.codec_log import pack_string
from logs.schema.schemas import MARKER_ARRAY, ODOMETRY, POSE_STAMPED, STRING, TF_MESSAGE, TWIST_STAMPED

PERIOD_NS = 20_000_000  # 50 Hz: as fast as a screen shows it
MARKER_PERIOD_NS = 200_000_000  # 5 Hz: pictures are large
STATIC_PERIOD_NS = 5_000_000_000  # repeated, so that a viewer that jumps into the log finds it
STEP_SUFFIX = "/controller/step"

Derived = tuple[str, str, bytes]  # topic, schema, CDR

_NS = 1_000_000_000
_POSE = struct.Struct("<4siII4s7d")
_TWIST = struct.Struct("<4siII4s6d")
_NO_ROTATION = (0.0, 0.0, 0.0, 1.0)
# The NED axes seen from ENU: half a turn about the horizontal line between east and north.
_NED_IN_ENU = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)
_ORIGIN = (0.0, 0.0, 0.0)


class Deriver:
    """Makes the viewers' messages of one vehicle."""

    def __init__(self, step_topic: str, health: Health | None = None) -> None:
        """Take the name space from the topic of the steps, for example ``/cf1/controller/step``.

        Args:
            step_topic: Topic of the steps.
            health: Is shown every step.
        """
        space = step_topic.removesuffix(STEP_SUFFIX)
        self._base = f"{space.strip('/')}/base_link".lstrip("/")
        self._pose = space + "/pose"
        self._odom = space + "/odom"
        self._target_pose = space + "/target/pose"
        self._nominal = space + "/cmd/velocity_nominal"
        self._filtered = space + "/cmd/velocity_filtered"
        self._command = space + "/cmd/velocity"
        self._markers = space + "/cbf/markers"
        self._run_topic, self._run_text = space + "/run", b""
        self._health = health
        self._own_tf = _TransformLayout((self._base,))
        self._target_tf = _TransformLayout(("target", "target_pad"))
        self._both_tf = _TransformLayout((self._base, "target", "target_pad"))
        self._static_tf = _TransformLayout(("map_ned",))
        self._odometry = _OdometryLayout(self._base)
        self._scene = Scene(self._base)
        self._slots: dict[int, int] = {}

    def configure(self, run: Mapping[str, str], shape: Mapping[str, str] = MappingProxyType({})) -> None:
        """Take barrier and pad from the metadata of the run, and its text to show.

        Args:
            run: metadata of the run; empty for a real flight.
            shape: barrier and pad where the run does not name them (``flight_config.shape``).

        Raises:
            ValueError: A shape that is not a number.
        """
        self._scene.configure({**shape, **run})
        self._run_text = pack_string("\n".join(f"{key} = {value}" for key, value in run.items()))

    def step(self, log_time_ns: int, payload: bytes) -> list[Derived]:
        """Return what one controller step shows; empty between the periods.

        Raises:
            ValueError: The payload is not a controller step.
        """
        due = self._due(PERIOD_NS, log_time_ns)
        if not due and self._health is None:
            return []
        row = unpack_controller_step(payload)
        if self._health is not None:
            self._health.step(row)
        if not due:
            return []
        stamp = divmod(row.stamp_ns, _NS)
        made: list[Derived] = []
        if self._due(STATIC_PERIOD_NS, log_time_ns):
            made.append(("/tf_static", TF_MESSAGE, self._static_tf.pack(stamp, (_ORIGIN + _NED_IN_ENU,))))
            if self._run_text:
                made.append((self._run_topic, STRING, self._run_text))
        own = row.own_position_enu_m + _heading(row.own_yaw_rad)
        target = row.target_position_enu_m + _heading(row.target_yaw_rad)
        pad = row.target_position_enu_m + _NO_ROTATION
        if row.own_valid and row.target_valid:
            made.append(("/tf", TF_MESSAGE, self._both_tf.pack(stamp, (own, target, pad))))
        elif row.own_valid:
            made.append(("/tf", TF_MESSAGE, self._own_tf.pack(stamp, (own,))))
        elif row.target_valid:
            made.append(("/tf", TF_MESSAGE, self._target_tf.pack(stamp, (target, pad))))
        if row.own_valid:
            made.append((self._pose, POSE_STAMPED, _POSE.pack(CDR_HEADER, *stamp, 4, b"map\x00", *own)))
            made.append((self._odom, ODOMETRY, self._odometry.pack(stamp, own, _body_velocity(row))))
        if row.target_valid:
            pose = _POSE.pack(CDR_HEADER, *stamp, 4, b"map\x00", *target)
            made.append((self._target_pose, POSE_STAMPED, pose))
        made.append((self._nominal, TWIST_STAMPED, _twist(stamp, row.nominal_enu_m_s)))
        made.append((self._filtered, TWIST_STAMPED, _twist(stamp, row.filtered_enu_m_s)))
        if row.setpoint_sent:
            made.append((self._command, TWIST_STAMPED, _twist(stamp, row.command_enu_m_s)))
        self._scene.add(log_time_ns, row)
        if self._due(MARKER_PERIOD_NS, log_time_ns):
            made.append((self._markers, MARKER_ARRAY, self._scene.pack(row)))
        return made

    def _due(self, period_ns: int, log_time_ns: int) -> bool:
        slot = log_time_ns // period_ns
        if self._slots.get(period_ns) == slot:
            return False
        self._slots[period_ns] = slot
        return True


class _TransformLayout:
    """A TFMessage of fixed children of ``map``."""

    def __init__(self, children: tuple[str, ...]) -> None:
        layout, at = "<4sI", 4
        self._names: list[tuple[int, bytes, int, bytes]] = []
        for child in children:
            name = child.encode() + b"\x00"
            at += 16 + 4 + len(name)  # stamp and "map", length and name; all begin aligned to 4
            padding = -at & 7
            layout += f"iII4sI{len(name)}s{padding}x7d"
            at += padding + 56
            self._names.append((4, b"map\x00", len(name), name))
        self._struct = struct.Struct(layout)

    def pack(self, stamp: tuple[int, int], poses: tuple[tuple[float, ...], ...]) -> bytes:
        """Return the message; ``poses`` are (x, y, z, qx, qy, qz, qw) in the order of the children."""
        values: list[object] = [CDR_HEADER, len(poses)]
        for names, pose in zip(self._names, poses, strict=True):
            values += stamp
            values += names
            values += pose
        return self._struct.pack(*values)


class _OdometryLayout:
    """A nav_msgs/Odometry in ``map`` with unknown (zero) covariances."""

    def __init__(self, child: str) -> None:
        self._name = child.encode() + b"\x00"
        padding = -(16 + 4 + len(self._name)) & 7
        self._struct = struct.Struct(f"<4siII4sI{len(self._name)}s{padding}x7d288x6d288x")

    def pack(self, stamp: tuple[int, int], pose: tuple[float, ...], velocity_flu_m_s: Vec3) -> bytes:
        """Return the message; the turn rates are not part of a controller step and stay zero."""
        name = self._name
        return self._struct.pack(
            CDR_HEADER, *stamp, 4, b"map\x00", len(name), name, *pose, *velocity_flu_m_s, 0.0, 0.0, 0.0
        )


def _heading(yaw_rad: float) -> tuple[float, float, float, float]:
    return (0.0, 0.0, math.sin(0.5 * yaw_rad), math.cos(0.5 * yaw_rad))


def _body_velocity(row: ControllerStepRow) -> Vec3:
    """World velocity in the heading frame of the vehicle: ROS gives twists in the child's frame."""
    x, y, z = row.own_velocity_enu_m_s
    cos_yaw, sin_yaw = math.cos(row.own_yaw_rad), math.sin(row.own_yaw_rad)
    return (cos_yaw * x + sin_yaw * y, cos_yaw * y - sin_yaw * x, z)


def _twist(stamp: tuple[int, int], velocity_enu_m_s: Vec3) -> bytes:
    return _TWIST.pack(CDR_HEADER, *stamp, 4, b"map\x00", *velocity_enu_m_s, 0.0, 0.0, 0.0)
