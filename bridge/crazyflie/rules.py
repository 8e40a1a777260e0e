"""Times and limits of the Crazyflie bridge, and what a person may choose of them."""

from __future__ import annotations

from dataclasses import dataclass

from flightstack.core.types import Vec3

SILENT_S = 0.5  # s without state: said; the flight stack calls its own state lost after 0.2 s
LOST_S = 1.0  # s without state: no heartbeat any more
RECONNECT_S = 3.0  # s without state: the firmware has stopped by itself; the link is opened anew
BLIND_SPARE_S, BLIND_SHARE = 1.0, 1.2  # s, besides so many times the height over the descent's speed
POSE_AGE_MAX_S = 0.5  # s without a pose from outside: the position is not known, whatever the variance is
REARM_S = 0.4  # s; firmware that arms itself does so anew every 30 s, for 0.12 s
CLIENT_SILENT_S = 3.0  # s without any client's heartbeat
STREAM_S = 1.0  # s without set-points until control is free and OFFBOARD has no stream; PX4's COM_OF_LOSS_T
LEVEL_OUT_S = 0.5  # s after which the firmware's watchdog acts (supervisor.c)
OWN_PERIOD_S = 0.02  # s between two set-points of the bridge's own modes
STANDING_S = 1.0  # s of being told to sink without sinking
SPEED_MAX_M_S = 1.0  # m/s, longest velocity passed on
HEIGHT_RANGE_M = (0.1, 3.0)  # m above home of a take-off
IDLE_S = 10.0  # s armed on the ground; PX4's COM_DISARM_PRFLT
KILL_KEPT_S = 10.0  # s; a kill without a link is done when there is one again
TAKEOFF_MAX_S = 15.0  # s; 3 m take 8: longer, and something holds it
TAKEOFF_M = 0.5  # m above home, of a take-off without a height


@dataclass(frozen=True, slots=True)
class Rules:
    """What a person chose."""

    speed_max_m_s: float = SPEED_MAX_M_S
    land_on_silence: bool = False  # land when set-points stop, instead of leaving it to the firmware
    mocap: bool = False  # poses come from outside
    drag_1_s: Vec3 | None = None  # for the firmware's filter, body axes; None leaves what it has
    restore: bool = False  # the firmware's parameters, when the bridge ends
