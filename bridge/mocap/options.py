"""Options of the bridges that receive motion capture poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from flightstack.common.options import Option
from flightstack.config import options as shared

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
