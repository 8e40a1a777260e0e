"""Options of the simulator's processes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from flightstack.common.options import Option
from flightstack.config import options as shared


@dataclass(frozen=True, kw_only=True)
class VehicleOptions(shared.Signing, shared.Simulator):
    """Options of the process that simulates vehicles.

    Without Zenoh the deck stays where the scenario puts it.
    """

    url: shared.Url = "udpin:127.0.0.1:14580"
    peers: shared.Peers = ()
    parameters: Annotated[Mapping[str, float], Option(
        "--parameter", "Parameter of the autopilot, set before it starts; repeatable.", "NAME=VALUE",
        read=shared.numbers
    )] = field(default_factory=dict)  # fmt: skip
    lockstep: shared.Lockstep = False
    system_id: shared.SystemId = 1
    member: shared.OneMember = None
    leave_out: Annotated[tuple[int, ...], Option(
        "--leave-out", "Member of a team that is not simulated here, by its number; repeatable.", "N",
        span=(1, None)
    )] = ()  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class WorldOptions(shared.Ros2, VehicleOptions):
    """Options of the process that simulates vehicles and ground robots."""


@dataclass(frozen=True, kw_only=True)
class TargetOptions(shared.Ros2, shared.Clocked, shared.Simulator):
    """Options of the process that simulates the ground robot."""


@dataclass(frozen=True, kw_only=True)
class Px4SimOptions(shared.Simulator):
    """Options of the process that serves PX4's simulation link.

    Without Zenoh the deck stays where the scenario puts it.
    """

    tcp: Annotated[str, Option(
        "--tcp", "Where PX4 connects to; port 0 takes a free one.", "HOST:PORT"
    )] = "127.0.0.1:4560"  # fmt: skip
    speed: Annotated[float, Option(
        "--speed", "Simulated against real time; 0: as fast as PX4 answers.", span=(0.0, 100.0)
    )] = 1.0  # fmt: skip
    clock: Annotated[Path | None, Option(
        "--clock",
        "Write the simulated time there, for `target --clock` and `onboard --clock`, and wait for both.",
        "FILE", path="file"
    )] = None  # fmt: skip
    silent_max_s: Annotated[
        float, shared.seconds("--silent-max", "End when PX4 has not answered for S seconds.", 1.0)
    ] = 10.0
    once: Annotated[bool, Option(
        "--once", "End when the first PX4 disconnects, instead of waiting for the next."
    )] = False  # fmt: skip
    form: Annotated[str | None, Option(
        "--parameters",
        "Print PX4's parameters for the vehicle and end: shell lines, airframe file, or for PX4's console.",
        choices=("env", "airframe", "console")
    )] = None  # fmt: skip
    mocap: shared.Mocap = False
    member: shared.OneMember = None
    allow_unsigned: shared.AllowUnsigned = False


@dataclass(frozen=True, kw_only=True)
class ValidateOptions:
    """Options of the tool that compares the simulator with recorded flights."""

    folder: Annotated[Path, Option("DIR", exists=True, path="folder")]
    vehicle: Annotated[str, Option(
        "--vehicle", "Vehicle to simulate: a name of sim/plant or a file.", "NAME_OR_FILE"
    )] = "crazyflie21_room"  # fmt: skip
    seed: Annotated[int, Option("--seed", "Random seed.", span=(0, 2**31))] = 0
    workers: shared.Workers = None
    out: Annotated[Path | None, Option(
        "--out", "Folder for validate.json; default: a new folder in runs/.", path="folder"
    )] = None  # fmt: skip
    as_json: shared.AsJson = False
