"""State that the controller stores between ticks; all other values are computed in each tick.

All fields are plain values that ``state_text`` can write to a log. A log contains the names of
these classes and fields; a replay compares only states with the same names.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from math import inf, nan
from typing import Annotated, Any

from flightstack.core.numeric import UNSEEN
from flightstack.core.types import ZERO, MemberStatus, OwnState, Phase, TargetSample, Vec3


class AbortWay(IntEnum):
    """Kind of abort: how phase ABORT ends the flight."""

    NONE = 0
    MOTORS_OFF = 1  # motors off immediately: emergency stop
    HANDS_OFF = 2  # the stack sends no commands: another client controls the vehicle, or the motors are off
    LAND_HERE = 3  # landing by the autopilot: the vehicle cannot or must not fly clear
    FLY_CLEAR = 4  # climb, fly clear of the target, then land


@dataclass(slots=True)
class Memory:
    """State of the mission's state machine and of the velocity commands."""

    phase: Phase = Phase.WAIT
    phase_since_s: float = 0.0  # time at which the phase started, s
    started_s: float = inf  # time at which the landing started, s
    good_since_s: float = inf  # time since which all inputs are usable, s
    contact_since_s: float = inf  # time since which the vehicle is on the pad and does not sink, s
    stopped_since_s: float = inf  # time since which the vehicle does not follow a descent command, s
    contact: bool = False  # whether the vehicle stands on the pad
    own_ok_s: float = -inf  # time of the last usable vehicle state, s
    was_armed: bool = False  # whether the vehicle was armed earlier in this flight
    was_external: bool = False  # whether the vehicle followed set-points earlier in this flight
    climbed: bool = False  # whether the take-off climb is over
    clear: bool = False  # whether the vehicle has flown clear of the pad
    retries: int = 0  # number of go-arounds in this flight
    swings: int = 0  # number of departures from the cone over the pad since the last touchdown
    ground_z_m: float = inf  # lowest height of the vehicle in the take-off, on the ground, m
    yaw_rad: float | None = None  # heading in all set-points of the flight, rad
    # last velocity command before the lag correction; the slew limit of the next command is relative to it
    command: Vec3 = ZERO
    commanding: bool = False  # whether the last tick sent a velocity command, and the vehicle follows it
    lifting: bool = False  # whether the last tick sent a take-off climb, which takes effect after lift-off
    target_position_enu_m: Vec3 | None = None  # last known position of the target, m
    target_velocity_enu_m_s: Vec3 | None = None  # last known velocity of the target, m/s
    abort_way: AbortWay = AbortWay.NONE
    reason: Annotated[str, UNSEEN] = ""


@dataclass(slots=True)
class ClockMemory:
    """Estimate of a sender's clock; ``way`` is arrival minus stamp, that is, clock difference plus delay."""

    offset_s: float = inf  # minimum of arrival minus stamp, s; rises quickly while no message reaches it
    floor_s: float = inf  # minimum of arrival minus stamp, s; rises slowly while no message reaches it
    held_s: float = 0.0  # time since a message last reached ``offset_s``, s
    stamp_s: float = -inf  # newest accepted stamp, s on the sender's clock
    taken_s: float = -inf  # arrival time of the newest accepted message, s
    began_s: float = inf  # arrival time of the first message, or of the first after a clock step, s
    run_since_s: float = inf  # first arrival in a run of rejected messages that agree, s; inf: no run
    run_arrival_s: float = 0.0  # newest arrival in the run of rejected messages, s
    run_stamp_s: float = 0.0  # newest stamp in the run of rejected messages, s
    run_way_s: float = 0.0  # minimum of arrival minus stamp in the run of rejected messages, s
    run_sure: bool = False  # whether only a change of the sender's clock explains the rejected messages


@dataclass(slots=True)
class TrackMemory(ClockMemory):
    """State of the target track, with its sender's clock."""

    last: TargetSample | None = None  # newest accepted sample; None before the first
    # newest of the samples that agree with each other after a jump
    elsewhere: Annotated[TargetSample | None, UNSEEN] = None
    elsewhere_since_s: float = 0.0  # arrival time of the first of these samples, s
    drift_m: Vec3 = ZERO  # position change that the reported velocity does not explain, m
    drift_smooth_m: Vec3 = ZERO  # ``drift_m`` without the noise of single samples, m
    distrusted: bool = False  # whether positions and velocity contradict each other
    distrusts: int = 0  # number of times in this flight that positions contradicted the velocity
    parted_m: float = 0.0  # largest smoothed drift since the target was distrusted, m
    settled: bool = False  # whether the flight has started: jumps of the target are no longer accepted
    accepted: int = 0  # number of accepted samples
    rejected: int = 0  # number of rejected samples
    refusal: str = ""  # reason why the newest sample was rejected; empty if it was accepted


Covariance = tuple[float, float, float, float, float, float]  # upper triangle for (p, v, a), row by row


@dataclass(slots=True)
class MotionMemory:
    """State of the estimator of the target's motion: position p, velocity v, acceleration a of each axis."""

    time_s: float = nan  # stamp of the newest sample on the sender's clock, s; NaN before the first sample
    position_enu_m: Vec3 = ZERO  # estimated position at ``time_s``, m
    velocity_enu_m_s: Vec3 = ZERO  # estimated velocity at ``time_s``, m/s
    acceleration_enu_m_s2: Vec3 = ZERO  # estimated acceleration at ``time_s``, m/s^2
    yaw_rad: float | None = None  # newest measured heading, rad; None: unknown
    turn_rate_rad_s: float = 0.0  # turn rate of the velocity and acceleration vectors, rad/s
    innovation2: float = 1.0  # mean normalised innovation squared of x and y; 1 is expected
    covariance_xy: Covariance = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # covariance of x, which equals that of y
    covariance_z: Covariance = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(slots=True)
class TrackingMemory:
    """State of the corrections for the vehicle's velocity loop."""

    slope_m_s2: Vec3 = ZERO  # smoothed derivative of the velocity command, m/s^2
    setpoint_m_s: Vec3 = ZERO  # last set-point sent, m/s
    model_m_s: Vec3 = ZERO  # velocity that the model of the velocity loop predicts, m/s
    model_m_s2: Vec3 = ZERO  # derivative of ``model_m_s``, m/s^2
    disturbance_m_s: Vec3 = ZERO  # velocity error of the model due to wind, drag or wrong weight, m/s


@dataclass(slots=True)
class PlausibilityMemory:
    """State of the plausibility checks on vehicle state and set-points."""

    last: OwnState | None = None  # newest vehicle state that is a new measurement
    moved_s: float = 0.0  # arrival time of the newest state with a new position or no velocity control, s
    drift_m: Vec3 = ZERO  # position change that the reported velocity does not explain, m
    distrusted: bool = False  # whether position and reported velocity contradict each other
    missed_m: Vec3 = ZERO  # distance by which the vehicle lags behind the commanded velocity, m


@dataclass(slots=True)
class ReserveMemory:
    """State of the thrust reserve's estimate."""

    effort: float = nan  # smoothed vertical part of (throttle / maximum)^p; NaN before the first sample
    rise_m_s: float = 0.0  # vertical velocity, smoothed like ``effort``, m/s
    tired: bool = False  # whether the voltage (before take-off) or the reserve (in flight) is too low


# position, m; velocity, m/s; acceleration by the velocity loop, m/s^2; error of the reported velocity, m/s;
# acceleration by gusts and turning moments, m/s^2
AxisState = tuple[float, float, float, float, float]
AT_REST: AxisState = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(slots=True)
class OwnMemory:
    """State of the estimator that computes the vehicle state."""

    time_s: float = nan  # time of the newest sample on the vehicle's clock, s; NaN before the first sample
    x: AxisState = AT_REST  # state of the x axis at ``time_s``, like y and z below
    y: AxisState = AT_REST
    z_m: float = 0.0  # estimated height at ``time_s``, m
    z_error_m_s: float = 0.0  # error of the reported vertical velocity, m/s
    x_now: AxisState = AT_REST  # state of the x axis, predicted over the delay to now
    y_now: AxisState = AT_REST
    sent_m_s: Vec3 = ZERO  # newest set-point that was sent, m/s
    # set-points of the last ticks, oldest first; some have no effect yet on the newest sample
    pending: tuple[Vec3, Vec3, Vec3, Vec3] = (ZERO, ZERO, ZERO, ZERO)


Level = tuple[float, float]  # horizontal velocity on x and y, m/s


@dataclass(slots=True)
class LateMemory:
    """Set-points of a vehicle whose velocity loop has a dead time."""

    sent_m_s: tuple[Level, ...] = ()  # horizontal set-points that have no effect yet, m/s, oldest first


@dataclass(slots=True)
class FilterMemory:
    """Result of a user's filter that the controller stores."""

    refusal: str = ""  # reason why the filter's newest result is not a valid velocity; empty if valid


@dataclass(slots=True)
class Heard:
    """State of another fleet member, from the messages of this member."""

    message: MemberStatus | None = None  # newest message of the neighbour; None before the first
    yields: bool = False  # whether this vehicle has announced that it yields to the neighbour
    claim_s: float = nan  # time stamp of the neighbour's claim for which ``yields`` was decided, s
    yielded_s: float = -inf  # time at which this vehicle last announced that it yields, s
    on_pad: bool = False  # whether the neighbour stands on this vehicle's pad, by its newest message
    faster_m_s2: Vec3 = ZERO  # smoothed derivative of the neighbour's velocity command, m/s^2
    jumped_m: Vec3 = ZERO  # vector sum of the neighbour's jumps away from predicted positions, m


@dataclass(slots=True)
class FleetMemory:
    """State of the neighbours, and of this vehicle's right of way."""

    slots: tuple[Heard, ...] = ()  # one slot for each other member, in the order of their ids
    claim_s: float = nan  # time at which this vehicle claimed the right of way, s; NaN: no claim
    granted: bool = False  # whether this vehicle has the right of way
    # time at which the vehicle began to wait for the right of way, s; inf: it does not wait
    waits_since_s: float = inf
    committed_s: float = inf  # time at which COMMITTED was first announced, s; inf: it is not announced
    crowded: bool = False  # whether the event "constraints relaxed" was sent
    crowded_s: float = -inf  # time at which constraints of neighbours were last relaxed, s
    left: bool = False  # whether the vehicle has left its pad for another vehicle, or has tried to
    stays: bool = False  # whether the event "vehicle does not leave its pad" was sent
    place_enu_m: Vec3 | None = None  # place where the vehicle lands after leaving its pad, m


@dataclass(slots=True)
class State:
    """Complete controller state: with the configuration and the next inputs it determines all outputs.

    The state has all parts with every configuration; a log leaves out parts that equal their defaults.
    """

    memory: Memory = field(default_factory=Memory)
    track: TrackMemory = field(default_factory=TrackMemory)
    motion: MotionMemory = field(default_factory=MotionMemory)
    tracking: TrackingMemory = field(default_factory=TrackingMemory)
    plausibility: PlausibilityMemory = field(default_factory=PlausibilityMemory)
    reserve: ReserveMemory = field(default_factory=ReserveMemory)
    own: OwnMemory = field(default_factory=OwnMemory)
    late: LateMemory = field(default_factory=LateMemory)
    fleet: FleetMemory = field(default_factory=FleetMemory)
    filter: FilterMemory = field(default_factory=FilterMemory)
    filter_state: Any = None  # state of a user's filter, ``Filter.State``; None: the filter has no state
