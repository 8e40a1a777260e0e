"""Types of the stack: inputs and outputs of a controller step.

All values are in ENU, metres, seconds, radians. Times named ``*_s`` are on the stack's clock unless the name
says otherwise. A missing value is ``None``, never zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

Vec3 = tuple[float, float, float]
ZERO: Vec3 = (0.0, 0.0, 0.0)


class Phase(IntEnum):
    """Phases of a flight; the transitions are tables in ``mission/phases.py``."""

    WAIT = 0  # wait for inputs, on the ground or already in the air
    TAKEOFF = 1  # fly to the place where the landing starts
    APPROACH = 2  # fly to the target; the safety filter is active
    LAND = 3  # descend in the cone over the pad, filtered; not the autopilot's landing
    TOUCHDOWN = 4  # descend straight to contact, then switch the motors off
    LANDED = 5  # the heartbeat reports that the motors are off after a touchdown
    HOLD = 6  # wait with the filter's hold velocity, because an input is lost
    CLIMB = 7  # climb above the target, because the input remains lost
    ABORT = 8  # end the flight as ``AbortWay`` defines
    LEAVE = 9  # free the pad for another vehicle: take off again, fly clear, land beside the target

    __hash__ = int.__hash__  # faster than that of enumerations, for tables by phase


class FilterStatus(IntEnum):
    """Origin of the filtered velocity."""

    NOT_RUN = 0
    SOLVED = 1
    CLOSED_FORM = 2  # the solver failed, or its result was rejected: the exact projection is used
    INFEASIBLE = 3  # no velocity in the box satisfies the barrier; the one that raises h fastest is used
    REJECTED = 4  # an input of the program is not finite: there is no result
    CROWDED = 5  # neighbours' constraints are relaxed by the smallest common slack; barrier and box hold
    OWN = 6  # result of a user's method ``filter``: the gate checks limits, but not the barrier


class Request(IntEnum):
    """Mode that the stack requests from the vehicle in every tick until the heartbeat reports it.

    The bridge converts a request into MAVLink commands with a limited number of retries.
    """

    NONE = 0
    TAKEOFF = 1  # the vehicle is armed and climbs to the take-off height under the autopilot's control
    EXTERNAL = 2  # the vehicle is armed and follows the velocity set-points of this stack
    LAND = 3  # the autopilot lands the vehicle at its current position
    MOTORS_OFF = 4  # the vehicle is disarmed by force


class Mode(IntEnum):
    """Flight mode that the vehicle reports, reduced to the modes that the stack distinguishes."""

    UNKNOWN = 0
    EXTERNAL = 1
    TAKEOFF = 2
    HOLD = 3
    LAND = 4  # landing by the autopilot
    OTHER = 5


class Landed(IntEnum):
    """Landed state that the vehicle reports (MAV_LANDED_STATE)."""

    UNKNOWN = 0
    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


class Charge(IntEnum):
    """State of the battery, from its voltage and the thrust reserve."""

    FIT = 0
    UNKNOWN = 1  # no recent voltage or throttle was received
    TIRED = 2  # the battery is too low to start a landing or, in flight, to continue the landing


class Operator(IntEnum):
    """Commands of the operator, which take precedence over every phase."""

    NONE = 0
    ABORT = 1
    EMERGENCY_STOP = 2
    LAND = 3  # abort with a landing by the autopilot, because the stack is about to exit
    TIME_OVER = 4  # abort: the time of the flight is over

    __hash__ = int.__hash__  # faster than that of enumerations


class OwnState(NamedTuple):
    """Vehicle state estimate, as received over the link."""

    arrival_s: float
    source_time_s: float  # time on the vehicle's boot clock, s
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    yaw_rad: float  # heading of the nose, counter-clockwise from east, rad

    @property
    def is_finite(self) -> bool:
        """Whether all values are finite; a sum that overflows counts as not finite."""
        (x, y, z), (vx, vy, vz) = self.position_enu_m, self.velocity_enu_m_s
        return math.isfinite(x + y + z + vx + vy + vz + self.yaw_rad + self.arrival_s)


class TargetSample(NamedTuple):
    """One odometry sample of the target, with velocities rotated into the world frame."""

    arrival_s: float
    source_time_s: float  # header stamp of the sender, Unix time or simulated time, s
    frame_id: str
    child_frame_id: str
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    yaw_rad: float
    yaw_rate_rad_s: float
    position_sigma_m: float = 0.0  # larger one of the reported sigmas of x and y, m; 0: not reported
    velocity_sigma_m_s: float = 0.0  # larger one of the reported sigmas of vx and vy, m/s; 0: not reported


@dataclass(frozen=True, slots=True)
class VehicleStatus:
    """Content of the vehicle's heartbeat and landed state."""

    arrival_s: float
    armed: bool
    mode: Mode
    landed: Landed
    ready_to_arm: bool

    @property
    def flies_by_setpoints(self) -> bool:
        """Whether the vehicle reports that it is in the air and follows this stack's set-points."""
        return self.armed and self.mode is Mode.EXTERNAL and self.landed is not Landed.ON_GROUND


@dataclass(frozen=True, slots=True)
class Power:
    """Reported state of battery and motors; a number that is not reported is NaN."""

    arrival_s: float  # arrival time of the newest message with data of battery or motors, s
    voltage_v: float  # voltage of the battery under load, V
    throttle: float  # mean of the motor commands, 0 to 1
    cos_tilt: float  # cosine of the angle between the body's z axis and up


class Intent(IntEnum):
    """Intention of a fleet member, as announced to its neighbours."""

    STANDING = 0  # the member is on the ground, or in the take-off climb: it does not yield
    WAITING = 1  # the member flies without the right of way
    LANDING = 2  # the member flies to its pad with the right of way
    COMMITTED = 3  # the member is over its pad: it no longer yields, or will soon stop yielding
    CLEARING = 4  # the member holds, climbs or flies clear: other members avoid it
    DOWN = 5  # the member has landed, or its autopilot lands it: it follows no set-points


class MemberStatus(NamedTuple):
    """Message of a fleet member; all times are on the receiver's stack clock."""

    id: int  # id of the member, 1 to 250
    stamp_s: float  # time of the message, corrected for the difference of the clocks, s
    arrival_s: float  # arrival time of the message, s
    position_enu_m: Vec3  # position of the member at ``stamp_s``, m
    velocity_enu_m_s: Vec3  # measured velocity of the member, m/s
    wanted_enu_m_s: Vec3  # velocity command of the member, m/s
    position_sigma_m: float = 0.0  # standard deviation of the position on each axis, m
    clock_bound_s: float = 0.0  # upper limit of the stamp's error, s
    intent: Intent = Intent.STANDING  # announced intention of the member
    claim_s: float = math.nan  # time at which the member claimed the right of way, s; NaN: no claim
    pad_position_enu_m: Vec3 | None = None  # position of the member's landing spot, m; None: unknown
    pad_velocity_enu_m_s: Vec3 | None = None  # velocity of the landing spot, m/s; None: unknown
    yields_to: tuple[int, ...] = ()  # ids of the members to which this member yields


class Inputs(NamedTuple):
    """All inputs of one tick: the newest message of each link, and the samples since the last tick."""

    own: OwnState | None = None
    status: VehicleStatus | None = None
    target_samples: tuple[TargetSample, ...] = ()
    operator: Operator = Operator.NONE
    power: Power | None = None  # received only with a table [reserve] in the configuration
    neighbours: tuple[MemberStatus, ...] = ()  # messages since the last tick; only with a table [fleet]
