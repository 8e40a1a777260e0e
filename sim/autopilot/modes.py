"""Flight modes of the simulated autopilot with PX4's codes, and what it needs to know of its vehicle."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType
from typing import NamedTuple, Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flightstack.core.types import Vec3


class EstimateLike(Protocol):
    """What the on-board estimator believes."""

    @property
    def position_enu_m(self) -> Vec3:
        """Position of the centre of mass."""

    @property
    def velocity_enu_m_s(self) -> Vec3:
        """Velocity."""

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """Attitude w, x, y, z of FLU in ENU."""

    @property
    def angular_velocity_flu_rad_s(self) -> Vec3:
        """Angular velocity in body axes."""

    @property
    def valid(self) -> bool:
        """Whether the numbers may be flown by."""


class VehicleLike(Protocol):
    """The vehicle as its autopilot sees it; ``sim.vehicle.vehicle.VehicleSim`` is one."""

    @property
    def battery_v(self) -> float:
        """Voltage of the one cell."""

    @property
    def armed(self) -> bool:
        """Motors may run."""

    @property
    def locked(self) -> bool:
        """The firmware's supervisor has locked the motors until a restart."""

    @property
    def on_pad(self) -> bool:
        """In contact with the top of the pad."""

    @property
    def on_ground(self) -> bool:
        """In contact with the ground."""

    @property
    def landed(self) -> bool:
        """At rest on something."""

    @property
    def motor_commands(self) -> tuple[float, float, float, float]:
        """Commands of the motors M1 to M4, 0 to 1 of the highest speed there is now."""

    def arm(self) -> str | None:
        """Arm; the reason if refused."""

    def disarm(self, force: bool) -> str | None:
        """Disarm; the reason if refused."""

    def set_velocity(self, velocity_enu_m_s: Vec3, yaw_rad: float) -> None:
        """Hand a velocity set-point to the firmware."""

    def stop_setpoint(self) -> None:
        """Tell the firmware that no set-point holds any more."""

    def estimate(self) -> EstimateLike:
        """Return what the estimator believes now."""

    def reboot(self) -> str | None:
        """Restart the firmware, which also unlocks it; the reason if refused."""

    def inject_failure(self, unit: int, kind: int, instance: int) -> str | None:
        """Let something fail: numbers of FAILURE_UNIT and FAILURE_TYPE, instance 0 for all.

        Returns:
            None when it took effect, else why not.
        """


class FlightMode(Enum):
    """What the autopilot can do."""

    HOLD = "hold"
    TAKEOFF = "take-off"
    LAND = "land"
    RETURN = "return"
    OFFBOARD = "offboard"


class Code(NamedTuple):
    """A mode on the wire."""

    main: int  # PX4_CUSTOM_MAIN_MODE (px4_custom_mode.h)
    sub: int  # PX4_CUSTOM_SUB_MODE_AUTO
    base: int  # MAV_MODE_FLAG of a disarmed vehicle

    @property
    def custom_mode(self) -> int:
        """``custom_mode`` of HEARTBEAT and SET_MODE."""
        return self.main << 16 | self.sub << 24


_AUTO = 1 | 4 | 8 | 16  # custom, auto, guided, stabilised (PX4 streams/HEARTBEAT.hpp)
_EXTERNAL = 1 | 16  # custom, stabilised: PX4's offboard is not an auto mode

CODES: Mapping[FlightMode, Code] = MappingProxyType(
    {
        FlightMode.HOLD: Code(4, 3, _AUTO),  # AUTO.LOITER
        FlightMode.TAKEOFF: Code(4, 2, _AUTO),
        FlightMode.LAND: Code(4, 6, _AUTO),
        FlightMode.RETURN: Code(4, 5, _AUTO),  # AUTO.RTL
        FlightMode.OFFBOARD: Code(6, 0, _EXTERNAL),
    }
)
_BY_CODE = {(code.main, code.sub): mode for mode, code in CODES.items()}

# PX4's other modes, and why there is none here.
_STICKS = "no stick input"
_NOT_HERE: Mapping[tuple[int, int], str] = MappingProxyType(
    {
        (1, 0): f"manual: {_STICKS}",
        (2, 0): f"altitude: {_STICKS}",
        (3, 0): f"position: {_STICKS}",
        (5, 0): f"acro: {_STICKS}",
        (7, 0): f"stabilized: {_STICKS}",
        (8, 0): f"rattitude: {_STICKS}",
        (10, 0): "termination: use command 185",
        (4, 1): "ready: use hold",
        (4, 4): "mission: no missions",
        (4, 8): "follow: not supported",
        (4, 9): "precision land: not supported",
    }
)

# What EXTENDED_SYS_STATE says in the air; on the ground it is always ON_GROUND.
AIRBORNE_STATE: Mapping[FlightMode, int] = MappingProxyType(
    {
        FlightMode.HOLD: dialect.MAV_LANDED_STATE_IN_AIR,
        FlightMode.TAKEOFF: dialect.MAV_LANDED_STATE_TAKEOFF,
        FlightMode.LAND: dialect.MAV_LANDED_STATE_LANDING,
        FlightMode.RETURN: dialect.MAV_LANDED_STATE_IN_AIR,
        FlightMode.OFFBOARD: dialect.MAV_LANDED_STATE_IN_AIR,
    }
)


def mode_from_code(main: int, sub: int) -> FlightMode | None:
    """Mode of a pair of PX4 codes, None if the autopilot has no such mode."""
    return _BY_CODE.get((main, 0 if main == CODES[FlightMode.OFFBOARD].main else sub))


def why_no_mode(main: int, sub: int) -> str:
    """Why a pair of codes is no mode of this autopilot."""
    reason = _NOT_HERE.get((main, sub if main == CODES[FlightMode.HOLD].main else 0))
    return f"Mode refused: {reason}" if reason else f"Mode {main}/{sub} refused: there is none"


def codes(custom_mode: int) -> tuple[int, int]:
    """Main and sub code of a whole ``custom_mode``."""
    return custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
