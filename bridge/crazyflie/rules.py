"""Limits and options of the Crazyflie bridge, and the firmware parameters that the bridge writes.

In flight the firmware's Kalman filter uses only the accelerometer's body z axis and so needs the rotor drag:
with ``kalman.dragB_*`` at the default 0 the filter's velocity is 16 % too high (measured on firmware 2026.08,
drag 0.46 1/s), and at a commanded 0.30 m/s the vehicle flies 0.24 m/s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from bridge.crazyflie.packets import SetParam
from bridge.mocap.checks import PoseOptions
from flightstack.common.options import Option
from flightstack.config import options as shared
from flightstack.core.types import Vec3

SILENT_S = 0.5  # time without a state after which a warning is sent, s; the flight stack's limit is 0.2 s
LOST_S = 1.0  # time without a state after which no heartbeat is sent, s
RECONNECT_S = 3.0  # time without a state until the link is reopened, s; the firmware stops the motors earlier
BLIND_SPARE_S, BLIND_SHARE = 1.0, 1.2  # time of a blind landing: 1.0 s plus 1.2 times height / descent rate
POSE_AGE_MAX_S = 0.5  # maximum age of an external pose, s; with an older pose the position is invalid
REARM_S = 0.4  # maximum disarmed time that is ignored, s: some firmware disarms for 0.12 s every 30 s
CLIENT_SILENT_S = 3.0  # time without a heartbeat of any client after which the vehicle lands, s
STREAM_S = 1.0  # time without set-points after which another client may take control, s; PX4: COM_OF_LOSS_T
LEVEL_OUT_S = 0.5  # time without set-points until the firmware levels the vehicle, s (supervisor.c)
OWN_PERIOD_S = 0.02  # time between two set-points of the bridge's own modes, s
STANDING_S = 1.0  # time of a descent command without descent after which the vehicle counts as standing, s
SPEED_MAX_M_S = 1.0  # maximum speed of a forwarded set-point, m/s
HEIGHT_RANGE_M = (0.1, 3.0)  # allowed take-off height above home, m
IDLE_S = 10.0  # time armed on the ground after which the bridge disarms, s; PX4: COM_DISARM_PRFLT
KILL_KEPT_S = 10.0  # maximum time that a kill without a link remains pending, s
TAKEOFF_MAX_S = 15.0  # time-out of a take-off, s; a climb of 3 m takes 8 s
TAKEOFF_M = 0.5  # default take-off height above home, m


@dataclass(frozen=True, kw_only=True)
class CrazyflieOptions(PoseOptions):
    """Options of the Crazyflie bridge: connection, limits and firmware settings."""

    uri: Annotated[str, Option(
        "--uri", "Crazyflie's address in cflib: radio://0/80/2M/E7E7E7E7E7, usb://0, udp://HOST:PORT.", "URI"
    )]  # fmt: skip
    url: shared.Url = "udpin:127.0.0.1:14580"
    peers: shared.Peers = ()
    speed_max_m_s: Annotated[float, Option(
        "--speed-max", "Highest speed of a set-point; a faster one is scaled down to it.", "M/S",
        span=(0.05, 5.0)
    )] = SPEED_MAX_M_S  # fmt: skip
    land_on_silence: Annotated[bool, Option(
        "--land-on-silence",
        "Land when the client's set-points stop for 1 s; without it the firmware stops the motors at 2 s."
    )] = False  # fmt: skip
    airframe: Annotated[str, Option(
        "--airframe",
        "Vehicle file with mass and drag for the firmware's filter (kalman.dragB_*), or 'none'.",
        "NAME|FILE"
    )] = "crazyflie20"  # fmt: skip
    restore: Annotated[
        bool, Option("--restore", "When the bridge ends, restore the firmware parameters that it changed.")
    ] = False
    system_id: shared.SystemId = 1
    cache: Annotated[Path | None, Option(
        "--cache", "Folder for the Crazyflie's tables of contents; later connections are faster.", "FOLDER",
        path="folder"
    )] = None  # fmt: skip
    mocap_key: Annotated[str | None, Option(
        "--mocap",
        "Source of external poses: a Zenoh key, ros2:/TOPIC or ros2dds:/TOPIC (docs/how_to/mocap.md).", "KEY"
    )] = None  # fmt: skip


ESTIMATOR, KALMAN = "stabilizer.estimator", "2"
DRAG = ("kalman.dragB_x", "kalman.dragB_y", "kalman.dragB_z")  # rotor drag along the body axes, 1/s
UNKNOWN_DRAG = "Firmware has no kalman.dragB_x: its velocity is too high in flight"
ECHO_MAX_S = 1.0  # time without an echo after which a restored parameter counts as lost, s
_SAME = 1e-6  # relative tolerance of equal parameters; the firmware's floats have 24 significant bits


class Settings:
    """Firmware parameters to write, and their previous values; a restart of the firmware resets all."""

    def __init__(self, drag_1_s: Vec3 | None, *, restore: bool) -> None:
        """``drag_1_s``: rotor drag, 1/s, None: not written; ``restore``: write old values at the end."""
        self._drag_1_s, self._restore = drag_1_s, restore
        self._found: dict[str, float] = {}  # parameter values before the first write, by name
        self.open: set[str] = set()  # restored parameters that the firmware has not confirmed yet

    def connected(self, params: Mapping[str, str]) -> tuple[list[SetParam], str | None]:
        """Return the packets that set up a firmware with these parameters, and a warning."""
        drag_1_s, packets = self._drag_1_s, list[SetParam]()
        wanted = {ESTIMATOR: float(KALMAN), **(dict(zip(DRAG, drag_1_s, strict=True)) if drag_1_s else {})}
        for name, value in wanted.items():
            if name in params and not math.isclose(float(params[name]), value, rel_tol=_SAME, abs_tol=_SAME):
                self._found.setdefault(name, float(params[name]))
                packets.append(SetParam(name, value))
        return packets, None if drag_1_s is None or DRAG[0] in params else UNKNOWN_DRAG

    def leave(self) -> list[SetParam]:
        """Return the packets that restore the previous values; only the first call returns any."""
        found, self._found = self._found if self._restore else {}, {}
        self.open |= set(found)
        return [SetParam(name, value) for name, value in found.items()]
