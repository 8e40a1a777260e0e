"""Table of the supported autopilots, and their detection from HEARTBEAT and AUTOPILOT_VERSION.

A new autopilot needs a ``Profile`` in this module; option, detection and pre-flight check then use it. No
other part of the stack distinguishes autopilots. This project's vehicles use PX4's commands and
MAV_AUTOPILOT. The simulated vehicle has part of PX4's parameters; the Crazyflie has none that are checked.
Sources: PX4 ``px4_custom_mode.h``, ``mavlink_receiver.cpp`` and ``offboardCheck.cpp`` (v1.16); ArduPilot
``ArduCopter/mode.h``, ``mode_guided.cpp`` and ``GCS_Mavlink.cpp`` (4.6); both were measured in SITL.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from bridge.mavlink.server.profile import FORCE, PX4_CODES, Code, FlightMode
from flightstack.core.types import Landed, Mode, Request, VehicleStatus


@dataclass(frozen=True, slots=True)
class Step:
    """A command of a sequence, and the status that makes it unnecessary."""

    command: int  # MAV_CMD number
    name: str
    # first parameters; the others are sent as the profile's ``unset`` value, except the height of a take-off
    params: tuple[float, ...]
    done: Callable[[VehicleStatus], bool]
    prestream: bool = False  # whether the command requires streaming set-points
    blind: bool = False  # whether the command is also sent before any heartbeat and after rejections
    period_s: float = 0.5  # time between two tries, s
    tries: int = 10


@dataclass(frozen=True, slots=True)
class Profile:
    name: str
    title: str
    autopilot: int  # MAV_AUTOPILOT in the heartbeat
    modes: Mapping[int, Mode]  # mode by custom_mode of the heartbeat; other values mean OTHER
    sequences: Mapping[Request, tuple[Step, ...]]
    # Whether param7 of NAV_TAKEOFF is a height above home: then the vehicle's height above home is added to
    # the climb. If not, param7 is a height above sea level, and the height of home is added.
    takeoff_above_home: bool
    # Whether set-points may be sent during the vehicle's take-off. If not, a set-point ends the take-off, and
    # the external mode is a take-off until the first set-point.
    stream_in_takeoff: bool
    prestream_s: float  # duration of the set-point stream before the mode change, s
    unset: float  # value of an omitted command parameter
    # whether PARAM_VALUE's float field carries the bytes of an integer parameter (capability
    # PARAM_ENCODE_BYTEWISE); if not, the field carries the integer converted to a float
    bytewise: bool
    needs_origin: bool  # whether a position without satellite positioning requires SET_GPS_GLOBAL_ORIGIN
    pose_message: int  # id of the MAVLink message for poses of a motion capture
    pose_settings: str  # parameters that the operator sets for these poses, as text
    rules: str | None  # name of the file of pre-flight rules in preflight/; None: no parameters to check
    prepare: tuple[Step, ...] = ()  # steps on the ground before the first request
    asked_hz: Mapping[int, float] = field(default_factory=dict)  # further requested rates, Hz, by message id
    # mark of this project's vehicles in AUTOPILOT_VERSION.flight_custom_version, where other autopilots have
    # digits of their revision; empty: no mark
    mark: bytes = b""

    def mode(self, custom_mode: int) -> Mode:
        return self.modes.get(custom_mode, Mode.OTHER)


AUTO = "auto"  # the heartbeat selects the profile

_DO_SET_MODE = 176
_NAV_LAND = 21
_NAV_TAKEOFF = 22
_ARM_DISARM = 400
_CUSTOM_MODE_ENABLED = 1  # flag MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
_AIRBORNE = frozenset({Landed.IN_AIR, Landed.TAKEOFF, Landed.LANDING})
# MAV_TYPE of vehicles that hover and follow velocity set-points on all axes.
_MULTIROTORS = tuple(
    getattr(dialect, f"MAV_TYPE_{name}")
    for name in ("QUADROTOR", "COAXIAL", "HEXAROTOR", "OCTOROTOR", "TRICOPTER", "DODECAROTOR", "DECAROTOR")
)


# A vehicle in the air gets no take-off command and no change of mode for a take-off: another client may
# control it.


def _airborne(status: VehicleStatus) -> bool:
    return status.armed and status.landed in _AIRBORNE


def _guided_or_airborne(status: VehicleStatus) -> bool:
    return status.mode in (Mode.EXTERNAL, Mode.TAKEOFF) or _airborne(status)


def _landing(status: VehicleStatus) -> bool:
    # "Disarmed" and "in the air" contradict each other: the step then counts as not done, so the landing
    # command is sent. This command is harmless if the vehicle stands on the ground.
    return status.mode is Mode.LAND or not (status.armed or status.landed in _AIRBORNE)


def _may_arm_in_its_mode(status: VehicleStatus) -> bool:
    # Without set-points PX4's checks fail in OFFBOARD (the mode after a landing by set-points) and in LAND.
    standing = status.landed is Landed.ON_GROUND and not status.armed
    return not (standing and status.mode in (Mode.EXTERNAL, Mode.LAND))


def _to(mode: FlightMode) -> tuple[float, ...]:
    return (_CUSTOM_MODE_ENABLED, PX4_CODES[mode].main, PX4_CODES[mode].sub)


_ARM = Step(_ARM_DISARM, "arm", (1.0, 0.0), attrgetter("armed"))
_LAND = Step(_NAV_LAND, "land", (), _landing)
_OFFBOARD = Step(
    _DO_SET_MODE,
    "switch to OFFBOARD",
    _to(FlightMode.OFFBOARD),
    lambda s: s.mode is Mode.EXTERNAL,
    prestream=True,
)
_HOLD = Step(
    _DO_SET_MODE, "switch to HOLD", _to(FlightMode.HOLD), _may_arm_in_its_mode, period_s=1.0, tries=3600
)
_OWN_TAKEOFF = (
    _ARM,
    Step(_NAV_TAKEOFF, "take off", (), lambda s: _airborne(s) or (s.armed and s.mode is Mode.TAKEOFF)),
)
# A forced disarm is repeated for a minute: 120 tries, 0.5 s apart.
_KILL = Step(_ARM_DISARM, "force disarm", (0.0, FORCE), lambda s: not s.armed, blind=True, tries=120)
PX4 = Profile(
    name="px4",
    title="PX4, OFFBOARD",
    autopilot=dialect.MAV_AUTOPILOT_PX4,
    modes={
        PX4_CODES[FlightMode.OFFBOARD].custom_mode: Mode.EXTERNAL,
        PX4_CODES[FlightMode.TAKEOFF].custom_mode: Mode.TAKEOFF,
        PX4_CODES[FlightMode.HOLD].custom_mode: Mode.HOLD,
        PX4_CODES[FlightMode.LAND].custom_mode: Mode.LAND,
        Code(4, 9, 0).custom_mode: Mode.LAND,  # PX4's name: PRECLAND
    },
    sequences={
        Request.NONE: (),
        # The take-off uses set-points: COM_OBL_RC_ACT acts only in OFFBOARD, so in the climb of AUTO.TAKEOFF
        # a crash of the companion would leave the vehicle hovering.
        Request.TAKEOFF: (replace(_OFFBOARD, done=lambda s: s.mode is Mode.EXTERNAL or _airborne(s)), _ARM),
        Request.EXTERNAL: (_OFFBOARD,),
        Request.LAND: (_LAND,),
        Request.MOTORS_OFF: (_KILL,),
    },
    takeoff_above_home=False,
    stream_in_takeoff=True,
    # PX4's next health check needs a set-point younger than COM_OF_LOSS_T = 1.0 s
    prestream_s=0.3,
    unset=math.nan,
    bytewise=True,
    needs_origin=False,
    pose_message=dialect.MAVLINK_MSG_ID_ODOMETRY,
    pose_settings="EKF2_EV_CTRL 11, EKF2_HGT_REF 3, EKF2_GPS_CTRL 0, EKF2_MAG_TYPE 5",
    rules="px4",
    prepare=(_HOLD,),
)

OWN_SITL = replace(  # the simulated vehicle imitates PX4
    PX4,
    name="sitl",
    title="own simulator, OFFBOARD",
    # short, because the vehicle checks each set-point on arrival and a deck may rise during this time
    prestream_s=0.05,
    mark=b"cfstack\x00",
)

CRAZYFLIE = replace(
    PX4,
    name="crazyflie",
    title="Crazyflie behind the bridge, OFFBOARD",
    # If the companion crashes during the bridge's own take-off, the bridge lands the vehicle; in OFFBOARD the
    # motors would stop after 2 s.
    sequences={**PX4.sequences, Request.TAKEOFF: _OWN_TAKEOFF},
    prepare=(),  # arming does not depend on the mode
    rules=None,
    mark=b"cfbridge",
)

_GUIDED = Step(
    _DO_SET_MODE, "switch to GUIDED", (_CUSTOM_MODE_ENABLED, 4.0, 0.0), lambda s: s.mode is Mode.EXTERNAL
)
ARDUPILOT = Profile(
    name="ardupilot",
    title="ArduCopter, GUIDED",
    autopilot=dialect.MAV_AUTOPILOT_ARDUPILOTMEGA,
    modes={
        4: Mode.EXTERNAL,  # ArduPilot's name: GUIDED; also the mode of its take-off
        5: Mode.HOLD,  # ArduPilot's name: LOITER
        9: Mode.LAND,
        16: Mode.HOLD,  # ArduPilot's name: POSHOLD
        17: Mode.HOLD,  # ArduPilot's name: BRAKE
    },
    sequences={
        Request.NONE: (),
        Request.TAKEOFF: (
            replace(_GUIDED, done=_guided_or_airborne),
            _ARM,
            # A repeated take-off restarts the spool-up of the motors, so the time between tries is longer.
            Step(_NAV_TAKEOFF, "take off", (), _airborne, period_s=4.0, tries=4),
        ),
        Request.EXTERNAL: (_GUIDED,),
        Request.LAND: (_LAND,),
        Request.MOTORS_OFF: (_KILL,),
    },
    takeoff_above_home=True,
    stream_in_takeoff=False,  # a velocity set-point silently ends the take-off (mode_guided.cpp)
    prestream_s=0.0,
    unset=0.0,
    bytewise=False,
    needs_origin=True,
    pose_message=dialect.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE,
    pose_settings="VISO_TYPE 1, GPS1_TYPE 0, EK3_SRC1_POSXY, EK3_SRC1_POSZ and EK3_SRC1_YAW 6",
    rules="ardupilot",
    # The pre-arm bit depends on the mode, so the mode is set first. ArduPilot acknowledges but drops a mode
    # change in the first seconds after boot, so the step repeats during the whole wait.
    prepare=(replace(_GUIDED, done=lambda s: s.armed or _guided_or_airborne(s), period_s=1.0, tries=3600),),
    asked_hz={dialect.MAVLINK_MSG_ID_SYS_STATUS: 2.0},  # requested because all SRx_ rates may be 0
)

# all profiles of this module by name, in the order of their definition
PROFILES: Mapping[str, Profile] = {p.name: p for p in list(globals().values()) if isinstance(p, Profile)}
CHOICES = (AUTO, *PROFILES)


def profile(name: str) -> Profile | None:
    """Return the profile of a name, None for ``auto``. Raises ValueError: unknown name."""
    if name == AUTO:
        return None
    try:
        return PROFILES[name]
    except KeyError:
        raise ValueError(f"autopilot {name!r} is not known: allowed is {', '.join(CHOICES)}") from None


def found(autopilot: int) -> Profile | None:
    """Return the first profile with this MAV_AUTOPILOT; the others are variants with the same commands."""
    return next((each for each in PROFILES.values() if each.autopilot == autopilot), None)


def refusal(autopilot: int, type_: int, chosen: Profile | None) -> str | None:
    """Return why MAV_AUTOPILOT or MAV_TYPE does not fit the chosen profile (None: auto), or None."""
    if chosen is None and found(autopilot) is None:
        firsts = [each for each in PROFILES.values() if found(each.autopilot) is each]
        known = ", ".join(f"{each.title} ({each.autopilot})" for each in firsts)
        name = named("MAV_AUTOPILOT", autopilot)
        return f"unsupported autopilot {name} in the vehicle's heartbeat; supported are {known}"
    if chosen is not None and autopilot != chosen.autopilot:
        return (
            f"the vehicle's heartbeat has autopilot {autopilot}, but profile '{chosen.name}' is for "
            f"autopilot {chosen.autopilot}; choose the profile that fits, or auto"
        )
    if type_ not in _MULTIROTORS:
        types = ", ".join(named("MAV_TYPE", number) for number in _MULTIROTORS)
        name = named("MAV_TYPE", type_)
        return f"unsupported vehicle type {name} in the vehicle's heartbeat; supported are {types}"
    return None


def named(enum: str, number: int) -> str:
    """Return name and number of an entry of a MAVLink enum; only the number of an unknown entry."""
    entry = dialect.enums[enum].get(number)
    return f"{entry.name.removeprefix(f'{enum}_')} ({number})" if entry is not None else str(number)


def marked(message: Message) -> Profile | None:
    """Return the profile of a vehicle of this project from its AUTOPILOT_VERSION; None: another vehicle."""
    mark = bytes(message.flight_custom_version)
    return next((each for each in PROFILES.values() if each.mark and each.mark == mark), None)
