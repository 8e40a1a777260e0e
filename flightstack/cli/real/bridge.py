"""The verbs ``bridge ...``: each connects the stack to another system, in a process of its own."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flightstack.cli import options as shared
from flightstack.cli.options import takes
from flightstack.common.hangup import say

if TYPE_CHECKING:
    from bridge.mocap.checks import Limits
    from bridge.target.ros2_target import TargetSpec
    from flightstack.core.types import Vec3

POSE_TYPES = ("pose", "pose-covariance")


@dataclass(frozen=True)
class Poses(shared.Zenoh, shared.Signing):
    """Which poses of motion capture are accepted, and what both verbs need besides."""

    pose_type: str = shared.option(
        "--pose-type", type=click.Choice(POSE_TYPES), default=POSE_TYPES[0],
        help="PoseStamped or PoseWithCovarianceStamped.",
    )  # fmt: skip
    frame_id: str | None = shared.option("--frame", metavar="NAME", help="Refuse poses in any other frame.")
    offset_flu_m: tuple[float, float, float] = shared.option(
        "--offset", nargs=3, type=shared.number(), default=(0.0, 0.0, 0.0), metavar="X Y Z",
        help="From the markers' centre to the vehicle's, m, forward left up.",
    )  # fmt: skip
    pose_speed_m_s: float = shared.option(
        "--pose-speed-max", type=shared.number(0.1, 50.0), default=5.0, metavar="M/S",
        help="A pose that needs a higher speed is refused as a jump.",
    )  # fmt: skip
    ros_domain: int = shared.ros_domain
    duration_s: float | None = shared.duration

    @property
    def limits(self) -> Limits:
        """Limits of a pose that is accepted."""
        from bridge.mocap.checks import Limits

        return Limits(frame_id=self.frame_id, speed_max_m_s=self.pose_speed_m_s)

    def spec(self, key: str) -> TargetSpec:
        """Source of the poses at this key or topic.

        Raises:
            ValueError: a key or topic that is not allowed.
        """
        from bridge.mocap.process import parse_spec

        return parse_spec(key, self.pose_type, self.ros_domain)


@click.group()
def bridge() -> None:
    """Connect a stock Crazyflie as a MAVLink vehicle, or send poses of motion capture to a vehicle."""


@dataclass(frozen=True)
class CrazyflieOptions(Poses):
    """Options of ``bridge crazyflie``."""

    uri: str = shared.option(
        "--uri", required=True, metavar="URI",
        help="Crazyflie's address in cflib: radio://0/80/2M/E7E7E7E7E7, usb://0, udp://HOST:PORT.",
    )  # fmt: skip
    url: str = shared.url
    peers: tuple[str, ...] = shared.peers
    speed_max_m_s: float = shared.option(
        "--speed-max", type=shared.number(0.05, 5.0), default=1.0, metavar="M/S",
        help="Highest speed of a set-point; a faster one is scaled down to it.",
    )  # fmt: skip
    land_on_silence: bool = shared.option(
        "--land-on-silence", is_flag=True,
        help="Land when the client's set-points stop for 1 s; without it the firmware stops the motors at "
        "2 s.",
    )  # fmt: skip
    airframe: str = shared.option(
        "--airframe", default="crazyflie20", metavar="NAME|FILE",
        help="Vehicle file whose mass and drag the firmware's filter gets (kalman.dragB_*), or 'none'.",
    )  # fmt: skip
    restore: bool = shared.option(
        "--restore",
        is_flag=True,
        help="When the bridge ends, restore the firmware parameters that it changed.",
    )
    system_id: int = shared.system_id
    cache: Path | None = shared.option(
        "--cache", type=shared.FOLDER, metavar="FOLDER",
        help="Store the Crazyflie's tables there, for a faster second connection.",
    )  # fmt: skip
    mocap_key: str | None = shared.option(
        "--mocap", metavar="KEY",
        help="Send it poses from there: a Zenoh key, ros2:/TOPIC or ros2dds:/TOPIC (docs/how_to/mocap.md).",
    )  # fmt: skip


@bridge.command()
@takes(CrazyflieOptions)
def crazyflie(options: CrazyflieOptions) -> None:
    """Make a stock Crazyflie a MAVLink vehicle with PX4's modes (docs/how_to/crazyflie.md).

    Ctrl-C, or closing the terminal, lands a flying Crazyflie before the bridge ends. A second Ctrl-C ends the
    bridge at once, and the motors stop.
    """
    from bridge.crazyflie import process
    from bridge.crazyflie.rules import Rules

    rules = Rules(
        options.speed_max_m_s,
        options.land_on_silence,
        options.mocap_key is not None,
        _drag_1_s(options.airframe),
        options.restore,
    )
    plugged = options.to(process.Options, rules=rules)
    if options.mocap_key is None:
        sys.exit(process.run(plugged, say=say))

    from bridge.mocap.checks import PoseChecks
    from bridge.mocap.process import CheckedPoses, MocapSource, summary
    from bridge.zenoh import zenoh_link

    process.check_uri(options.uri)
    spec = options.spec(options.mocap_key)
    session = zenoh_link.open_session(
        options.listen, options.connect, config_file=options.zenoh_config, prompt=True
    )
    try:
        source = MocapSource(session, spec, options.offset_flu_m)
        poses = CheckedPoses(source, PoseChecks(options.limits))
        status = process.run(plugged, poses, say)
        say(summary(poses.checks))
    finally:
        session.close()
    sys.exit(status)


def _drag_1_s(airframe: str) -> Vec3 | None:
    """Rotor drag over mass, along body axes.

    Raises:
        ConfigError: no such vehicle file, or a key of it that is wrong.
    """
    if airframe == "none":
        return None
    from sim.plant.params import load

    body = load(airframe).body
    x, y, z = body.drag_n_s_m
    return (x / body.mass_kg, y / body.mass_kg, z / body.mass_kg)


@dataclass(frozen=True)
class MocapOptions(Poses):
    """Options of ``bridge mocap``."""

    pose_key: str = shared.option(
        "--key", required=True, metavar="KEY",
        help="Source of the poses: a Zenoh key, ros2:/TOPIC (rmw_zenoh), ros2dds:/TOPIC "
        "(docs/how_to/mocap.md).",
    )  # fmt: skip
    vehicle_url: str = shared.vehicle_url
    origin: tuple[float, float, float] | None = shared.option(
        "--origin", nargs=3, type=shared.number(), metavar="LAT LON ALT",
        help="Position on earth of the room's origin, degrees and m; ArduPilot needs one for its position.",
    )  # fmt: skip
    system_id: int = shared.system_id


@bridge.command()
@takes(MocapOptions)
def mocap(options: MocapOptions) -> None:
    """Check poses of motion capture and send them to a PX4 or ArduPilot vehicle (docs/how_to/mocap.md)."""
    from bridge.mavlink.client.companion import Origin
    from bridge.mocap import process
    from flightstack.core.parameters.flight import check_origin

    if options.origin is not None:
        check_origin("--origin", options.origin)
    place = Origin(*options.origin) if options.origin is not None else None
    plugged = options.to(process.Options, spec=options.spec(options.pose_key), origin=place)
    sys.exit(process.run(plugged, say))
