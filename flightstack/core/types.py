"""Types of the stack: inputs and outputs of a controller step.

Everything is ENU, metres, seconds, radians. Times named ``*_s`` are on the stack's own clock unless the
name says otherwise. A value that is absent is ``None``, never zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, Self

Vec3 = tuple[float, float, float]
ZERO: Vec3 = (0.0, 0.0, 0.0)


class TextEnum(IntEnum):
    """Numbered members that are declared by their texts."""

    text: str

    def __new__(cls, text: str) -> Self:
        """Number them in their order."""
        member = int.__new__(cls, len(cls.__members__))
        member._value_, member.text = len(cls.__members__), text
        return member


class Phase(IntEnum):
    """Phases of a flight; the transitions are tables in ``mission/phases.py``."""

    WAIT = 0  # for inputs, on the ground or found in the air
    TAKEOFF = 1  # to where the landing begins
    APPROACH = 2  # to the target, filtered
    LAND = 3  # the same inside the descending cone over the pad; not the autopilot's landing
    TOUCHDOWN = 4  # straight down to contact, then motors off
    LANDED = 5  # the heartbeat reports that the motors are off after a touchdown
    HOLD = 6  # an input is lost
    CLIMB = 7  # above the target, which remains lost
    ABORT = 8  # ends the flight as ``AbortWay`` defines
    LEAVE = 9  # frees the pad for another vehicle: takes off again, flies clear, lands beside the target


class FilterStatus(IntEnum):
    """How the filtered velocity came about."""

    NOT_RUN = 0
    SOLVED = 1
    CLOSED_FORM = 2  # solver failed, or its result did not pass the check: the exact projection is the result
    INFEASIBLE = 3  # no velocity in the box meets the barrier; the one that raises h fastest is used
    REJECTED = 4  # inputs of the program are not finite: there is no result
    CROWDED = 5  # the neighbours' rows are relaxed by the least common slack; barrier and box are met
    OWN = 6  # result of a class with its own ``filter``: checked for the limits, not the barrier


class Request(IntEnum):
    """Mode that the stack requests of the vehicle, held as a level until the heartbeat shows it.

    The bridge turns a level into commands with bounded retries; the controller never sees MAVLink.
    """

    NONE = 0
    TAKEOFF = 1  # armed and climbing to the take-off height under the autopilot's own control
    EXTERNAL = 2  # armed and following our velocity set-points
    LAND = 3  # the autopilot's own landing, at its present place
    MOTORS_OFF = 4  # forced disarm


class Mode(IntEnum):
    """Flight mode that the vehicle reports, reduced to what the stack needs to know."""

    UNKNOWN = 0
    EXTERNAL = 1
    TAKEOFF = 2
    HOLD = 3
    LAND = 4  # the autopilot's own landing
    OTHER = 5


class Landed(IntEnum):
    """Landed state that the vehicle reports (MAV_LANDED_STATE); the verdict of a log judges by more."""

    UNKNOWN = 0
    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


class Charge(IntEnum):
    """State of the battery, by its voltage and the thrust reserve."""

    FIT = 0
    UNKNOWN = 1  # no voltage and no throttle was received recently
    TIRED = 2  # too low to begin a landing, or, in flight, to continue it


class Operator(IntEnum):
    """Commands of a person, above every phase."""

    NONE = 0
    ABORT = 1
    EMERGENCY_STOP = 2
    LAND = 3  # abort by the autopilot's own landing: the stack is about to end


class OwnState(NamedTuple):
    """The vehicle's own state estimate, as the link delivered it."""

    arrival_s: float
    source_time_s: float  # vehicle boot clock
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    yaw_rad: float  # heading of the nose, counter-clockwise from east

    @property
    def is_finite(self) -> bool:
        """Whether every number of it is one; a sum of numbers beyond any sense is none either."""
        (x, y, z), (vx, vy, vz) = self.position_enu_m, self.velocity_enu_m_s
        return math.isfinite(x + y + z + vx + vy + vz + self.yaw_rad + self.arrival_s)


class TargetSample(NamedTuple):
    """One odometry sample of the target; velocities already turned into the world frame."""

    arrival_s: float
    source_time_s: float  # header stamp of the sender, Unix time or simulated time
    frame_id: str
    child_frame_id: str
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    yaw_rad: float
    yaw_rate_rad_s: float
    position_sigma_m: float = 0.0  # standard deviation of x and y as the sender has it, the larger; 0: unsaid
    velocity_sigma_m_s: float = 0.0  # the same


@dataclass(frozen=True, slots=True)
class VehicleStatus:
    """Content of heartbeat and landed state."""

    arrival_s: float
    armed: bool
    mode: Mode
    landed: Landed
    ready_to_arm: bool

    @property
    def flies_by_setpoints(self) -> bool:
        """Whether the vehicle reports that it is in the air and follows our set-points."""
        return self.armed and self.mode is Mode.EXTERNAL and self.landed is not Landed.ON_GROUND


@dataclass(frozen=True, slots=True)
class Power:
    """Reported state of battery and motors; NaN for each number that is not reported."""

    arrival_s: float  # arrival of the newest message with one of them
    voltage_v: float  # voltage of the battery under the current load
    throttle: float  # mean of the motors' commands, 0 to 1
    cos_tilt: float  # cosine of the angle between the body's z axis and up


class Intent(IntEnum):
    """Intention of a fleet member, as announced to its neighbours."""

    STANDING = 0  # on the ground, or in the climb of its take-off: it does not yield
    WAITING = 1  # flies, without a right of way
    LANDING = 2  # flies to its pad with its right of way
    COMMITTED = 3  # over its pad: it does not yield, or will not soon
    CLEARING = 4  # holds, climbs or flies clear: others get out of its way
    DOWN = 5  # landed, or lands by its autopilot: it follows no set-points any more


class Neighbour(NamedTuple):
    """Message of a fleet member; times are on the receiver's stack clock."""

    id: int  # number of the vehicle, 1 to 250
    stamp_s: float  # time of the message, corrected for the difference of the clocks
    arrival_s: float  # its arrival
    position_enu_m: Vec3  # position at the stamp
    velocity_enu_m_s: Vec3  # measured
    wanted_enu_m_s: Vec3  # velocity that it is about to fly
    position_sigma_m: float = 0.0  # standard deviation of the position on each axis
    clock_bound_s: float = 0.0  # largest error of the stamp
    intent: Intent = Intent.STANDING  # announced intention
    claim_s: float = math.nan  # time of its claim of the right of way; NaN: it has no claim
    pad_position_enu_m: Vec3 | None = None  # landing spot; ``None``: not known yet
    pad_velocity_enu_m_s: Vec3 | None = None  # its velocity
    yields_to: tuple[int, ...] = ()  # vehicles to which it yields


class Inputs(NamedTuple):
    """All inputs of one tick: the newest message of each link, and the samples since the last tick."""

    own: OwnState | None = None
    status: VehicleStatus | None = None
    target_samples: tuple[TargetSample, ...] = ()
    operator: Operator = Operator.NONE
    power: Power | None = None  # requested only by a configuration with a table [reserve]
    neighbours: tuple[Neighbour, ...] = ()  # received since the last tick; only with a table [fleet]
