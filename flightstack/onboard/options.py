"""Options of the onboard process, and of watching it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from flightstack.common.options import Option
from flightstack.config import options as shared

# written out here, so that a command does not load the rooms that know them; a test compares them
TARGET_TYPES = ("odometry", "pose", "pose-covariance", "tf")
CORES = ("auto", "plain", "compiled")
WATCHED = "tcp/127.0.0.1:7448"  # endpoint of the onboard process in README and docs


@dataclass(frozen=True, kw_only=True)
class FlightOptions(shared.Signing, shared.Ros2, shared.Zenoh):
    """What it needs to fly any vehicle: vehicle, target, configuration, links."""

    vehicle_url: shared.VehicleUrl
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
        "X Y Z"
    )] = (0.0, 0.0, 0.0)  # fmt: skip
    config_file: Annotated[Path, shared.config()]
    namespace: Annotated[str | None, Option(
        "--namespace", "First part of all Zenoh keys and topics; default: cf1, or cf and the id of [fleet]."
    )] = None  # fmt: skip
    no_record: Annotated[bool, Option("--no-record", "Record nothing.")] = False
    duration_s: shared.Duration = None
    system_id: shared.SystemId = 1
    autopilot: shared.Autopilot = "auto"
    accept_release: shared.AcceptRelease = False
    core: Annotated[str, Option(
        "--core", "Code of the control step: plain Python, or compiled by numba, equal to the last bit; "
        "auto: compiled in real time where it has been compiled before.", choices=CORES
    )] = "auto"  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class OnboardOptions(FlightOptions):
    """All of them."""

    recorder: shared.Recorder = None
    lockstep: shared.Lockstep = False
    speed: shared.Speed = 1.0
    clock: shared.Clock = None
    shared_log: Annotated[bool, Option(
        "--shared-log", "The recorder writes several flights: names in the log begin with the namespace."
    )] = False  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class WatchOptions:
    """Where a flight is watched, and how it is shown."""

    connect: Annotated[tuple[str, ...], Option(
        "--connect",
        "Zenoh endpoint of the onboard process, as `sitl` prints it; repeatable; default: "
        f"{WATCHED}, or the endpoint of --zenoh-config.", "ENDPOINT"
    )] = ()  # fmt: skip
    zenoh_config: shared.ZenohConfig = None
    namespace: shared.Namespace = "cf1"
    once: Annotated[
        bool, Option("--once", "Show the state once and end; exit status 1 if no fresh data come.")
    ] = False
    as_json: Annotated[bool, shared.json("Print one JSON object a line, two a second (--once: one).")] = False
    timeout_s: Annotated[float, shared.seconds("--timeout", "Longest wait of --once.", 0.1, 3600.0)] = 5.0
    view: shared.View = None
    config_file: Annotated[
        Path | None, shared.config("Configuration of the flight, for the barrier and the pad in --view")
    ] = None
