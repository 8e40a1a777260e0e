"""State of the controller between ticks; everything else is computed in each tick.

Plain values only, of the types ``state_text`` can write: that is how the state gets into the log and back.
The names of classes and fields are part of the log: a log with other names is not replayed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from math import inf, nan
from typing import Annotated

from flightstack.core.numeric import ABSENT, UNSEEN
from flightstack.core.types import ZERO, Neighbour, OwnState, Phase, TargetSample, Vec3


class AbortWay(IntEnum):
    """How an abort ends the flight: the phases within phase ABORT."""

    NONE = 0
    MOTORS_OFF = 1  # emergency stop
    HANDS_OFF = 2  # another client controls the vehicle, or it never flew
    LAND_HERE = 3  # the position of vehicle or target is not known: the autopilot's own landing
    FLY_CLEAR = 4  # climb, fly clear of the target, then land


@dataclass(slots=True)
class Memory:
    """State of mission machine and commands."""

    phase: Phase = Phase.WAIT
    phase_since_s: float = 0.0
    started_s: float = inf  # when the landing began
    bad_since_s: float = inf  # not used; logs name it in the layout of the state
    good_since_s: float = inf  # since when all inputs have been good
    contact_since_s: float = inf
    stopped_since_s: float = inf  # commanded to sink and not sinking
    contact: bool = False  # stands on the pad
    own_ok_s: float = -inf  # last time with a usable vehicle state
    was_armed: bool = False
    was_external: bool = False
    climbed: bool = False  # the take-off climb is over
    clear: bool = False  # flown clear after an abort
    retries: int = 0
    swings: int = 0  # how often it has left the cone over the pad since the last touchdown
    ground_z_m: float = inf  # height at which it stood
    yaw_rad: float | None = None  # heading held in the whole flight
    command: Vec3 = ZERO  # last commanded velocity, before the correction for the lag; base of the slew limit
    commanding: bool = False  # a command went out in the last tick, and is flown
    lifting: bool = False  # a climb command of the take-off went out; it is flown after lift-off
    target_position_enu_m: Vec3 | None = None  # last known
    target_velocity_enu_m_s: Vec3 | None = None  # at that time
    abort_way: AbortWay = AbortWay.NONE
    reason: Annotated[str, UNSEEN] = ""


@dataclass(slots=True)
class ClockMemory:
    """State of a sender's clock; ``way`` is arrival minus stamp: difference of the clocks plus delay."""

    offset_s: float = inf  # smallest arrival minus stamp, with fast forgetting
    floor_s: float = inf  # smallest arrival minus stamp, with slow forgetting
    held_s: float = 0.0  # time since the smallest value was last met
    stamp_s: float = -inf  # newest accepted stamp
    taken_s: float = -inf  # its arrival
    began_s: float = inf  # arrival of the first, or of the first after a step
    run_since_s: float = inf  # first arrival of refused messages that agree with each other; inf: none
    run_arrival_s: float = 0.0  # newest of them
    run_stamp_s: float = 0.0  # the same
    run_way_s: float = 0.0  # their least way
    run_sure: bool = False  # no delay explains them


@dataclass(slots=True)
class TrackMemory(ClockMemory):
    """State of the target track, with its sender's clock."""

    last: TargetSample | None = None  # newest accepted sample
    elsewhere: Annotated[TargetSample | None, ABSENT] = (
        None  # newest of samples that jumped but agree with each other
    )
    elsewhere_since_s: float = 0.0
    drift_m: Vec3 = ZERO  # change of the position that the velocity does not explain
    drift_smooth_m: Vec3 = ZERO  # the same without the noise of single samples
    distrusted: bool = False  # positions and velocity contradict each other
    distrusts: int = 0  # how often they have in this flight
    parted_m: float = 0.0  # largest distance since they do
    settled: bool = False  # the flight has started: samples from elsewhere are not accepted any more
    accepted: int = 0
    rejected: int = 0
    refusal: str = ""  # why the newest sample was refused; empty: it was not


Covariance = tuple[float, float, float, float, float, float]  # pp, pv, pa, vv, va, aa


@dataclass(slots=True)
class MotionMemory:
    """State of the target's estimator."""

    time_s: float = nan  # stamp of the newest sample, on the sender's clock; NaN before the first
    position_enu_m: Vec3 = ZERO  # at that time, as all fields below
    velocity_enu_m_s: Vec3 = ZERO
    acceleration_enu_m_s2: Vec3 = ZERO
    yaw_rad: float | None = None  # newest measured heading; None: unknown
    turn_rate_rad_s: float = 0.0  # turn rate of the velocity and acceleration vectors
    surprise: float = 1.0  # normalised innovation squared of x and y; 1 on average
    covariance_xy: Covariance = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # equal for x and y
    covariance_z: Covariance = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(slots=True)
class TrackingMemory:
    """State of the corrections for the vehicle's velocity loop."""

    slope_m_s2: Vec3 = ZERO  # smoothed derivative of the velocity wanted
    setpoint_m_s: Vec3 = ZERO  # last set-point sent
    model_m_s: Vec3 = ZERO  # velocity that the model of the loop predicts
    model_m_s2: Vec3 = ZERO  # its derivative
    disturbance_m_s: Vec3 = ZERO  # velocity error of the model: wind, drag, wrong weight


@dataclass(slots=True)
class PlausibilityMemory:
    """State of the checks of vehicle state and set-points."""

    last: OwnState | None = None  # newest new measurement
    moved_s: float = 0.0  # arrival of the newest state that moved, or was not flying
    drift_m: Vec3 = ZERO  # position change that the velocity does not explain
    distrusted: bool = False
    missed_m: Vec3 = ZERO  # distance by which the vehicle lags behind the commanded velocity


@dataclass(slots=True)
class ReserveMemory:
    """State of the estimate of the thrust reserve."""

    effort: float = nan  # smoothed (throttle / highest)^p, upward part; NaN before the first
    rise_m_s: float = 0.0  # vertical velocity with the same smoothing; the difference is acceleration
    tired: bool = False  # the reserve fell below its minimum; remains set in flight


# position m, velocity m/s, acceleration by the vehicle's loop m/s^2, error of the reported velocity m/s, and
# acceleration by gusts and turning moments m/s^2
AxisState = tuple[float, float, float, float, float]
AT_REST: AxisState = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(slots=True)
class OwnMemory:
    """State of the estimator of the vehicle state."""

    time_s: float = nan  # time of the newest sample; NaN before the first
    x: AxisState = AT_REST  # at that time, as all fields below
    y: AxisState = AT_REST
    z_m: float = 0.0
    z_error_m_s: float = 0.0  # error of the reported vertical velocity
    x_now: AxisState = AT_REST  # carried on over the delay
    y_now: AxisState = AT_REST
    sent_m_s: Vec3 = ZERO  # newest set-point
    # set-points of the last ticks, oldest first: the newest sample does not show all of them yet
    pending: tuple[Vec3, Vec3, Vec3, Vec3] = (ZERO, ZERO, ZERO, ZERO)


Level = tuple[float, float]  # on x and y


@dataclass(slots=True)
class LateMemory:
    """State of a velocity loop with a dead time."""

    sent_m_s: tuple[Level, ...] = ()  # horizontal set-points that have no effect yet, oldest first


@dataclass(slots=True)
class FilterMemory:
    """State of a user's filter."""

    refusal: str = ""  # why its newest result is not a valid velocity; empty: it is


@dataclass(slots=True)
class AgentMemory:
    """Velocity that an agent chooses in place of the approach; it is no part of a recorded state."""

    flies: bool = False  # there is an agent
    own: Vec3 = ZERO  # m/s ENU; nominal velocity of the stack in this tick
    chosen: Vec3 = ZERO  # m/s ENU


@dataclass(slots=True)
class State:
    """Complete controller state: with the configuration and the next inputs it determines all outputs."""

    memory: Memory
    track: TrackMemory
    motion: MotionMemory
    tracking: TrackingMemory
    plausibility: PlausibilityMemory


@dataclass(slots=True)
class WholeState(State):
    """``State`` with parts that only some configurations use; logs of the others keep their layout."""

    reserve: ReserveMemory
    own: OwnMemory


@dataclass(slots=True)
class LateState(WholeState):
    """``WholeState`` of a vehicle whose velocity loop has a dead time."""

    late: LateMemory


@dataclass(slots=True)
class Heard:
    """State of one neighbour."""

    word: Neighbour | None = None  # newest message; None before the first
    yields: bool = False  # this vehicle yields to it, as announced
    claim_s: float = nan  # claim of the neighbour to which this yielding belongs
    yielded_s: float = -inf  # time of the last announcement of yielding
    on_pad: bool = False  # it stood on this vehicle's pad in its newest message
    faster_m_s2: Vec3 = ZERO  # smoothed acceleration of its commanded velocity
    jumped_m: Vec3 = ZERO  # distance of reported positions beyond the reachable ones


# one slot for each other member, in the order of the ids; a smaller fleet leaves the last ones unused
Slots = tuple[Heard, Heard, Heard, Heard, Heard, Heard, Heard, Heard]


def _nobody_heard() -> Slots:
    return (Heard(), Heard(), Heard(), Heard(), Heard(), Heard(), Heard(), Heard())


@dataclass(slots=True)
class FleetMemory:
    """State of the neighbours, and of this vehicle's right of way."""

    slots: Slots = field(default_factory=_nobody_heard)
    claim_s: float = nan  # time of the claim for the right of way
    granted: bool = False
    waits_since_s: float = inf  # for it
    committed_s: float = inf  # time since which COMMITTED is announced
    crowded: bool = False  # the report that the rows of neighbours are relaxed was sent
    crowded_s: float = -inf  # when they did last
    left: bool = False  # it has left its pad for another vehicle, or has tried to
    stays: bool = False  # the report that it does not leave its pad was sent
    place_enu_m: Vec3 | None = None  # where it lands then


@dataclass(slots=True)
class FleetState(WholeState):
    """The same of a vehicle in a fleet."""

    fleet: FleetMemory
