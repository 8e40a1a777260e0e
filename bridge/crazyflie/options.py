"""Options of the Crazyflie bridge."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from bridge.mocap.options import PoseOptions
from flightstack.common.options import Option
from flightstack.config import options as shared


@dataclass(frozen=True, kw_only=True)
class CrazyflieOptions(PoseOptions):
    """Where the bridge is plugged in, and what a person may choose of its rules."""

    uri: Annotated[str, Option(
        "--uri", "Crazyflie's address in cflib: radio://0/80/2M/E7E7E7E7E7, usb://0, udp://HOST:PORT.", "URI"
    )]  # fmt: skip
    url: shared.Url = "udpin:127.0.0.1:14580"
    peers: shared.Peers = ()
    speed_max_m_s: Annotated[float, Option(
        "--speed-max", "Highest speed of a set-point; a faster one is scaled down to it.", "M/S",
        span=(0.05, 5.0)
    )] = 1.0  # fmt: skip
    land_on_silence: Annotated[bool, Option(
        "--land-on-silence",
        "Land when the client's set-points stop for 1 s; without it the firmware stops the motors at 2 s."
    )] = False  # fmt: skip
    airframe: Annotated[str, Option(
        "--airframe",
        "Vehicle file whose mass and drag the firmware's filter gets (kalman.dragB_*), or 'none'.",
        "NAME|FILE"
    )] = "crazyflie20"  # fmt: skip
    restore: Annotated[
        bool, Option("--restore", "When the bridge ends, restore the firmware parameters that it changed.")
    ] = False
    system_id: shared.SystemId = 1
    cache: Annotated[Path | None, Option(
        "--cache", "Store the Crazyflie's tables there, for a faster second connection.", "FOLDER",
        path="folder"
    )] = None  # fmt: skip
    mocap_key: Annotated[str | None, Option(
        "--mocap",
        "Send it poses from there: a Zenoh key, ros2:/TOPIC or ros2dds:/TOPIC (docs/how_to/mocap.md).", "KEY"
    )] = None  # fmt: skip
