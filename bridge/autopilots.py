"""What differs between autopilots, as one table; nothing else in the stack asks which one it talks to.

Sources: PX4 ``px4_custom_mode.h``, ``mavlink_receiver.cpp`` and ``offboardCheck.cpp`` (v1.16); ArduPilot
``ArduCopter/mode.h``, ``mode_guided.cpp`` and ``GCS_Mavlink.cpp`` (4.6); both measured in their own SITL.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from types import MappingProxyType

from flightstack.types import Landed, Mode, Request, VehicleStatus

# Set-point mask: ignore position (7) and acceleration (0x1C0), use velocity and yaw, ignore yaw rate (0x800).
# The one mask that PX4 and ArduPilot read alike; without a yaw PX4 drifts and ArduPilot turns its nose.
VELOCITY_AND_YAW = 2503
FORCE = 21196.0  # magic of a forced disarm, param2 of MAV_CMD_COMPONENT_ARM_DISARM

_DO_SET_MODE = 176
_NAV_LAND = 21
_NAV_TAKEOFF = 22
_ARM_DISARM = 400
_CUSTOM_MODE_ENABLED = 1  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
_AIRBORNE = frozenset({Landed.IN_AIR, Landed.TAKEOFF, Landed.LANDING})


class TakeoffAltitude(Enum):
    """What param7 of MAV_CMD_NAV_TAKEOFF means."""

    AMSL = "above mean sea level"
    ABOVE_HOME = "above home"


Params = tuple[float | None, ...]  # seven; None is "unset", sent as the profile's unset value


@dataclass(frozen=True, slots=True)
class Step:
    """One command on the way to what is wanted, and how the vehicle shows that it is no longer needed."""

    command: int  # MAV_CMD
    name: str
    params: Callable[[float], Params]  # of the take-off altitude in the profile's convention, m
    done: Callable[[VehicleStatus], bool]
    prestream: bool = False  # set-points must be streaming first
    blind: bool = False  # also sent to a vehicle that shows no status
    period_s: float = 0.5  # s between two tries
    tries: int = 10


@dataclass(frozen=True, slots=True)
class Profile:
    """One autopilot."""

    name: str
    autopilot: int  # MAV_AUTOPILOT in its heartbeat
    modes: Mapping[int, Mode]  # custom_mode of the heartbeat; what is not listed is OTHER
    sequences: Mapping[Request, tuple[Step, ...]]
    takeoff_altitude: TakeoffAltitude
    stream_in_takeoff: bool  # may set-points be sent while it takes off by itself
    prestream_s: float  # s of unbroken set-points before the mode is switched
    unset: float  # value of a parameter that is not given
    setpoint_mask: int = VELOCITY_AND_YAW
    frame: int = 1  # MAV_FRAME_LOCAL_NED

    def mode(self, custom_mode: int) -> Mode:
        """Reduce the heartbeat's custom_mode to what the stack needs."""
        return self.modes.get(custom_mode, Mode.OTHER)


def _armed(status: VehicleStatus) -> bool:
    return status.armed


def _disarmed(status: VehicleStatus) -> bool:
    return not status.armed


def _external(status: VehicleStatus) -> bool:
    return status.mode is Mode.EXTERNAL


def _flying(status: VehicleStatus) -> bool:
    # A vehicle in the air is never sent a take-off, whatever its mode: somebody else may be flying it.
    return status.armed and (status.mode is Mode.TAKEOFF or status.landed in _AIRBORNE)


def _external_or_flying(status: VehicleStatus) -> bool:
    return _external(status) or _flying(status)


def _landing(status: VehicleStatus) -> bool:
    # Disarmed in the air: one of the two is not true, and a vehicle that stands does not mind the command.
    return status.mode is Mode.LAND or not (status.armed or status.landed in _AIRBORNE)


def _fixed(*params: float | None) -> Callable[[float], Params]:
    return lambda _altitude_m: params


def _takeoff(altitude_m: float) -> Params:
    return (None, None, None, None, None, None, altitude_m)


def _px4_mode(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


_ARM = Step(_ARM_DISARM, "arm", _fixed(1.0, 0.0, None, None, None, None, None), _armed)
_LAND = Step(_NAV_LAND, "land", _fixed(None, None, None, None, None, None, None), _landing)
# The kill is tried for a minute: while it is wanted, giving up early helps nobody.
_KILL = Step(
    _ARM_DISARM,
    "force disarm",
    _fixed(0.0, FORCE, None, None, None, None, None),
    _disarmed,
    blind=True,
    tries=120,
)

PX4 = Profile(
    name="px4",
    autopilot=12,
    modes=MappingProxyType(
        {
            _px4_mode(6): Mode.EXTERNAL,  # OFFBOARD
            _px4_mode(4, 2): Mode.TAKEOFF,
            _px4_mode(4, 3): Mode.HOLD,  # LOITER
            _px4_mode(4, 6): Mode.LAND,
            _px4_mode(4, 9): Mode.LAND,  # PRECLAND
        }
    ),
    sequences=MappingProxyType(
        {
            Request.NONE: (),
            Request.TAKEOFF: (_ARM, Step(_NAV_TAKEOFF, "take off", _takeoff, _flying)),
            Request.EXTERNAL: (
                Step(
                    _DO_SET_MODE,
                    "switch to OFFBOARD",
                    _fixed(_CUSTOM_MODE_ENABLED, 6.0, 0.0, None, None, None, None),
                    _external,
                    prestream=True,
                ),
            ),
            Request.LAND: (_LAND,),
            Request.MOTORS_OFF: (_KILL,),
        }
    ),
    takeoff_altitude=TakeoffAltitude.AMSL,
    stream_in_takeoff=True,
    # s; PX4 wants one set-point younger than COM_OF_LOSS_T = 1.0 s at its next health check
    prestream_s=0.3,
    unset=math.nan,
)

OWN_SITL = replace(PX4, name="sitl")  # our simulated vehicle takes PX4's personality

ARDUPILOT = Profile(
    name="ardupilot",
    autopilot=3,
    modes=MappingProxyType(
        {
            4: Mode.EXTERNAL,  # GUIDED; its take-off cannot be told from it
            5: Mode.HOLD,  # LOITER
            9: Mode.LAND,
            16: Mode.HOLD,  # POSHOLD
            17: Mode.HOLD,  # BRAKE
        }
    ),
    sequences=MappingProxyType(
        {
            Request.NONE: (),
            Request.TAKEOFF: (
                # The pre-arm checks depend on the mode, so the mode comes first.
                Step(
                    _DO_SET_MODE,
                    "switch to GUIDED",
                    _fixed(_CUSTOM_MODE_ENABLED, 4.0, 0.0, None, None, None, None),
                    _external_or_flying,
                ),
                _ARM,
                # A repeated take-off starts its spool-up again, so more time between tries.
                Step(_NAV_TAKEOFF, "take off", _takeoff, _flying, period_s=4.0, tries=4),
            ),
            Request.EXTERNAL: (
                Step(
                    _DO_SET_MODE,
                    "switch to GUIDED",
                    _fixed(_CUSTOM_MODE_ENABLED, 4.0, 0.0, None, None, None, None),
                    _external,
                ),
            ),
            Request.LAND: (_LAND,),
            Request.MOTORS_OFF: (_KILL,),
        }
    ),
    takeoff_altitude=TakeoffAltitude.ABOVE_HOME,
    stream_in_takeoff=False,  # a velocity set-point silently ends the take-off (mode_guided.cpp)
    prestream_s=0.0,
    unset=0.0,
)

PROFILES: Mapping[str, Profile] = MappingProxyType({p.name: p for p in (OWN_SITL, PX4, ARDUPILOT)})


def profile(name: str) -> Profile:
    """Profile by name.

    Raises:
        ValueError: there is none of that name; the text lists those there are.
    """
    try:
        return PROFILES[name]
    except KeyError:
        raise ValueError(f"autopilot {name!r} is not known: allowed is {', '.join(PROFILES)}") from None
