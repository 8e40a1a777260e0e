"""Builds the MAVLink messages that carry poses, in the form that the vehicle's autopilot needs. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import (
    euler_from_quaternion,
    ned_covariance_from_enu,
    ned_frd_from_enu_flu,
    ned_from_enu,
    upper_triangle,
)
from bridge.mavlink.client.companion import Origin, OriginSender, companion_heartbeat
from bridge.mavlink.codec.messages import Message
from bridge.mocap.checks import Passed
from flightstack.core.types import Landed, Mode, VehicleStatus

COMPONENT_ID = dialect.MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY
RATE_MAX_HZ = 50.0  # maximum rate of poses for PX4 and ArduPilot, Hz
SILENT_S = 3.0  # time without a heartbeat after which the vehicle counts as absent, s
_HEARTBEAT_S = 1.0
_HELLO_S = 0.2  # time between heartbeats before the first message of the vehicle, s
_UNKNOWN = (math.nan, *([0.0] * 20))  # unknown covariance: its first entry is NaN (MAVLink)


def _covariance(covariance: tuple[float, ...]) -> list[float]:
    known = any(covariance)  # in ROS a covariance of zeros means unknown
    return list(upper_triangle(ned_covariance_from_enu(covariance)) if known else _UNKNOWN)


def vision_position_estimate(passed: Passed, time_us: int) -> Message:
    """Build VISION_POSITION_ESTIMATE: position in NED; roll, pitch and yaw of FRD in NED."""
    pose = passed.pose
    return dialect.MAVLink_vision_position_estimate_message(
        time_us,
        *ned_from_enu(pose.position_m),
        *euler_from_quaternion(ned_frd_from_enu_flu(pose.orientation_wxyz)),
        _covariance(pose.covariance),
        passed.resets % 256,
    )


def odometry(passed: Passed, time_us: int) -> Message:
    """Build ODOMETRY of type VISION: pose of FRD in NED as a quaternion; velocities are unknown."""
    pose = passed.pose
    return dialect.MAVLink_odometry_message(
        time_us,
        dialect.MAV_FRAME_LOCAL_NED,
        dialect.MAV_FRAME_BODY_FRD,
        *ned_from_enu(pose.position_m),
        list(ned_frd_from_enu_flu(pose.orientation_wxyz)),
        *([math.nan] * 6),
        _covariance(pose.covariance),
        list(_UNKNOWN),
        passed.resets % 256,
        dialect.MAV_ESTIMATOR_TYPE_VISION,
    )


@dataclass(frozen=True, slots=True)
class PoseNeeds:
    title: str
    message: Callable[[Passed, int], Message]
    needs_origin: bool  # the autopilot has no position until it receives SET_GPS_GLOBAL_ORIGIN
    settings: str  # autopilot parameters to set, as text


POSE_NEEDS: Mapping[int, PoseNeeds] = {
    dialect.MAV_AUTOPILOT_PX4: PoseNeeds(
        "PX4", odometry, False, "EKF2_EV_CTRL 11, EKF2_HGT_REF 3, EKF2_GPS_CTRL 0, EKF2_MAG_TYPE 5"
    ),
    dialect.MAV_AUTOPILOT_ARDUPILOTMEGA: PoseNeeds(
        "ArduPilot",
        vision_position_estimate,
        True,
        "VISO_TYPE 1, GPS1_TYPE 0, EK3_SRC1_POSXY, EK3_SRC1_POSZ and EK3_SRC1_YAW 6",
    ),
}


class MocapVehicle:
    """Sends poses to a vehicle: call ``handle`` for each of its messages, then ``step``."""

    def __init__(self, system_id: int, origin: Origin | None) -> None:
        """``origin`` is the position of the room's origin on earth, for an autopilot that needs it."""
        self.needs: PoseNeeds | None = None  # requirements of the vehicle; None before its first heartbeat
        # MAV_AUTOPILOT number of an unsupported autopilot; None: the autopilot is supported
        self.unknown_autopilot: int | None = None
        self._origin, self._system_id = origin, system_id
        self._origin_sender = OriginSender(None, system_id)
        self._origin_known = False
        self._armed = False
        self._heard_s = self._beat_s = -math.inf

    @property
    def origin_missing(self) -> bool:
        return (
            self.needs is not None
            and self.needs.needs_origin
            and self._origin is None
            and not self._origin_known
        )

    def heard(self, now_s: float) -> bool:
        return now_s - self._heard_s <= SILENT_S

    def flies(self, now_s: float) -> bool:
        """Whether the vehicle sends heartbeats and is armed, so that it needs its poses."""
        return self._armed and self.heard(now_s)

    def handle(self, message: Message, now_s: float) -> list[Message]:
        """Handle a message of the vehicle's autopilot; return the reply."""
        id_ = message.get_msgId()
        if id_ == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            self._on_heartbeat(message, now_s)
        elif id_ == dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN:
            self._origin_known = True
        elif id_ == dialect.MAVLINK_MSG_ID_TIMESYNC and message.tc1 == 0:
            # PX4 uses our time stamps once these replies have synchronised the clocks (Timesync.cpp)
            return [dialect.MAVLink_timesync_message(max(1, round(now_s * 1e9)), message.ts1)]
        return []

    def step(self, poses: Sequence[Passed], now_s: float) -> list[Message]:
        """Return the messages to send now; without a supported vehicle the poses are dropped."""
        messages: list[Message] = []
        if now_s - self._beat_s >= (_HEARTBEAT_S if self.heard(now_s) else _HELLO_S) - 1e-9:
            self._beat_s = now_s
            messages.append(companion_heartbeat())
        needs = self.needs
        if needs is None or not self.heard(now_s):
            return messages
        messages += [needs.message(p, round(p.measured_s * 1e6)) for p in poses]
        status = VehicleStatus(now_s, self._armed, Mode.UNKNOWN, Landed.UNKNOWN, False)
        return messages + self._origin_sender.step(status, self._origin_known, now_s)

    def _on_heartbeat(self, message: Message, now_s: float) -> None:
        self._armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
        needs = POSE_NEEDS.get(message.autopilot)
        self.unknown_autopilot = message.autopilot if needs is None else None
        if needs is not self.needs or not self.heard(now_s):
            self.needs, self._origin_known = needs, False
            origin = self._origin if needs is not None and needs.needs_origin else None
            self._origin_sender = OriginSender(origin, self._system_id)
        self._heard_s = now_s
