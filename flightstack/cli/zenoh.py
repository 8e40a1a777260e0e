"""Options of every verb that uses Zenoh."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from bridge.ros2.ros2_network import Ros2Network

ROS_DOMAIN_MAX = 232
TARGET_TYPES = ("odometry", "pose", "pose-covariance", "tf")

connect = click.option(
    "--connect",
    multiple=True,
    metavar="ENDPOINT",
    help="Zenoh endpoint to connect to, e.g. tcp/10.0.0.2:7447; repeatable.",
)
listen = click.option(
    "--listen",
    multiple=True,
    metavar="ENDPOINT",
    help="Zenoh endpoint to listen on; default: a free port of loopback.",
)
zenoh_config = click.option(
    "--zenoh-config",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Zenoh configuration (JSON5): routers, TLS, passwords, access (docs/how_to/zenoh.md).",
)
target_key = click.option(
    "--target", "target_key", default="cf1/target/odom", show_default=True, metavar="KEY",
    help="Source of the target: a Zenoh key, ros2:/TOPIC (rmw_zenoh), ros2dds:/TOPIC (docs/how_to/ros2.md).",
)  # fmt: skip
target_type = click.option(
    "--target-type", type=click.Choice(TARGET_TYPES), default=TARGET_TYPES[0], show_default=True,
    help="Message type of the target; for all types but odometry the velocity is estimated.",
)  # fmt: skip
target_offset = click.option(
    "--target-offset", type=float, nargs=3, default=(0.0, 0.0, 0.0), metavar="X Y Z",
    help="Landing spot from the tracked frame, in that frame's axes, m: forward, left, up.",
)  # fmt: skip
_ros2 = click.option(
    "--ros2", "ros2_where", metavar="ENDPOINT|FILE",
    help="Show the flight to ROS 2: endpoint of its router, as tcp/127.0.0.1:7447, or a Zenoh configuration.",
)  # fmt: skip
_ros_domain = click.option(
    "--ros-domain", type=click.IntRange(0, ROS_DOMAIN_MAX), default=0, show_default=True,
    envvar="ROS_DOMAIN_ID", show_envvar=True, help="Domain of the ROS 2 nodes.",
)  # fmt: skip


def plugs(verb: Callable[..., Any]) -> Callable[..., Any]:
    """Options ``--connect``, ``--listen`` and ``--zenoh-config``."""
    return connect(listen(zenoh_config(verb)))


def ros2(verb: Callable[..., Any]) -> Callable[..., Any]:
    """Options ``--ros2`` and ``--ros-domain``."""
    return _ros2(_ros_domain(verb))


def ros2_network(where: str | None, domain: int) -> Ros2Network | None:
    """Return the network that ``--ros2`` and ``--ros-domain`` name, None without ``--ros2``."""
    from bridge.ros2.ros2_network import Ros2Network

    return Ros2Network(where, domain) if where is not None else None
