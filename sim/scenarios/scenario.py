"""A scenario: everything about a simulated run that is not the seed.

One TOML file a scenario in ``sim/scenarios``; loaded by name or by path, unknown keys refused. ``spread``
values are half-widths of uniform draws from the seed. Lengths of time and space in s and m, frames ENU.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

from flightstack.common.strict_toml import ConfigError, Files, over, span
from flightstack.core.parameters.filters import look_here
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import Barrier
from flightstack.core.types import Vec3
from sim.scenarios.fault_spec import Fault

BELOW_PAD_MIN_M = 0.03  # m between floor and the top of a pad at its lowest: plate, and robot below it
Share = Annotated[float, span(0.0, 1.0)]
Drag = Annotated[float, span(0.0, 10.0)]
VEHICLE_FILES = Files(dict, "sim.vehicles", "vehicle.airframe")  # read by ``sim.plant.params``


class StartKind(Enum):
    """How the vehicle begins."""

    GROUND = "ground"  # stands on the floor, disarmed
    HOVER = "hover"  # armed and trimmed in the wind at start.offset_m


class PathKind(Enum):
    """Path of the target."""

    STILL = "still"
    STRAIGHT = "straight"
    CIRCLE = "circle"  # constant speed and turn rate
    STOP_AND_GO = "stop_and_go"
    REVERSING = "reversing"
    FIGURE_OF_EIGHT = "figure_of_eight"  # a circle to the left, then one to the right
    WAYPOINTS = "waypoints"  # waypoints_m in order, again and again
    FUNCTION = "function"  # function, MODULE:NAME


class VelocityLoop(Enum):
    """On-board velocity loop of the vehicle."""

    PAPER = "paper"  # eq. 8 with K1, K2 in the Mellinger attitude controller
    PID = "pid"  # Crazyflie firmware position_controller_pid.c


@dataclass(frozen=True, slots=True)
class Start:
    """Where the vehicle begins. ``offset_m`` is relative to the landing spot at time zero, ENU."""

    kind: StartKind = StartKind.GROUND  # `ground`: on the floor, disarmed; `hover`: in the air, armed
    ground_position_m: tuple[float, float] = (0.0, 0.0)  # start position for kind = ground
    offset_m: Vec3 | None = (
        None  # for kind = hover, from the landing spot; none: drawn from distance_m, h_m and any bearing
    )
    distance_m: tuple[float, float] = (0.3, 2.5)  # horizontal distance from the landing spot, drawn
    h_m: tuple[float, float] = (0.03, 1.2)  # barrier value at the start, drawn


@dataclass(frozen=True, slots=True)
class TargetSpec:
    """The ground robot: a TurtleBot3 Burger with a pad, on a path."""

    path: PathKind = PathKind.STILL  # path of the robot
    speed_m_s: Annotated[float, span(0.0, 3.0)] = 0.0  # speed on the path
    turn_rate_rad_s: Annotated[float, span(-3.0, 3.0)] = 0.0  # turn rate on the path
    waypoints_m: tuple[tuple[float, float], ...] = ()  # for path = waypoints: east and north
    # for path = function: MODULE:NAME, found from the working folder; it returns speed and turn rate
    function: str = ""
    random_speed: bool = (
        False  # draw speed in [0, speed_m_s] and turn rate in +-turn_rate_rad_s from the seed
    )
    position_m: tuple[float, float] = (0.0, 0.0)  # position of the axle at time zero
    heading_rad: float = 0.0  # heading at time zero, from east to north
    random_heading: bool = False  # draw the heading from the seed
    wait_for_landing: bool = True  # the robot stands until the landing begins
    stop_period_s: Annotated[float, span(0.5, 60.0)] = 4.0  # stop_and_go and reversing: time between changes
    acceleration_max_m_s2: Annotated[float, span(0.05, 10.0)] = 1.0  # largest acceleration of the wheels
    speed_max_m_s: Annotated[float, span(0.01, 5.0)] = 0.2108  # OpenCR turtlebot3_burger.h: 61 rpm wheels
    turn_rate_max_rad_s: Annotated[float, span(0.01, 10.0)] = 2.635  # OpenCR turtlebot3_burger.h
    heave_amplitude_m: Annotated[float, span(0.0, 0.5)] = 0.0  # half of the height by which the pad heaves
    heave_rate_hz: Annotated[float, span(0.0, 2.0)] = 0.0  # oscillations of the heave in a second
    pad_height_m: Annotated[float, span(0.05, 2.0)] = 0.20  # LDS top at 0.192 m plus the pad
    pad_radius_m: Annotated[float, span(0.05, 2.0)] = 0.10
    pad_behind_axle_m: Annotated[float, span(-0.2, 0.2)] = 0.0  # 0.032 would be the body's centre

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


@dataclass(frozen=True, slots=True)
class OdometryLink:
    """How measurements reach their reader: rate, noise, delay, loss."""

    rate_hz: Annotated[float, span(1.0, 500.0)] = 100.0  # samples in a second
    position_noise_m: Annotated[float, span(0.0, 0.2)] = 0.0  # standard deviation on each axis
    velocity_noise_m_s: Annotated[float, span(0.0, 0.5)] = 0.0  # standard deviation on each axis
    yaw_noise_rad: Annotated[float, span(0.0, 0.2)] = 0.0  # standard deviation
    delay_s: Annotated[float, span(0.0, 0.5)] = 0.0  # time from measurement to arrival
    loss: Annotated[float, span(0.0, 1.0)] = 0.0  # probability that a sample is lost
    dropout_every_s: Annotated[float, span(0.0, 600.0)] = 0.0  # mean time between drop-outs; 0: none
    dropout_max_s: Annotated[float, span(0.0, 5.0)] = 0.0  # longest drop-out; its length is drawn up to this


class TapeKind(Enum):
    """What a recorded error is played back as."""

    DELAY = "delay"  # time by which the recorded state was late, and what is left
    RAW = "raw"  # offset of the recorded position and velocity, in the recorded axes


@dataclass(frozen=True, slots=True)
class StateError:
    """Error of a measured state as in recorded flights: a varying delay above all, and correlated errors.

    Defaults: ``tests.benchmarks.vehicle.state_error_fit`` on 43 flights of a Crazyflie 2.1 in a Vicon room
    (NanoBench, arXiv 2603.09908), see docs/how_it_works/own_state.md. Standard deviations, unless another
    quantity is named.
    """

    tape: str | None = None  # folder of recorded flights; their error instead of the model below
    tape_kind: TapeKind = TapeKind.DELAY  # `delay` or `raw`: what of the recording is played back
    delay_s: Annotated[float, span(-0.1, 0.2)] = 0.02  # delay of the position: mean of all flights
    delay_spread_s: Annotated[float, span(0.0, 0.1)] = 0.015  # spread between flights
    delay_shared: bool = False  # vehicle and target have the same mean delay, or tapes of the same flight
    delay_fast_s: Annotated[float, span(0.0, 0.1)] = 0.025  # variation in flight: median flight
    delay_fast_time_s: Annotated[float, span(0.01, 10.0)] = 0.072  # correlation (1 + t/T) exp(-t/T)
    delay_fast_varies: Annotated[float, span(0.0, 2.0)] = 0.0  # spread of its logarithm between flights
    delay_slow_s: Annotated[float, span(0.0, 0.1)] = 0.011  # slow variation of the delay in flight
    delay_slow_time_s: Annotated[float, span(0.01, 60.0)] = 0.4  # its correlation
    delay_slow_varies: Annotated[float, span(0.0, 2.0)] = 0.7  # spread of its logarithm between flights
    velocity_lead_s: Annotated[float, span(-0.1, 0.1)] = 0.018  # delay of position less delay of velocity
    velocity_lead_spread_s: Annotated[float, span(0.0, 0.1)] = 0.012  # spread between flights
    position_error_m: Annotated[float, span(0.0, 0.2)] = 0.0009  # each axis
    velocity_error_m_s: Annotated[float, span(0.0, 0.5)] = 0.02  # horizontal axes, at any speed
    velocity_z_m_s: Annotated[float, span(0.0, 0.5)] = 0.019  # vertical
    velocity_scale: Annotated[float, span(0.0, 1.0)] = 0.056  # share of the speed, constant in a flight
    velocity_along: Annotated[float, span(0.0, 1.0)] = (
        0.064  # share of the horizontal speed that varies, along it
    )
    velocity_across: Annotated[float, span(0.0, 1.0)] = 0.016  # and across it
    tilt_rad: Annotated[float, span(0.0, 0.2)] = 0.015  # misalignment of a flight, about body x and y
    yaw_rad: Annotated[float, span(0.0, 0.2)] = 0.0013  # about body z
    tilt_noise_rad: Annotated[float, span(0.0, 0.2)] = 0.0055  # variation in flight; of an estimator fed so
    yaw_noise_rad: Annotated[float, span(0.0, 0.2)] = 0.0006
    error_time_s: Annotated[float, span(0.01, 10.0)] = 0.23  # correlation exp(-t/T) of all but the delay


@dataclass(frozen=True, slots=True)
class TargetLink(OdometryLink):
    """Odometry of the target; with ``error`` it comes from a motion capture like that of the vehicle."""

    error: StateError | None = None


@dataclass(frozen=True, slots=True)
class VehicleSpec:
    """The simulated vehicle: its file, velocity loop, spreads of its plant, mocap of its estimator.

    With ``own`` the estimate on board has the errors of recorded flights. Rate and losses of ``mocap`` hold,
    its noise and delay do not count. With ``known_drag_1_s`` the estimate is the firmware's in flight: of the
    accelerometer by body z alone, and by these ``kalman.dragB_*``.
    """

    airframe: str = "crazyflie20"  # name of a file in sim/vehicles, or the path of another
    velocity_loop: VelocityLoop = VelocityLoop.PAPER  # `paper`: eq. 8; `pid`: that of the firmware
    mass_spread: Annotated[float, span(0.0, 0.5)] = 0.0  # half-width of the drawn mass, as a share
    # half-width of the drawn time constant of the motors, as a share
    motor_lag_spread: Annotated[float, span(0.0, 0.9)] = 0.0
    thrust_spread: Annotated[float, span(0.0, 0.5)] = 0.0  # half-width of the drawn thrust, as a share
    motor_spread: Annotated[float, span(0.0, 0.3)] = 0.0  # each motor's thrust about the mean of the four
    battery_charge: tuple[Share, Share] = (1.0, 1.0)  # share of a full cell at the start, lowest and highest
    # least thrust over weight of the weakest motor; with less it begins with a fuller battery
    hover_reserve: Annotated[float, span(0.0, 1.5)] = 0.0
    slow_motors: bool = False  # 0.136 s up, 0.108 s down instead of 0.07 s
    ground_effect_gain: Annotated[float, span(0.0, 6.0)] = 1.0  # factor on the measured ground effect
    # motion capture of the on-board estimator
    mocap: OdometryLink = field(default_factory=lambda: OdometryLink(100.0, 0.001, 0.0, 0.005, 0.010))
    own: StateError | None = None
    known_drag_1_s: tuple[Drag, Drag, Drag] | None = None  # body axes
    setpoint_delay_s: Annotated[float, span(0.0, 0.1)] = 0.002  # radio, one way (Crazyradio: 2 to 7 ms)

    def __post_init__(self) -> None:
        VEHICLE_FILES.path_of(self.airframe)
        low, high = self.battery_charge
        if low > high:
            raise ConfigError(f"battery_charge: found [{low:g}, {high:g}], the lower share comes first")


@dataclass(frozen=True, slots=True)
class Wind:
    """Mean wind (direction drawn from the seed unless given) and gusts."""

    mean_m_s: Annotated[float, span(0.0, 10.0)] = 0.0  # mean wind
    gust_rms_m_s: Annotated[float, span(0.0, 5.0)] = 0.0  # standard deviation of the gusts on each axis
    direction_rad: float | None = None  # where the wind blows to, from east to north; none: drawn


@dataclass(frozen=True, slots=True)
class Judge:
    """Another barrier for the verdict than the one that is flown; each result then names both."""

    alpha_1_m: Annotated[float, span(0.05, 20.0)]  # as onboard.barrier.alpha_1_m
    beta_m: Annotated[float, span(0.05, 20.0)]  # as onboard.barrier.beta_m


@dataclass(frozen=True, slots=True)
class Scenario:
    """A whole scenario."""

    name: str  # name of the scenario
    description: str  # what it is for, in a sentence
    onboard: FlightConfig
    # a run that lasts longer has the outcome timeout
    duration_max_s: Annotated[float, span(1.0, 3600.0)] = 120.0
    start: Start = field(default_factory=Start)
    target: TargetSpec = field(default_factory=TargetSpec)
    odometry: TargetLink = field(default_factory=TargetLink)
    vehicle: VehicleSpec = field(default_factory=VehicleSpec)
    wind: Wind = field(default_factory=Wind)
    judge: Judge | None = None  # None: the verdict uses the barrier that is flown
    fault: tuple[Fault, ...] = ()  # [[fault]], in any order

    def __post_init__(self) -> None:
        if self.target.speed_m_s > self.target.speed_max_m_s + 1e-9:
            raise ConfigError(
                f"target.speed_m_s: found {self.target.speed_m_s:g}, above target.speed_max_m_s "
                f"{self.target.speed_max_m_s:g}"
            )
        if abs(self.target.turn_rate_rad_s) > self.target.turn_rate_max_rad_s + 1e-9:
            raise ConfigError(
                f"target.turn_rate_rad_s: found {self.target.turn_rate_rad_s:g}, above "
                f"target.turn_rate_max_rad_s {self.target.turn_rate_max_rad_s:g}"
            )
        if self.start.kind is StartKind.GROUND and self.onboard.takeoff.start_offset_m is None:
            raise ConfigError("onboard.takeoff.start_offset_m: missing; a start on the ground needs it")
        target, declared_m = self.target, self.onboard.touchdown.pad_radius_m
        if target.pad_radius_m != declared_m:
            raise ConfigError(
                f"target.pad_radius_m: found {target.pad_radius_m:g}, and onboard.touchdown.pad_radius_m: "
                f"found {declared_m:g}; there is one pad: give target.pad_radius_m alone"
            )

    @property
    def judged_by(self) -> Barrier:
        """Barrier of the verdict, which is evaluated with true states."""
        if self.judge is None:
            return self.onboard.barrier.build()
        return Barrier(self.judge.alpha_1_m, self.judge.beta_m)

    def with_filter(self, name: str) -> Scenario:
        """Return the same scenario flown with another safety filter.

        Raises ConfigError: no name of a filter, or the filter refuses the configuration.
        """
        return replace(self, onboard=replace(self.onboard, filter=name))


def one_pad(table: dict[str, Any]) -> dict[str, Any]:
    """A scenario's table with the radius of its pad in the configuration, unless that gives one itself."""
    match table:
        case {"target": {"pad_radius_m": radius_m}, "onboard": dict()}:
            return over({"onboard": {"touchdown": {"pad_radius_m": radius_m}}}, table)
    return table


class _Files(Files[Scenario]):
    def table(self, path: Path) -> dict[str, Any]:
        """Parse a file as ``Files.table`` does; there is one radius of the pad."""
        return one_pad(super().table(path))


FILES = _Files(Scenario, "sim.scenarios", "scenario")
names, path_of = FILES.names, FILES.path_of


def load(name_or_file: str | Path) -> Scenario:
    """Load a scenario by name or path.

    Raises:
        ConfigError: with file, key, what was found and what is allowed.
    """
    return in_place(FILES.load(name_or_file), path_of(name_or_file).parent)


def in_place(scenario: Scenario, beside: Path) -> Scenario:
    """The same with its filter found and the full paths of its tapes.

    ``scenario``: as read; ``beside``: folder of its file, where tapes may be.
    """
    for name in (scenario.onboard.filter, scenario.target.function):
        if name:
            look_here(name)
    vehicle, odometry = scenario.vehicle, scenario.odometry
    vehicle = replace(vehicle, own=_placed(vehicle.own, beside))
    return replace(
        scenario, vehicle=vehicle, odometry=replace(odometry, error=_placed(odometry.error, beside))
    )


def _placed(error: StateError | None, folder: Path) -> StateError | None:
    """The same with the full path of its tape, if that is in the folder."""
    if error is None or error.tape is None or not (folder / error.tape).is_dir():
        return error
    return replace(error, tape=str((folder / error.tape).resolve()))
