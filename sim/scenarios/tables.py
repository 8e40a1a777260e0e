"""Tables of a scenario: vehicle, start, robot, links, wind, verdict, exchange of messages.

``spread`` values are half-widths of uniform distributions, drawn from the seed. Units are s and m, frames
ENU.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated

from flightstack.common.strict_toml import ConfigError, Files, span
from flightstack.core.parameters.flight import PAD_RADIUS_M
from flightstack.core.types import Vec3

BELOW_PAD_MIN_M = 0.03  # minimum height of the pad's top above the floor, m: for pad plate and robot
MEMBERS_MAX = 250  # maximum number of vehicles, because each has a MAVLink system id
# line on which a pad moves: point on the floor, and direction; direction (0, 0): the pad does not move
Line = tuple[tuple[float, float], tuple[float, float]]
_PARALLEL = 1e-9  # sine of the angle below which two lines count as parallel
Share = Annotated[float, span(0.0, 1.0)]
Drag = Annotated[float, span(0.0, 10.0)]
VEHICLE_FILES = Files(dict, "sim.plant", "vehicle.airframe")  # files that ``sim.plant.params`` reads


class StartKind(Enum):
    """State of the vehicle at the start."""

    GROUND = "ground"  # the vehicle stands on the floor, disarmed
    HOVER = "hover"  # the vehicle hovers at start.offset_m, armed and trimmed for the wind


class PathKind(Enum):
    """Path of the target."""

    STILL = "still"
    STRAIGHT = "straight"
    CIRCLE = "circle"  # constant speed and turn rate
    STOP_AND_GO = "stop_and_go"
    REVERSING = "reversing"
    FIGURE_OF_EIGHT = "figure_of_eight"  # a circle to the left, then a circle to the right
    WAYPOINTS = "waypoints"  # waypoints_m in order, repeated
    FUNCTION = "function"  # a function MODULE:NAME


class VelocityLoop(Enum):
    """On-board velocity loop of the vehicle."""

    PAPER = "paper"  # eq. 8 with K1, K2 in the Mellinger attitude controller
    PID = "pid"  # velocity loop of the Crazyflie firmware (position_controller_pid.c)


@dataclass(frozen=True, slots=True)
class Start:
    """Start position of the vehicle. ``offset_m`` is relative to the landing spot at time zero, ENU."""

    kind: StartKind = StartKind.GROUND  # `ground`: on the floor, disarmed; `hover`: in the air, armed
    ground_position_m: tuple[float, float] = (0.0, 0.0)  # start position for kind = ground
    # position relative to the landing spot for kind = hover; none: drawn from distance_m, h_m and any bearing
    offset_m: Vec3 | None = None
    distance_m: tuple[float, float] = (0.3, 2.5)  # range of the random distance from the landing spot
    h_m: tuple[float, float] = (0.03, 1.2)  # range of the random barrier value at the start


@dataclass(frozen=True, slots=True)
class TargetSpec:
    """The ground robot: a TurtleBot3 Burger with a pad, on a path."""

    path: PathKind = PathKind.STILL  # path of the robot
    speed_m_s: Annotated[float, span(0.0, 3.0)] = 0.0  # speed on the path
    turn_rate_rad_s: Annotated[float, span(-3.0, 3.0)] = 0.0  # turn rate on the path
    waypoints_m: tuple[tuple[float, float], ...] = ()  # waypoints for path = waypoints: east and north
    # for path = function: MODULE:NAME, imported from the working folder; it returns speed and turn rate
    function: str = ""
    # whether speed (in [0, speed_m_s]) and turn rate (in +-turn_rate_rad_s) are drawn from the seed
    random_speed: bool = False
    position_m: tuple[float, float] = (0.0, 0.0)  # position of the axle at time zero
    heading_rad: float = 0.0  # heading at time zero, counter-clockwise from east
    random_heading: bool = False  # whether the heading is drawn from the seed
    wait_for_landing: bool = True  # whether the robot waits until the landing starts
    # time between two changes of the speed in stop_and_go, reversing
    stop_period_s: Annotated[float, span(0.5, 60.0)] = 4.0
    acceleration_max_m_s2: Annotated[float, span(0.05, 10.0)] = 1.0  # maximum acceleration of the wheels
    speed_max_m_s: Annotated[float, span(0.01, 5.0)] = 0.2108  # maximum speed (OpenCR: wheels at 61 rpm)
    turn_rate_max_rad_s: Annotated[float, span(0.01, 10.0)] = 2.635  # maximum turn rate (OpenCR)
    heave_amplitude_m: Annotated[float, span(0.0, 0.5)] = 0.0  # amplitude of the pad's heave
    heave_rate_hz: Annotated[float, span(0.0, 2.0)] = 0.0  # frequency of the heave
    pad_height_m: Annotated[float, span(0.05, 2.0)] = 0.20  # height of the pad's top (LDS: 0.192 m)
    pad_radius_m: Annotated[float, PAD_RADIUS_M] = 0.10  # radius of the pad
    # distance of the pad's centre behind the axle; the centre of the robot's body is 0.032 m behind the axle
    pad_behind_axle_m: Annotated[float, span(-0.2, 0.2)] = 0.0

    def __post_init__(self) -> None:
        turns = self.path in (PathKind.FIGURE_OF_EIGHT, PathKind.WAYPOINTS)
        if turns and not (self.speed_m_s and self.turn_rate_rad_s):
            raise ConfigError(
                f"path: found {self.path.value!r}, which needs speed_m_s and turn_rate_rad_s above 0"
            )
        if self.path is PathKind.WAYPOINTS and len(self.waypoints_m) < 2:
            raise ConfigError(
                f"waypoints_m: found {len(self.waypoints_m)}, at least 2 are needed: [[0, 0], [1, 0]]"
            )
        if self.path is PathKind.FUNCTION and ":" not in self.function:
            raise ConfigError(f"function: found {self.function!r}, MODULE:NAME of a function is needed")
        most_m = self.pad_height_m - BELOW_PAD_MIN_M
        if self.heave_amplitude_m > most_m:
            raise ConfigError(
                f"heave_amplitude_m: found {self.heave_amplitude_m:g}; with pad_height_m "
                f"{self.pad_height_m:g} at most {most_m:.4g}, so that {BELOW_PAD_MIN_M:g} m are left below"
            )

    @property
    def pad_m(self) -> Vec3:
        """Pad's centre at time zero, ENU, m, without heave; not valid for a heading drawn from the seed."""
        (x, y), behind_m = self.position_m, self.pad_behind_axle_m
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return (x - behind_m * c, y - behind_m * s, self.pad_height_m)

    def line(self) -> Line | None:
        """Return the line on which the pad moves; None: no such line is known before the flight."""
        stands = self.path is PathKind.STILL or self.speed_m_s == 0.0 == self.turn_rate_rad_s
        behind = bool(self.pad_behind_axle_m)
        if (self.random_heading and (behind or not stands)) or (self.turn_rate_rad_s and not stands):
            return None
        x, y, _ = self.pad_m
        return (x, y), (0.0, 0.0) if stands else (math.cos(self.heading_rad), math.sin(self.heading_rad))


@dataclass(frozen=True, slots=True)
class OdometryLink:
    """Transmission of measurements: rate, noise, delay, loss."""

    rate_hz: Annotated[float, span(1.0, 500.0)] = 100.0  # samples per second
    position_noise_m: Annotated[float, span(0.0, 0.2)] = 0.0  # standard deviation of position on each axis
    velocity_noise_m_s: Annotated[float, span(0.0, 0.5)] = 0.0  # standard deviation of velocity on each axis
    yaw_noise_rad: Annotated[float, span(0.0, 0.2)] = 0.0  # standard deviation of the yaw
    delay_s: Annotated[float, span(0.0, 0.5)] = 0.0  # time from measurement to arrival
    loss: Annotated[float, span(0.0, 1.0)] = 0.0  # probability that a sample is lost
    dropout_every_s: Annotated[float, span(0.0, 600.0)] = 0.0  # mean time between drop-outs; 0: none
    dropout_max_s: Annotated[float, span(0.0, 5.0)] = 0.0  # upper limit of a drop-out's random duration


@dataclass(frozen=True, slots=True)
class StateError:
    """Error of a measured state, as in recorded flights: a varying delay, and correlated errors.

    Defaults: fitted to 43 flights of a Crazyflie 2.1 in a Vicon room (NanoBench, arXiv 2603.09908), see
    docs/how_it_works/own_state.md. Values are standard deviations unless stated otherwise.
    """

    delay_s: Annotated[float, span(-0.1, 0.2)] = 0.02  # mean delay of the position over all flights
    # standard deviation of a flight's mean delay
    delay_spread_s: Annotated[float, span(0.0, 0.1)] = 0.015
    delay_shared: bool = False  # whether vehicle and target have the same mean delay
    # standard deviation of the delay's fast variation in the median flight
    delay_fast_s: Annotated[float, span(0.0, 0.1)] = 0.025
    # time constant T of the fast variation, whose correlation after t is (1 + t/T) exp(-t/T)
    delay_fast_time_s: Annotated[float, span(0.01, 10.0)] = 0.072
    # standard deviation, over flights, of the logarithm of delay_fast_s
    delay_fast_varies: Annotated[float, span(0.0, 2.0)] = 0.0
    # standard deviation of the delay's slow variation in the median flight
    delay_slow_s: Annotated[float, span(0.0, 0.1)] = 0.011
    delay_slow_time_s: Annotated[float, span(0.01, 60.0)] = 0.4  # time constant T of the slow variation
    # standard deviation, over flights, of the logarithm of delay_slow_s
    delay_slow_varies: Annotated[float, span(0.0, 2.0)] = 0.7
    # mean delay of the position minus mean delay of the velocity
    velocity_lead_s: Annotated[float, span(-0.1, 0.1)] = 0.018
    # standard deviation of velocity_lead_s over flights
    velocity_lead_spread_s: Annotated[float, span(0.0, 0.1)] = 0.012
    position_error_m: Annotated[float, span(0.0, 0.2)] = 0.0009  # position error on each axis
    # horizontal velocity error that does not depend on the speed
    velocity_error_m_s: Annotated[float, span(0.0, 0.5)] = 0.02
    velocity_z_m_s: Annotated[float, span(0.0, 0.5)] = 0.019  # vertical velocity error
    # velocity error as fraction of the speed, constant in a flight
    velocity_scale: Annotated[float, span(0.0, 1.0)] = 0.056
    # varying velocity error along the horizontal velocity, as fraction of the speed
    velocity_along: Annotated[float, span(0.0, 1.0)] = 0.064
    # varying velocity error across the horizontal velocity, as fraction of the speed
    velocity_across: Annotated[float, span(0.0, 1.0)] = 0.016
    tilt_rad: Annotated[float, span(0.0, 0.2)] = 0.015  # misalignment about body x and y, fixed in a flight
    yaw_rad: Annotated[float, span(0.0, 0.2)] = 0.0013  # misalignment about body z, fixed in a flight
    tilt_noise_rad: Annotated[float, span(0.0, 0.2)] = 0.0055  # varying error about body x and y
    yaw_noise_rad: Annotated[float, span(0.0, 0.2)] = 0.0006  # varying error about body z
    # correlation time T in exp(-t/T) of all errors except the delay
    error_time_s: Annotated[float, span(0.01, 10.0)] = 0.23


@dataclass(frozen=True, slots=True)
class TargetLink(OdometryLink):
    """Odometry of the target; with ``error`` it has the errors of recorded motion capture."""

    error: StateError | None = None


@dataclass(frozen=True, slots=True)
class VehicleSpec:
    """The simulated vehicle: file of parameters, velocity loop, random spreads, and motion capture.

    With ``own`` the on-board estimate has the errors of recorded flights; ``mocap`` then gives only the rate
    and the losses of the samples. With ``known_drag_1_s`` the estimator has the firmware's form in flight: it
    uses only body z of the accelerometer, and these values of ``kalman.dragB_*``.
    """

    airframe: str = "crazyflie20"  # name of a file in sim/plant, or path of a file
    velocity_loop: VelocityLoop = VelocityLoop.PAPER  # loop: `paper` (eq. 8) or `pid` (firmware)
    mass_spread: Annotated[float, span(0.0, 0.5)] = 0.0  # half-width of the relative random mass error
    # half-width of the relative random error of the motors' time constant
    motor_lag_spread: Annotated[float, span(0.0, 0.9)] = 0.0
    thrust_spread: Annotated[float, span(0.0, 0.5)] = 0.0  # half-width of the relative random thrust error
    # half-width of each motor's relative random thrust error around their mean
    motor_spread: Annotated[float, span(0.0, 0.3)] = 0.0
    battery_charge: tuple[Share, Share] = (1.0, 1.0)  # range of the random state of charge at the start
    # minimum thrust-to-weight ratio of the weakest motor at the start; the charge is raised accordingly
    hover_reserve: Annotated[float, span(0.0, 1.5)] = 0.0
    slow_motors: bool = False  # whether the motor lag is 0.136 s up, 0.108 s down instead of 0.07 s
    ground_effect_gain: Annotated[float, span(0.0, 6.0)] = 1.0  # factor on the measured ground effect
    # motion capture of the on-board estimator
    mocap: OdometryLink = field(default_factory=lambda: OdometryLink(100.0, 0.001, 0.0, 0.005, 0.010))
    own: StateError | None = None
    known_drag_1_s: tuple[Drag, Drag, Drag] | None = None  # drag per mass used by the estimator, body axes
    setpoint_delay_s: Annotated[float, span(0.0, 0.1)] = 0.002  # delay of set-points; Crazyradio: 2 to 7 ms

    def __post_init__(self) -> None:
        VEHICLE_FILES.path_of(self.airframe)
        low, high = self.battery_charge
        if low > high:
            raise ConfigError(f"battery_charge: found [{low:g}, {high:g}], the lower share comes first")


@dataclass(frozen=True, slots=True)
class Wind:
    """Mean wind and gusts."""

    mean_m_s: Annotated[float, span(0.0, 10.0)] = 0.0  # speed of the mean wind
    gust_rms_m_s: Annotated[float, span(0.0, 5.0)] = 0.0  # standard deviation of the gusts on each axis
    # direction in which the mean wind blows, counter-clockwise from east; None: drawn from the seed
    direction_rad: float | None = None


@dataclass(frozen=True, slots=True)
class Judge:
    """Barrier of the verdict, if it differs from the flown barrier; each result then names both."""

    alpha_1_m: Annotated[float, span(0.05, 20.0)]  # shape parameter, as onboard.barrier.alpha_1_m
    beta_m: Annotated[float, span(0.05, 20.0)]  # shape parameter, as onboard.barrier.beta_m


@dataclass(frozen=True, slots=True)
class ExchangeLink:
    """Link of the messages that companions send to each other every tick; the delay is at least one tick."""

    delay_s: Annotated[float, span(0.0, 1.0)] = 0.0  # time from a tick to the arrival of its messages
    loss: Annotated[float, span(0.0, 1.0)] = 0.0  # probability of loss for each message and receiver


def apart_m(one: Line | None, other: Line | None) -> float:
    """Return the smallest distance of two lines or points; 0 if one of them is unknown."""
    if one is None or other is None:
        return 0.0
    (ax, ay), (ux, uy), (bx, by), (vx, vy) = *one, *other
    if abs(ux * vy - uy * vx) > _PARALLEL:
        return 0.0
    x, y = bx - ax, by - ay
    cx, cy = (ux, uy) if (ux, uy) != (0.0, 0.0) else (vx, vy)
    return abs(x * cy - y * cx) if (cx, cy) != (0.0, 0.0) else math.hypot(x, y)
