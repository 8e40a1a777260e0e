"""Options of the verbs: a verb gets one object of a dataclass, each field of which is an option or argument.

Options that several verbs share are declared here, alone or in a class of those that belong together.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from flightstack.common.strict_toml import decoded
from flightstack.core.parameters.filters import ALLOWED

if TYPE_CHECKING:
    from bridge.ros2.ros2_names import Ros2Network

T = TypeVar("T")
TARGET_TYPES = ("odometry", "pose", "pose-covariance", "tf")
# written out here, so that a verb does not load the rooms that know them; a test compares them
AUTOPILOTS = ("auto", "sitl", "crazyflie", "px4", "ardupilot")
PROFILES = ("px4", "ardupilot")
CORES = ("auto", "plain", "compiled")
_SEED_DIGITS_MAX = 4000  # more than the longest that ``rare`` makes; Python reads 4,300
EXISTING_FILE = click.Path(exists=True, dir_okay=False, path_type=Path)
FILE = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)


class Number(click.FloatRange):
    """A finite number, in a range or in none: comparisons alone let NaN pass."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Read it."""
        found: float = super().convert(value, param, ctx)
        if not math.isfinite(found):
            self.fail(f"found {value}, a finite number is needed", param, ctx)
        return found

    def _describe_range(self) -> str:
        return super()._describe_range() if self.min is not None or self.max is not None else ""


def number(min: float | None = None, max: float | None = None) -> Number:
    """Type of an option that is a number from ``min`` to ``max``."""
    return Number(min, max)


def option(*names: str, **settings: Any) -> Any:
    """Field of an options class: an option with these names, and the settings of ``click.option``."""
    return partial(click.option, *names, show_default=True, **settings)


def argument(**settings: Any) -> Any:
    """Field of an options class: an argument with the settings of ``click.argument``."""
    return partial(click.argument, **settings)


@dataclass(frozen=True)
class Options:
    """What a verb was told."""

    def to(self, cls: type[T], **others: Any) -> T:
        """Make a ``cls`` of the fields that it shares with this class, and of ``others``."""
        shared = {f.name: getattr(self, f.name) for f in fields(cls) if hasattr(self, f.name)}  # type: ignore[arg-type]
        return cls(**{**shared, **others})


def takes(cls: type[T]) -> Callable[[Callable[[T], None]], Callable[..., None]]:
    """Give a verb its options, required ones first, and arguments as one object of the dataclass ``cls``."""
    known: list[tuple[str, Any]] = [(field.name, field.default) for field in fields(cls)]  # type: ignore[arg-type]
    known.sort(key=lambda field: not field[1].keywords.get("required"))

    def decorate(verb: Callable[[T], None]) -> Callable[..., None]:
        @wraps(verb)
        def run(**given: Any) -> None:
            verb(cls(**given))

        decorated: Callable[..., None] = run
        for name, declared in reversed(known):
            decorated = declared(name)(decorated)
        return decorated

    return decorate


def numbers(context: click.Context, parameter: click.Parameter, given: tuple[str, ...]) -> dict[str, float]:
    """Turn NAME=VALUE into a table."""
    del context, parameter
    found = {}
    for text in given:
        name, equals, value = text.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            equals = ""
        if not equals or not math.isfinite(found[name]):
            raise click.BadParameter(
                f"found {text!r}; NAME=VALUE with a finite number is needed, for example COM_OF_LOSS_T=0.5"
            )
    return found


def _configuration(context: click.Context, parameter: click.Parameter, given: str | None) -> Path | None:
    """File of a configuration by name or path."""
    del context, parameter
    from flightstack.config.files import path_of

    return path_of(given) if given is not None else None


def _filter_name(context: click.Context, parameter: click.Parameter, given: str | None) -> str | None:
    """Name of a safety filter that there is."""
    del context, parameter
    if given is not None:
        from flightstack.core.parameters.filters import look_here
        from flightstack.core.strategies.strategy import strategy_class

        look_here(given)
        strategy_class(given)
    return given


def config(help: str = "Configuration (TOML)", *, required: bool = False) -> Any:
    """``--config``."""
    return option(
        "--config", required=required, metavar="NAME_OR_FILE", callback=_configuration,
        help=f"{help}: a name (see `config`) or a file.",
    )  # fmt: skip


def _seed(context: click.Context, parameter: click.Parameter, given: str) -> int:
    """A seed by its number, or by a file that holds it."""
    del context, parameter
    text, file = given, Path(given)
    if not given.isdecimal() and file.is_file():
        text = decoded(file.read_bytes()).strip()
    if not (text.isascii() and text.isdecimal()) or len(text) > _SEED_DIGITS_MAX:
        raise click.BadParameter(
            f"found {given[:60]!r}; a whole number from 0 on, or a file with one of `rare`, is needed"
        )
    return int(text)


def safety_filter(help: str) -> Any:
    """``--filter``."""
    return option("--filter", metavar="NAME", callback=_filter_name, help=f"{help}: {ALLOWED}.")


def json(help: str = "Print one JSON object.") -> Any:
    """``--json``."""
    return option("--json", is_flag=True, help=help)


member = option("--member", metavar="NAME", help="Take the flight of this member of a fleet, e.g. cf2.")

one_member = option(
    "--member", type=click.IntRange(min=1), metavar="N",
    help="With a scenario of several vehicles: member N alone, with its seed, namespace and system id.",
)  # fmt: skip

zenoh_config = option(
    "--zenoh-config", type=EXISTING_FILE, metavar="FILE",
    help="Zenoh configuration (JSON5): routers, TLS, passwords, access (docs/how_to/zenoh.md).",
)  # fmt: skip
connect = option(
    "--connect", multiple=True, metavar="ENDPOINT",
    help="Zenoh endpoint to connect to, e.g. tcp/10.0.0.2:7447; repeatable.",
)  # fmt: skip
lockstep = option("--lockstep", is_flag=True, help="Simulated time, as fast as possible, deterministic.")
rate = option("--rate", type=click.IntRange(10, 500), default=100, help="Ticks a second.")
recorder = option(
    "--recorder", type=click.Path(path_type=Path), metavar="SOCKET", help="Socket of a running `record`."
)
namespace = option("--namespace", default="cf1", help="First part of all Zenoh keys and topics.")
duration = option(
    "--duration", type=number(min=0.1), metavar="S",
    help="End after this time in seconds of stack time.",
)  # fmt: skip
speed = option(
    "--speed", type=number(0.1, 20.0), default=1.0, metavar="X",
    help="Stack time against real time, for a simulator of the same speed; never for a real vehicle.",
)  # fmt: skip
clock = option(
    "--clock", type=FILE, metavar="FILE",
    help="Use the clock of `px4-sim --clock FILE` instead of the wall clock; never for a real vehicle.",
)  # fmt: skip
url = option("--url", default="udpin:127.0.0.1:14580", help="MAVLink URL to serve; port 0 takes a free one.")
peers = option(
    "--peer", multiple=True, metavar="HOST:PORT",
    help="Send telemetry there without being asked, e.g. 127.0.0.1:14540 for MAVSDK, 127.0.0.1:14550 for a "
    "ground station; repeatable.",
)  # fmt: skip
vehicle_url = option(
    "--vehicle", required=True, metavar="URL",
    help="MAVLink URL: udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE[:BAUD], by default "
    "at 921600 baud.",
)  # fmt: skip
system_id = option(
    "--system-id", type=click.IntRange(1, 255), default=1, help="MAVLink system id of the vehicle."
)
autopilot = option(
    "--autopilot", type=click.Choice(AUTOPILOTS), default=AUTOPILOTS[0],
    help="Autopilot of the vehicle; auto: the heartbeat says which (docs/how_to/autopilots.md).",
)  # fmt: skip
accept_release = option(
    "--accept-release", is_flag=True,
    help="Fly an autopilot whose release is not known by the rules of the nearest one.",
)  # fmt: skip
profile = option(
    "--profile", "--personality", type=click.Choice(PROFILES), default=PROFILES[0],
    help="Autopilot that the simulated vehicle imitates (--personality is the old name).",
)  # fmt: skip
signing_key = option(
    "--signing-key", type=click.Path(path_type=Path), metavar="FILE",
    help="Sign MAVLink with this key and ignore unsigned frames (see `key`).",
)  # fmt: skip
allow_unsigned = option(
    "--allow-unsigned", is_flag=True, help="Listen on a network without a key: everybody there can fly it."
)
ros_domain = option(
    "--ros-domain", type=click.IntRange(0, 232), default=0, envvar="ROS_DOMAIN_ID", show_envvar=True,
    help="Domain of the ROS 2 nodes.",
)  # fmt: skip
mocap = option("--mocap", is_flag=True, help="Give PX4 the scenario's motion capture instead of satellites.")
view = option(
    "--view", is_flag=False, flag_value="native", metavar="[native|web|FILE.rrd]",
    help="The scene in 3-D during flight: in a window of Rerun, a browser, or a file (docs/how_to/live.md).",
)  # fmt: skip


@dataclass(frozen=True)
class Scenario(Options):
    """What is simulated."""

    scenario: str = option(
        "--scenario", required=True, metavar="NAME_OR_FILE",
        help="Scenario: a name (see `scenarios`) or a file.",
    )  # fmt: skip
    seed: int = option(
        "--seed",
        default="0",
        metavar="NUMBER_OR_FILE",
        callback=_seed,
        help="Random seed or a file with one.",
    )


@dataclass(frozen=True)
class Zenoh(Options):
    """Where a process is plugged into Zenoh."""

    connect: tuple[str, ...] = connect
    listen: tuple[str, ...] = option(
        "--listen", multiple=True, metavar="ENDPOINT",
        help="Zenoh endpoint to listen on; default: a free port of loopback.",
    )  # fmt: skip
    zenoh_config: Path | None = zenoh_config


@dataclass(frozen=True)
class Signing(Options):
    """Who may speak MAVLink."""

    signing_key: Path | None = signing_key
    allow_unsigned: bool = allow_unsigned


@dataclass(frozen=True)
class Ros2(Options):
    """Where a flight is shown to ROS 2."""

    ros2_where: str | None = option(
        "--ros2", metavar="ENDPOINT|FILE",
        help="Show the flight to ROS 2: endpoint of its router, as tcp/127.0.0.1:7447, or a Zenoh "
        "configuration.",
    )  # fmt: skip
    ros_domain: int = ros_domain

    @property
    def ros2(self) -> Ros2Network | None:
        """The network that is named; None without ``--ros2``."""
        from bridge.ros2.ros2_names import Ros2Network

        return Ros2Network(self.ros2_where, self.ros_domain) if self.ros2_where is not None else None


@dataclass(frozen=True)
class Result(Options):
    """What remains of a flight."""

    out: Path | None = option(
        "--out", type=FOLDER, help="Folder for log and report; default: a new folder in runs/."
    )
    as_json: bool = json("Print one JSON object as the last line.")
    with_report: bool = option("--report/--no-report", default=True, help="Write the HTML report.")


@dataclass(frozen=True)
class Flight(Signing, Ros2, Zenoh):
    """What the verbs need that fly any vehicle: vehicle, target, configuration, links."""

    vehicle_url: str = vehicle_url
    target_key: str = option(
        "--target", default="cf1/target/odom", metavar="KEY",
        help="Source of the target: a Zenoh key, ros2:/TOPIC (rmw_zenoh), ros2dds:/TOPIC "
        "(docs/how_to/ros2.md).",
    )  # fmt: skip
    target_type: str = option(
        "--target-type", type=click.Choice(TARGET_TYPES), default=TARGET_TYPES[0],
        help="Message type of the target; for all types but odometry the velocity is estimated.",
    )  # fmt: skip
    target_offset_m: tuple[float, float, float] = option(
        "--target-offset", type=number(), nargs=3, default=(0.0, 0.0, 0.0), metavar="X Y Z",
        help="Landing spot from the tracked frame, in that frame's axes, m: forward, left, up.",
    )  # fmt: skip
    config_file: Path = config(required=True)
    namespace: str | None = option(
        "--namespace",
        help="First part of all Zenoh keys and topics; default: cf1, or cf and the id of [fleet].",
    )
    no_record: bool = option("--no-record", is_flag=True, help="Record nothing.")
    duration_s: float | None = duration
    system_id: int = system_id
    autopilot: str = autopilot
    accept_release: bool = accept_release
    core: str = option(
        "--core", type=click.Choice(CORES), default=CORES[0],
        help="Code of the control step: plain Python, or compiled by numba, equal to the last bit; auto: "
        "compiled in real time where it has been compiled before.",
    )  # fmt: skip


def without_recordings(error: ModuleNotFoundError, what: str) -> Exception:
    """Return what to raise when recorded flights cannot be read or simulated, or the error as it is.

    Args:
        error: of the import.
        what: verb or option that needs it.
    """
    package = (error.name or "").partition(".")[0]
    if package not in ("pyarrow", "mujoco", "numba"):
        return error
    return ValueError(f"`{what}` needs {package}: pip install 'crazyflie-flightstack[sim,export]'")


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
