"""Times and limits of the Crazyflie bridge, and what a person may choose of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from bridge.mocap.options import PoseOptions
from flightstack.common.options import Option
from flightstack.config import options as shared
from flightstack.core.types import Vec3

SILENT_S = 0.5  # s without state until it is reported; the flight stack calls its state lost after 0.2 s
LOST_S = 1.0  # s without state until no heartbeat is sent
RECONNECT_S = 3.0  # s without state until the link is opened anew; the firmware has stopped by then
BLIND_SPARE_S, BLIND_SHARE = 1.0, 1.2  # s, and factor of height / descent speed: longest blind landing
POSE_AGE_MAX_S = 0.5  # s without a pose from outside until the position is not good, at any variance
REARM_S = 0.4  # s; firmware that arms itself is disarmed for 0.12 s every 30 s
CLIENT_SILENT_S = 3.0  # s without a heartbeat of any client until it lands
STREAM_S = 1.0  # s without set-points until control is free and OFFBOARD has no stream; PX4's COM_OF_LOSS_T
LEVEL_OUT_S = 0.5  # s after which the firmware's watchdog acts (supervisor.c)
OWN_PERIOD_S = 0.02  # s between two set-points of the bridge's own modes
STANDING_S = 1.0  # s without following a descent command until it counts as standing
SPEED_MAX_M_S = 1.0  # m/s, longest velocity passed on
HEIGHT_RANGE_M = (0.1, 3.0)  # m above home of a take-off
IDLE_S = 10.0  # s armed on the ground until it is disarmed; PX4's COM_DISARM_PRFLT
KILL_KEPT_S = 10.0  # s that a kill without a link stays pending until the link is back
TAKEOFF_MAX_S = 15.0  # s until a take-off is given up; 3 m take 8
TAKEOFF_M = 0.5  # m above home, of a take-off without a height


@dataclass(frozen=True, slots=True)
class Rules:
    speed_max_m_s: float = SPEED_MAX_M_S
    land_on_silence: bool = False  # land when set-points stop, instead of leaving it to the firmware
    mocap: bool = False  # poses come from outside
    drag_1_s: Vec3 | None = None  # for the firmware's filter, body axes; None leaves what it has
    restore: bool = False  # the firmware's parameters, when the bridge ends


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
