"""The verbs ``bridge ...``: each connects the stack to another system, in a process of its own."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flightstack.cli.options import ROS_DOMAIN_MAX, plugs
from flightstack.common.hangup import say

if TYPE_CHECKING:
    from bridge.mocap.checks import Limits

POSE_TYPES = ("pose", "pose-covariance")

_signing_key = click.option(
    "--signing-key", type=click.Path(path_type=Path), metavar="FILE",
    help="Sign MAVLink with this key and ignore unsigned frames (see `key`).",
)  # fmt: skip
_allow_unsigned = click.option(
    "--allow-unsigned", is_flag=True, help="Listen on a network without a key: everybody there can fly it."
)
_duration = click.option(
    "--duration", "duration_s", type=click.FloatRange(min=0.1), metavar="S", help="End after S seconds."
)


def _poses(verb: Callable[..., Any]) -> Callable[..., Any]:
    """Options that define which poses are accepted."""
    options = (
        click.option(
            "--pose-type", type=click.Choice(POSE_TYPES), default=POSE_TYPES[0], show_default=True,
            help="PoseStamped or PoseWithCovarianceStamped.",
        ),
        click.option("--frame", "frame_id", metavar="NAME", help="Refuse poses in any other frame."),
        click.option(
            "--offset", "offset_flu_m", nargs=3, type=float, default=(0.0, 0.0, 0.0), metavar="X Y Z",
            help="From the markers' centre to the vehicle's, m, forward left up.",
        ),
        click.option(
            "--pose-speed-max", "pose_speed_m_s", type=click.FloatRange(0.1, 50.0), default=5.0,
            show_default=True, metavar="M/S", help="A pose that needs a higher speed is refused as a jump.",
        ),
        click.option(
            "--ros-domain", type=click.IntRange(0, ROS_DOMAIN_MAX), default=0, show_default=True,
            envvar="ROS_DOMAIN_ID", show_envvar=True, help="Domain of the ROS 2 nodes.",
        ),
    )  # fmt: skip
    for option in reversed(options):
        verb = option(verb)
    return verb


def _limits(frame_id: str | None, pose_speed_m_s: float) -> Limits:
    from bridge.mocap.checks import Limits

    return Limits(frame_id=frame_id, speed_max_m_s=pose_speed_m_s)


@click.group()
def bridge() -> None:
    """Connect a stock Crazyflie as a MAVLink vehicle, or send poses of motion capture to a vehicle."""


@bridge.command()
@click.option(
    "--uri", required=True, metavar="URI",
    help="Crazyflie's address in cflib: radio://0/80/2M/E7E7E7E7E7, usb://0, udp://HOST:PORT.",
)  # fmt: skip
@click.option(
    "--url", default="udpin:127.0.0.1:14580", show_default=True,
    help="MAVLink URL to serve; port 0 takes a free one.",
)  # fmt: skip
@click.option(
    "--peer", "peers", multiple=True, metavar="HOST:PORT",
    help="Send telemetry there without being asked, e.g. 127.0.0.1:14550 for a ground station; repeatable.",
)  # fmt: skip
@click.option(
    "--speed-max", "speed_max_m_s", type=click.FloatRange(0.05, 5.0), default=1.0, show_default=True,
    metavar="M/S", help="Highest speed of a set-point; a faster one is scaled down to it.",
)  # fmt: skip
@click.option(
    "--land-on-silence", is_flag=True,
    help="Land when the client's set-points stop for 1 s; without it the firmware stops the motors at 2 s.",
)  # fmt: skip
@click.option(
    "--cache", type=click.Path(file_okay=False, path_type=Path), metavar="FOLDER",
    help="Store the Crazyflie's tables there, for a faster second connection.",
)  # fmt: skip
@click.option(
    "--mocap", "mocap_key", metavar="KEY",
    help="Send it poses from there: a Zenoh key, ros2:/TOPIC or ros2dds:/TOPIC (docs/how_to/mocap.md).",
)  # fmt: skip
@_poses
@plugs
@_signing_key
@_allow_unsigned
@_duration
def crazyflie(
    uri: str, url: str, peers: tuple[str, ...], speed_max_m_s: float, land_on_silence: bool,
    cache: Path | None, mocap_key: str | None, pose_type: str, frame_id: str | None,
    offset_flu_m: tuple[float, float, float], pose_speed_m_s: float, ros_domain: int,
    connect: tuple[str, ...], listen: tuple[str, ...], zenoh_config: Path | None,
    signing_key: Path | None, allow_unsigned: bool, duration_s: float | None,
) -> None:  # fmt: skip
    """Make a stock Crazyflie a MAVLink vehicle with PX4's modes (docs/how_to/crazyflie.md).

    Ctrl-C, or closing the terminal, lands a flying Crazyflie before the bridge ends. A second Ctrl-C ends the
    bridge at once, and the motors stop.
    """
    from bridge.crazyflie import process
    from bridge.crazyflie.rules import Rules

    rules = Rules(speed_max_m_s, land_on_silence, mocap_key is not None)
    options = process.Options(uri, url, peers, cache, signing_key, allow_unsigned, rules, duration_s)
    if mocap_key is None:
        sys.exit(process.run(options, say=say))

    from bridge.mocap.checks import PoseChecks
    from bridge.mocap.process import CheckedPoses, MocapSource, parse_spec, summary
    from bridge.zenoh import zenoh_link

    process.check_uri(uri)
    spec = parse_spec(mocap_key, pose_type, ros_domain)
    session = zenoh_link.open_session(listen, connect, config_file=zenoh_config)
    try:
        poses = CheckedPoses(
            MocapSource(session, spec, offset_flu_m), PoseChecks(_limits(frame_id, pose_speed_m_s))
        )
        status = process.run(options, poses, say)
        say(summary(poses.checks))
    finally:
        session.close()
    sys.exit(status)


@bridge.command()
@click.option(
    "--key", "pose_key", required=True, metavar="KEY",
    help="Source of the poses: a Zenoh key, ros2:/TOPIC (rmw_zenoh), ros2dds:/TOPIC (docs/how_to/mocap.md).",
)  # fmt: skip
@click.option(
    "--vehicle", "vehicle_url", required=True, metavar="URL",
    help="MAVLink URL of the vehicle: udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT, serial:DEVICE:BAUD.",
)  # fmt: skip
@click.option(
    "--origin", nargs=3, type=float, metavar="LAT LON ALT",
    help="Position on earth of the room's origin, degrees and m; ArduPilot needs one for its position.",
)  # fmt: skip
@click.option(
    "--system-id", type=click.IntRange(1, 255), default=1, show_default=True,
    help="MAVLink system id of the vehicle.",
)  # fmt: skip
@_poses
@plugs
@_signing_key
@_allow_unsigned
@_duration
def mocap(
    pose_key: str, vehicle_url: str, origin: tuple[float, float, float] | None, system_id: int,
    pose_type: str, frame_id: str | None, offset_flu_m: tuple[float, float, float], pose_speed_m_s: float,
    ros_domain: int, connect: tuple[str, ...], listen: tuple[str, ...], zenoh_config: Path | None,
    signing_key: Path | None, allow_unsigned: bool, duration_s: float | None,
) -> None:  # fmt: skip
    """Check poses of motion capture and send them to a PX4 or ArduPilot vehicle (docs/how_to/mocap.md)."""
    from bridge.mavlink.client.companion import Origin
    from bridge.mocap import process
    from bridge.mocap.process import parse_spec
    from flightstack.core.parameters.vehicle import check_origin

    if origin is not None:
        check_origin("--origin", origin)
    place = Origin(*origin) if origin is not None else None
    spec = parse_spec(pose_key, pose_type, ros_domain)
    options = process.Options(
        vehicle_url, spec, connect, listen, zenoh_config, _limits(frame_id, pose_speed_m_s), offset_flu_m,
        place, system_id, signing_key, allow_unsigned, duration_s,
    )  # fmt: skip
    sys.exit(process.run(options, say))
