"""Options that several verbs share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bridge.mavlink.profiles.autopilots import AUTO, CHOICES
from flightstack.core.parameters.filters import ALLOWED

if TYPE_CHECKING:
    from bridge.ros2.ros2_names import Ros2Network

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
    from bridge.ros2.ros2_names import Ros2Network

    return Ros2Network(where, domain) if where is not None else None


PERSONALITIES = ("px4", "ardupilot")


def scenario(required: bool = True) -> Callable[[Any], Any]:
    """``--scenario``."""
    return click.option(
        "--scenario",
        required=required,
        metavar="NAME_OR_FILE",
        help="Scenario: a name (see `scenarios`) or a file.",
    )


def _numbers(context: click.Context, option: click.Parameter, given: tuple[str, ...]) -> dict[str, float]:
    """Turn NAME=VALUE into a table."""
    del context, option
    found = {}
    for text in given:
        name, equals, value = text.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise click.BadParameter(f"found {text!r}; NAME=VALUE is needed, for example COM_OF_LOSS_T=0.5")
    return found


def _configuration(context: click.Context, option: click.Parameter, given: str | None) -> Path | None:
    """File of a configuration by name or path."""
    del context, option
    from flightstack.config.files import path_of

    return path_of(given) if given is not None else None


def _filter_name(context: click.Context, option: click.Parameter, given: str | None) -> str | None:
    """Name of a safety filter that there is."""
    del context, option
    if given is not None:
        from flightstack.core.parameters.filters import look_here
        from flightstack.core.strategies.strategy import strategy_class

        look_here(given)
        strategy_class(given)
    return given


def safety_filter(help: str) -> Callable[[Any], Any]:
    """``--filter``."""
    return click.option(
        "--filter",
        "filter_name",
        metavar="NAME",
        callback=_filter_name,
        help=f"{help}: {ALLOWED}.",
    )


def config(required: bool = True, help: str = "Configuration (TOML)") -> Callable[[Any], Any]:
    """``--config``."""
    return click.option(
        "--config",
        "config_file",
        required=required,
        metavar="NAME_OR_FILE",
        callback=_configuration,
        help=f"{help}: a name (see `config`) or a file.",
    )


seed = click.option(
    "--seed", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True, help="Random seed."
)
lockstep = click.option(
    "--lockstep", is_flag=True, help="Simulated time, as fast as possible, deterministic."
)
rate = click.option(
    "--rate", "rate_hz", type=click.IntRange(10, 500), default=100, show_default=True, help="Ticks a second."
)
recorder = click.option(
    "--recorder",
    type=click.Path(path_type=Path),
    metavar="SOCKET",
    help="Socket of a running `record`.",
)
no_record = click.option("--no-record", is_flag=True, help="Record nothing.")
out = click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for log and report; default: a new folder in runs/.",
)
as_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON object as the last line.")
with_report = click.option(
    "--report/--no-report", "with_report", default=True, show_default=True, help="Write the HTML report."
)
namespace = click.option(
    "--namespace", default="cf1", show_default=True, help="First part of all Zenoh keys and topics."
)
vehicle_url = click.option(
    "--vehicle",
    "vehicle_url",
    required=True,
    metavar="URL",
    help="MAVLink URL: udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE[:BAUD], by default "
    "at 921600 baud.",
)
system_id = click.option(
    "--system-id",
    type=click.IntRange(1, 255),
    default=1,
    show_default=True,
    help="MAVLink system id of the vehicle.",
)
signing_key = click.option(
    "--signing-key",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Sign MAVLink with this key and ignore unsigned frames (see `key`).",
)
allow_unsigned = click.option(
    "--allow-unsigned", is_flag=True, help="Listen on a network without a key: everybody there can fly it."
)
autopilot = click.option(
    "--autopilot",
    type=click.Choice(CHOICES),
    default=AUTO,
    show_default=True,
    help="Autopilot of the vehicle; auto: the heartbeat says which (docs/how_to/autopilots.md).",
)
personality = click.option(
    "--personality",
    type=click.Choice(PERSONALITIES),
    default=PERSONALITIES[0],
    show_default=True,
    help="Autopilot that the simulated vehicle imitates.",
)
parameters = click.option(
    "--parameter",
    "parameters",
    multiple=True,
    metavar="NAME=VALUE",
    callback=_numbers,
    help="Parameter of the autopilot, set before it starts; repeatable.",
)
speed = click.option(
    "--speed",
    type=click.FloatRange(0.1, 20.0),
    default=1.0,
    show_default=True,
    metavar="X",
    help="Stack time against real time, for a simulator of the same speed; never for a real vehicle.",
)
clock = click.option(
    "--clock",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Use the clock of `px4-sim --clock FILE` instead of the wall clock; never for a real vehicle.",
)
duration = click.option(
    "--duration",
    "duration_s",
    type=click.FloatRange(min=0.1),
    metavar="S",
    help="End after this time in seconds of stack time.",
)
view = click.option(
    "--view", is_flag=False, flag_value="native", metavar="[native|web|FILE.rrd]",
    help="The scene in 3-D during flight: in a window of Rerun, a browser, or a file (docs/how_to/live.md).",
)  # fmt: skip


def without_rerun(error: ModuleNotFoundError, what: str) -> Exception:
    """Return what to raise when a viewer cannot be imported: Rerun is missing, or the error as it is.

    Args:
        error: of the import.
        what: verb or option that needs it.
    """
    if error.name is None or error.name.partition(".")[0] != "rerun":
        return error
    return ValueError(
        f"`{what}` needs Rerun: pip install 'crazyflie-flightstack[view]'; "
        "or open the log itself in another viewer (docs/how_to/viewing.md)"
    )
