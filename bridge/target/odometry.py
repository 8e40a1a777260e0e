"""Target odometry on Zenoh: ``nav_msgs/msg/Odometry`` in CDR with the attachment of rmw_zenoh.

This module also decodes the samples and reads the noise that their sender reports.
"""

from __future__ import annotations

import math
import secrets
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from bridge.frames import Quat, world_from_body, yaw_from_quaternion
from bridge.ros2.cdr import Odometry, checked_unit, decode_odometry
from bridge.ros2.ros2_names import Ros2Publisher
from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import GID_BYTES, parse_attachment
from flightstack.core.parameters.robust import TargetLink
from flightstack.core.types import TargetSample, Vec3

ENCODING = "application/cdr;nav_msgs/msg/Odometry"
WARN_FACTOR = 1.5  # ratio of reported to configured noise above which a warning is sent
_UNUSED_M2 = 1e3  # variance, m2 or m2/s2, from which a value counts as unknown; some drivers write 1e6


class RawSample(NamedTuple):
    """A received sample, with sequence number and time of its attachment."""

    payload: bytes
    sequence: int | None = None  # sequence number of the attachment; None: no attachment
    source_time_ns: int | None = None  # Unix time of the attachment; None: no attachment
    odometry: Odometry | None = None  # odometry from which this process made the payload, or None


class SampleSource(Protocol):
    def poll(self) -> list[RawSample]:
        """Return all samples that have arrived, oldest first; never blocks."""


def sample_of(raw: RawSample, arrival_s: float) -> TargetSample:
    """Convert a sample, with velocities rotated into the world frame; ``arrival_s`` is on the stack's clock.

    Raises OdometryError: malformed, a value not finite or above 1e9, or no unit quaternion.
    """
    o = raw.odometry or decode_odometry(raw.payload)
    q = checked_unit(o.orientation_wxyz, (*o.position_m, *o.linear_m_s, *o.angular_rad_s))
    return TargetSample(
        arrival_s=arrival_s,
        source_time_s=o.stamp_ns / 1e9,
        frame_id=o.frame_id,
        child_frame_id=o.child_frame_id,
        position_enu_m=o.position_m,
        velocity_enu_m_s=world_from_body(q, o.linear_m_s),
        yaw_rad=yaw_from_quaternion(q),
        yaw_rate_rad_s=world_from_body(q, o.angular_rad_s)[2],
        position_sigma_m=sigma_of(o.pose_covariance[0], o.pose_covariance[7]) or 0.0,
        velocity_sigma_m_s=sigma_of(o.twist_covariance[0], o.twist_covariance[7]) or 0.0,
    )


def sigma_of(variance_x: float, variance_y: float) -> float | None:
    """Return the larger standard deviation of x and y; None: not reported by the sender."""
    known = 0.0 < variance_x < _UNUSED_M2 and 0.0 < variance_y < _UNUSED_M2  # False for NaN
    return math.sqrt(max(variance_x, variance_y)) if known else None


def excess_noise(
    pose_covariance: Sequence[float], twist_covariance: Sequence[float], link: TargetLink
) -> str:
    """Return a warning if the sender reports more noise than the configuration; else an empty text."""
    found: list[str] = []
    for covariance, configured, name, unit in (
        (pose_covariance, link.position_noise_m, "position_noise_m", "m"),
        (twist_covariance, link.velocity_noise_m_s, "velocity_noise_m_s", "m/s"),
    ):
        sigma = sigma_of(covariance[0], covariance[7])
        if sigma is not None and sigma > WARN_FACTOR * configured:
            found.append(f"{sigma:.3g} {unit} where target.{name} is {configured:g}")
    if not found:
        return ""
    return (
        f"its covariance has {' and '.join(found)}: flown with larger margins; configure these values, since "
        "the certificate uses the configured ones"
    )


class OdometryPublisher(Ros2Publisher):
    """Publishes ``nav_msgs/msg/Odometry`` in CDR on one Zenoh key."""

    def __init__(
        self,
        session: zenoh_link.Session,
        key: str,
        frame_id: str = "map",
        child_frame_id: str = "target",
        *,
        lossless: bool = False,
    ) -> None:
        """Declare the publisher of a key.

        Args:
            session: an open Zenoh session, owned by the caller.
            key: key expression, for example ``cf1/target/odom``.
            frame_id: frame of the pose.
            child_frame_id: frame of the twist.
            lossless: wait for room instead of dropping (lockstep).

        Raises:
            ValueError: the key is not allowed.
        """
        declare = zenoh_link.blocking_publisher if lossless else zenoh_link.dropping_publisher
        super().__init__(declare(session, key, ENCODING), secrets.token_bytes(GID_BYTES))
        self.frame_id = frame_id
        self.child_frame_id = child_frame_id

    def encode(
        self, stamp_ns: int, position_m: Vec3, orientation_wxyz: Quat, linear_m_s: Vec3, angular_rad_s: Vec3
    ) -> bytes:
        """Serialise a message with this publisher's frames; the twist is in the child frame."""
        frames = self.frame_id, self.child_frame_id
        return Odometry(stamp_ns, *frames, position_m, orientation_wxyz, linear_m_s, angular_rad_s).pack()


def raw_sample(sample: zenoh_link.Sample) -> RawSample:
    attachment = sample.attachment.to_bytes() if sample.attachment is not None else None
    return RawSample(sample.payload.to_bytes(), *(parse_attachment(attachment) or ()))
