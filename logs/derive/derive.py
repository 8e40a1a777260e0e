"""Standard ROS messages made from controller steps, so that any viewer shows the flight in 3-D.

They hold nothing that the steps and the run's metadata do not hold. What is made, and when, depends on the
log time of the steps alone: two runs with equal steps give equal messages. Frames: ``map`` is the ENU world,
``map_ned`` the same place in NED axes, ``<ns>/base_link`` the vehicle (heading only), ``target`` the pad with
its heading, ``target_pad`` the pad without heading, in which the barrier stands still.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from bridge.ros2.cdr import NO_COVARIANCE
from flightstack.core.types import ZERO, Vec3
from logs.derive.diagnostics import Health
from logs.derive.markers import Scene
from logs.schema.cdr import packer
from logs.schema.events import pack_string
from logs.schema.rows import ControllerStepRow
from logs.schema.schemas import MARKER_ARRAY, ODOMETRY, POSE_STAMPED, STRING, TF_MESSAGE, TWIST_STAMPED

PERIOD_NS = 20_000_000  # 50 Hz: as fast as a screen shows it
MARKER_PERIOD_NS = 200_000_000  # 5 Hz: pictures are large
STATIC_PERIOD_NS = 5_000_000_000  # repeated, so that a viewer that jumps into the log finds it
STEP_SUFFIX = "/controller/step"

Derived = tuple[str, str, bytes]  # topic, schema, CDR
Vec4 = tuple[float, float, float, float]

_NO_ROTATION = (0.0, 0.0, 0.0, 1.0)
# The NED axes seen from ENU: half a turn about the horizontal line between east and north.
_NED_IN_ENU = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)


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
        # made here, since the first of a type takes milliseconds
        self._pack_tf, self._pack_odometry = packer(TF_MESSAGE), packer(ODOMETRY)
        self._pack_pose, self._pack_twist = packer(POSE_STAMPED), packer(TWIST_STAMPED)
        self._scene = Scene(self._base)
        self._slots: dict[int, int] = {}

    def configure(self, run: Mapping[str, str], shape: Mapping[str, str] = MappingProxyType({})) -> None:
        """Take barrier and pad from the metadata of the run, and its text to show.

        Args:
            run: metadata of the run; empty for a real flight.
            shape: barrier and pad where the run does not name them (``flight_data.shape``).

        Raises:
            ValueError: A shape that is not a number.
        """
        self._scene.configure({**shape, **run})
        self._run_text = pack_string("\n".join(f"{key} = {value}" for key, value in run.items()))

    def step(self, log_time_ns: int, row: ControllerStepRow) -> list[Derived]:
        """Return what one controller step shows; empty between the periods."""
        if self._health is not None:
            self._health.step(row)
        if not self._due(PERIOD_NS, log_time_ns):
            return []
        stamp_ns = row.stamp_ns
        made: list[Derived] = []
        if self._due(STATIC_PERIOD_NS, log_time_ns):
            made.append(
                ("/tf_static", TF_MESSAGE, self._transforms(stamp_ns, [("map_ned", ZERO, _NED_IN_ENU)]))
            )
            if self._run_text:
                made.append((self._run_topic, STRING, self._run_text))
        own = row.own_position_enu_m, _heading(row.own_yaw_rad)
        target = row.target_position_enu_m, _heading(row.target_yaw_rad)
        shown = [(self._base, *own)] if row.own_valid else []
        if row.target_valid:
            shown += [("target", *target), ("target_pad", row.target_position_enu_m, _NO_ROTATION)]
        if shown:
            made.append(("/tf", TF_MESSAGE, self._transforms(stamp_ns, shown)))
        if row.own_valid:
            made.append((self._pose, POSE_STAMPED, self._pack_pose((stamp_ns, own))))
            # The turn rates are not part of a controller step.
            twist = (_body_velocity(row), ZERO)
            odometry = (stamp_ns, self._base, (own, NO_COVARIANCE), (twist, NO_COVARIANCE))
            made.append((self._odom, ODOMETRY, self._pack_odometry(odometry)))
        if row.target_valid:
            made.append((self._target_pose, POSE_STAMPED, self._pack_pose((stamp_ns, target))))
        velocities = [(self._nominal, row.nominal_enu_m_s), (self._filtered, row.filtered_enu_m_s)]
        if row.setpoint_sent:
            velocities.append((self._command, row.command_enu_m_s))
        for topic, velocity_enu_m_s in velocities:
            twist = (velocity_enu_m_s, ZERO)
            made.append((topic, TWIST_STAMPED, self._pack_twist((stamp_ns, twist))))
        self._scene.add(log_time_ns, row)
        if self._due(MARKER_PERIOD_NS, log_time_ns):
            made.append((self._markers, MARKER_ARRAY, self._scene.pack(row)))
        return made

    def _transforms(self, stamp_ns: int, children: Sequence[tuple[str, Vec3, Vec4]]) -> bytes:
        """Transforms of children of ``map``: name, position, orientation x, y, z, w."""
        return self._pack_tf(([(stamp_ns, name, (position_m, turn)) for name, position_m, turn in children],))

    def _due(self, period_ns: int, log_time_ns: int) -> bool:
        slot = log_time_ns // period_ns
        if self._slots.get(period_ns) == slot:
            return False
        self._slots[period_ns] = slot
        return True


def _heading(yaw_rad: float) -> tuple[float, float, float, float]:
    return (0.0, 0.0, math.sin(0.5 * yaw_rad), math.cos(0.5 * yaw_rad))


def _body_velocity(row: ControllerStepRow) -> Vec3:
    """World velocity in the heading frame of the vehicle: ROS gives twists in the child's frame."""
    x, y, z = row.own_velocity_enu_m_s
    cos_yaw, sin_yaw = math.cos(row.own_yaw_rad), math.sin(row.own_yaw_rad)
    return (cos_yaw * x + sin_yaw * y, cos_yaw * y - sin_yaw * x, z)
