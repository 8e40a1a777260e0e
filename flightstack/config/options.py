"""Options that several commands share: for the onboard process, and for watching it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from flightstack.common.options import BadOptionError, Option, declared
from flightstack.core.parameters.filters import ALLOWED, look_here

# values of bridge.target.ros2_target.TargetType (a test checks this), whose module takes 40 ms to import
TARGET_TYPES = ("odometry", "pose", "pose-covariance")
CORES = ("auto", "plain", "compiled")
WATCHED = "tcp/127.0.0.1:7448"  # Zenoh endpoint of the onboard process in README and docs


def numbers(given: tuple[str, ...]) -> Mapping[str, float]:
    """Return a table from texts NAME=VALUE. Raises BadOptionError: a text is not NAME=VALUE."""
    found = {}
    for text in given:
        name, _, value = text.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = math.nan
        if not math.isfinite(found[name]):
            raise BadOptionError(
                f"found {text!r}; NAME=VALUE with a finite number is needed, for example COM_OF_LOSS_T=0.5"
            )
    return found


def _filter_name(given: str) -> str:
    """Return the name of a safety filter. Raises ConfigError: there is no such filter."""
    from flightstack.core.strategies.strategy import strategy_class

    look_here(given)
    strategy_class(given)
    return given


def _configuration(given: str) -> Path:
    from flightstack.config import path_of

    return path_of(given)


def _configurations(given: tuple[str, ...]) -> tuple[Path, ...]:
    return tuple(map(_configuration, given))


def safety_filter(help: str) -> Option:
    return Option("--filter", f"{help}: {ALLOWED}.", metavar="NAME", read=_filter_name)


def config(help: str = "Configuration (TOML)") -> Option:
    return Option(
        "--config", f"{help}: a name (see `config`) or a file.", metavar="NAME_OR_FILE", read=_configuration
    )


def seconds(name: str, help: str, low: float | None = None, high: float | None = None) -> Option:
    """Return an option whose value is a time in seconds."""
    return Option(name, help, metavar="S", span=(low, high))


Connect = Annotated[tuple[str, ...], Option(
    "--connect", "Zenoh endpoint to connect to, e.g. tcp/10.0.0.2:7447; repeatable.", "ENDPOINT"
)]  # fmt: skip
ZenohConfig = Annotated[Path | None, Option(
    "--zenoh-config", "Zenoh configuration (JSON5): routers, TLS, passwords, access (docs/how_to/zenoh.md).",
    "FILE", path="file", exists=True
)]  # fmt: skip
Lockstep = Annotated[bool, Option("--lockstep", "Simulated time, as fast as possible, deterministic.")]
Recorder = Annotated[Path | None, Option("--recorder", "Socket of a running `record`.", metavar="SOCKET")]
Namespace = Annotated[str, Option("--namespace", "First part of all Zenoh keys and topics.")]
Duration = Annotated[
    float | None, seconds("--duration", "End after this time in seconds of stack time.", 0.1, 604_800.0)
]
Speed = Annotated[float, Option(
    "--speed", "Stack time against real time, for a simulator of the same speed; never for a real vehicle.",
    "X", span=(0.1, 20.0)
)]  # fmt: skip
Url = Annotated[str, Option("--url", "MAVLink URL to serve; port 0 takes a free one.")]
Peers = Annotated[tuple[str, ...], Option(
    "--peer", "Send telemetry there without a request, e.g. 127.0.0.1:14540 for MAVSDK, 127.0.0.1:14550 "
    "for a ground station; repeatable.", "HOST:PORT"
)]  # fmt: skip
SystemId = Annotated[int, Option("--system-id", "MAVLink system id of the vehicle.", span=(1, 255))]
SigningKey = Annotated[Path | None, Option(
    "--signing-key", "Sign MAVLink with this key and ignore unsigned frames (see `key`).", "FILE"
)]  # fmt: skip
AllowUnsigned = Annotated[
    bool, Option("--allow-unsigned", "Listen on a network without a key: every host there can command it.")
]
RosDomain = Annotated[int, Option(
    "--ros-domain", "Domain of the ROS 2 nodes.", span=(0, 232), variable="ROS_DOMAIN_ID"
)]  # fmt: skip
Mocap = Annotated[bool, Option("--mocap", "Give PX4 the scenario's motion capture instead of satellites.")]
View = Annotated[str | None, Option(
    "--view",
    "Show the scene in 3-D during flight: in Rerun's window, a browser, or a file (docs/how_to/live.md).",
    "[native|web|FILE.rrd]", bare="native"
)]  # fmt: skip
OneMember = Annotated[int | None, Option(
    "--member",
    "With a scenario of several vehicles: only member N, with its seed, namespace and system id.", "N",
    span=(1, None)
)]  # fmt: skip
Member = Annotated[
    str | None, Option("--member", "Take the flight of this member of a fleet, e.g. cf2.", metavar="NAME")
]
AsJson = Annotated[bool, Option("--json", "Print one JSON object.")]
Workers = Annotated[int | None, Option(
    "--workers", "Worker processes; default: one for each processor.", span=(1, 1024)
)]  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """Options of a simulation: scenario and seed."""

    scenario: Annotated[str | Path, Option(
        "--scenario", "Scenario: a name (see `scenarios`) or a file.", "NAME_OR_FILE"
    )]  # fmt: skip
    seed: Annotated[int, Option("--seed", "Random seed.", span=(0, 2**64 - 1))] = 0


@dataclass(frozen=True, kw_only=True)
class Zenoh:
    connect: Connect = ()
    listen: Annotated[tuple[str, ...], Option(
        "--listen", "Zenoh endpoint to listen on; default: a free port of loopback.", "ENDPOINT"
    )] = ()  # fmt: skip
    zenoh_config: ZenohConfig = None


@dataclass(frozen=True, kw_only=True)
class Simulator(Zenoh, Simulated):
    """Options of every process of the simulator."""

    duration_s: Duration = None
    recorder: Recorder = None
    namespace: Namespace = "cf1"


@dataclass(frozen=True, kw_only=True)
class Piloted:
    """Options of ``sitl``, ``fly``, ``onboard`` and ``preflight``; a flight log contains the given ones."""

    autopilot: Annotated[str, Option(
        "--autopilot",
        "Autopilot of the vehicle; auto: as the heartbeat reports (docs/how_to/autopilots.md).",
        choices="bridge.mavlink.profiles:CHOICES"
    )] = "auto"  # fmt: skip
    accept_release: Annotated[bool, Option(
        "--accept-release", "Fly an unknown release of the autopilot with the rules of the nearest one."
    )] = False  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    vehicle_url: Annotated[str, Option(
        "--vehicle",
        "MAVLink URL: udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE[:BAUD], by default "
        "at 921600 baud.", "URL"
    )]  # fmt: skip
    system_id: SystemId = 1


@dataclass(frozen=True, kw_only=True)
class Clocked:
    speed: Speed = 1.0
    clock: Annotated[Path | None, Option(
        "--clock",
        "Use the clock of `px4-sim --clock FILE` instead of the wall clock; never for a real vehicle.",
        "FILE", path="file"
    )] = None  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Signing:
    """Options that select the accepted MAVLink senders."""

    signing_key: SigningKey = None
    allow_unsigned: AllowUnsigned = False


@dataclass(frozen=True, kw_only=True)
class Ros2:
    ros2_where: Annotated[str | None, Option(
        "--ros2",
        "Show the flight to ROS 2: endpoint of its router, as tcp/127.0.0.1:7447, or a Zenoh configuration.",
        "ENDPOINT|FILE"
    )] = None  # fmt: skip
    ros_domain: RosDomain = 0


@dataclass(frozen=True, kw_only=True)
class Repeated(Piloted):
    """Options of ``sitl`` that change sent bytes or their timing; the log and the report contain them."""

    speed: Speed = 1.0
    duration_s: Duration = None
    signing_key: SigningKey = None
    mocap: Mocap = False


def described(options: object, cls: type[Piloted]) -> dict[str, str]:
    """Return the values of the options that ``cls`` declares, for the log, without defaults."""
    found = {}
    for name, _, _, _, _, default in declared(cls):
        if (value := getattr(options, name)) != default:
            text = f"{value:.12g}" if isinstance(value, float) else str(value)
            found[name] = text.lower() if value is True else text
    return found


def repeated(described: Mapping[str, str]) -> list[str]:
    """Return the command-line arguments of the logged options; a flag has no value."""
    words: list[str] = []
    for name, option, kind, *_ in declared(Repeated):
        if name in described:
            words += [option.name] if kind is bool else [option.name, described[name]]
    return words


@dataclass(frozen=True, kw_only=True)
class Result:
    out: Annotated[Path | None, Option(
        "--out", "Folder for log and report; default: a new folder in runs/.", path="folder"
    )] = None  # fmt: skip
    as_json: Annotated[bool, Option("--json", "Print one JSON object as the last line.")] = False
    with_report: Annotated[bool, Option("--report/--no-report", "Write the HTML report.")] = True


@dataclass(frozen=True, kw_only=True)
class FlightOptions(Signing, Ros2, Zenoh, Piloted, Vehicle):
    """Options to fly any vehicle: vehicle, target, configuration, links."""

    target_key: Annotated[str, Option(
        "--target",
        "Source of the target: a Zenoh key, ros2:/TOPIC (rmw_zenoh), ros2dds:/TOPIC (docs/how_to/ros2.md).",
        "KEY"
    )] = "cf1/target/odom"  # fmt: skip
    target_type: Annotated[str, Option(
        "--target-type", "Message type of the target; for all types but odometry the velocity is estimated.",
        choices=TARGET_TYPES
    )] = "odometry"  # fmt: skip
    target_offset_m: Annotated[tuple[float, float, float], Option(
        "--target-offset", "Landing spot from the tracked frame, in that frame's axes, m: forward, left, up.",
        "X Y Z", span=(-5.0, 5.0)
    )] = (0.0, 0.0, 0.0)  # fmt: skip
    config_file: Annotated[Path, config()]
    namespace: Annotated[str | None, Option(
        "--namespace", "First part of all Zenoh keys and topics; default: cf1, or cf and the id of [fleet]."
    )] = None  # fmt: skip
    no_record: Annotated[bool, Option("--no-record", "Record nothing.")] = False
    duration_s: Duration = None
    unproven: Annotated[
        bool, Option(
            "--unproven", "Fly a filter whose class has no certificate of its own; the configuration names "
            'it: filter = "MODULE:NAME".'
        )
    ] = False  # fmt: skip
    core: Annotated[str, Option(
        "--core", "Code of the control step: plain Python, or compiled by numba, equal to the last bit; "
        "auto: compiled in real time where it has been compiled before.", choices=CORES
    )] = "auto"  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class OnboardOptions(Clocked, FlightOptions):
    recorder: Recorder = None
    lockstep: Lockstep = False


@dataclass(frozen=True, kw_only=True)
class WatchOptions:
    """Options to watch flights: their endpoints, and the kind of view."""

    connect: Annotated[tuple[str, ...], Option(
        "--connect",
        "Zenoh endpoint of an onboard process, as `sitl` prints it; repeatable; default: "
        f"{WATCHED}, or the endpoint of --zenoh-config.", "ENDPOINT"
    )] = ()  # fmt: skip
    zenoh_config: ZenohConfig = None
    namespaces: Annotated[tuple[str, ...], Option(
        "--namespace", "First part of all Zenoh keys of a vehicle; repeatable; default: cf1."
    )] = ()  # fmt: skip
    once: Annotated[
        bool, Option("--once", "Show the state once and end; exit status 1 if a vehicle sent no fresh data.")
    ] = False
    as_json: Annotated[
        bool, Option("--json", "Print one JSON object a line for each vehicle, two a second (--once: one).")
    ] = False
    timeout_s: Annotated[float, seconds("--timeout", "Longest wait of --once.", 0.1, 3600.0)] = 5.0
    view: View = None
    config_files: Annotated[tuple[Path, ...], Option(
        "--config", "Configuration of the flight, for the barrier and the pad in --view: a name (see "
        "`config`) or a file; repeatable: none, or one for each --namespace in the same order.",
        "NAME_OR_FILE", read=_configurations
    )] = ()  # fmt: skip
