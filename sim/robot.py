"""The ground robot: a unicycle with speed and acceleration limits on a path, and its odometry.

Between steps the twist (speed and turn rate) is constant and the pose moves on the exact arc. Each step ends
with the choice of the next twist. Any process that integrates pose and twist over the same interval gets the
same pose. A path with waypoints, or a function written by the user, also depends on the robot's pose.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np

from flightstack.common.strict_toml import ConfigError
from flightstack.common.text import ROBOT_FAILED, one_line
from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Cell, Record, cell, cell_of_numbers, copy, new
from flightstack.core.parameters.filters import file_of, referred
from flightstack.core.types import Vec3
from sim.chance import stream
from sim.plant.params import load
from sim.plant.sensors import BLOCK, NS, MeasurementChannel
from sim.plant.state_error import DELAY, TURN, WIDTH, ErrorRows, PastRecord, mismeasured_path
from sim.scenarios.tables import PathKind, TargetLink, TargetSpec

DRIVE_LAG_S = 0.1  # time constant of the drive, s; assumption (ROBOTIS gives none; likely 0.05 to 0.15 s)


class Deck(NamedTuple):
    """Motion of the pad centre (top side): the arguments of ``Physics.set_deck``."""

    position_enu_m: Vec3
    yaw_rad: float
    velocity_enu_m_s: Vec3
    yaw_rate_rad_s: float


# odometry sample: measurement time, s; position, ENU, m; yaw, rad; body velocity, m/s; yaw rate, rad/s
Sample = Sequence[float]


# speed and turn rate in the first section of a path, then in the second, as fractions of the drawn values
DEMANDS: dict[PathKind, tuple[float, float, float, float]] = {
    PathKind.STILL: (0.0, 0.0, 0.0, 0.0),
    PathKind.STRAIGHT: (1.0, 0.0, 1.0, 0.0),
    PathKind.CIRCLE: (1.0, 1.0, 1.0, 1.0),
    PathKind.STOP_AND_GO: (1.0, 1.0, 0.0, 0.0),
    PathKind.REVERSING: (1.0, 1.0, -1.0, 1.0),
    PathKind.FIGURE_OF_EIGHT: (1.0, 1.0, 1.0, -1.0),
}


# function from driven time (s), axle position (m, ENU) and heading (rad) to speed (m/s) and turn rate (rad/s)
Course = Callable[[float, float, float, float], tuple[float, float]]
GAIN_1_S = 2.0  # turn rate divided by the heading error to the waypoint, 1/s (assumption)
REACHED_M = 0.05  # distance at which a waypoint counts as reached, m


def course(spec: TargetSpec, speed_m_s: float, turn_rate_rad_s: float) -> Course | None:
    """Return a function that steers by the robot's pose; None: the path depends only on time.

    ``speed_m_s``, ``turn_rate_rad_s``: limits of the returned speed and turn rate.
    Raises ConfigError: the function cannot be imported.
    """
    if spec.path is PathKind.WAYPOINTS:
        return _to_waypoints(spec.waypoints_m, speed_m_s, abs(turn_rate_rad_s))
    if spec.path is PathKind.FUNCTION:
        return _by_function(spec.function, speed_m_s, abs(turn_rate_rad_s))
    return None


def _to_waypoints(points_m: Sequence[tuple[float, float]], speed_m_s: float, turn_rad_s: float) -> Course:
    """Steer to each waypoint in order, repeatedly; turn on the spot if the waypoint is behind the robot."""
    following = 0

    def steer(_t_s: float, x_m: float, y_m: float, yaw_rad: float) -> tuple[float, float]:
        nonlocal following
        to_x, to_y = points_m[following]
        if math.hypot(to_x - x_m, to_y - y_m) < REACHED_M:
            following = (following + 1) % len(points_m)
            to_x, to_y = points_m[following]
        off_rad = math.remainder(math.atan2(to_y - y_m, to_x - x_m) - yaw_rad, math.tau)
        turn = max(-turn_rad_s, min(turn_rad_s, GAIN_1_S * off_rad))
        return speed_m_s * max(0.0, math.cos(off_rad)) ** 3, turn

    return steer


def _by_function(name: str, speed_m_s: float, turn_rad_s: float) -> Course:
    """Steer by the user's function; limit the returned values to ``speed_m_s`` and ``turn_rad_s``."""
    function: Any = referred(name, "target.function")

    def steer(t_s: float, x_m: float, y_m: float, yaw_rad: float) -> tuple[float, float]:
        try:
            found = function(t_s, x_m, y_m, yaw_rad)
        except Exception as error:
            raise failed(f"raised {type(error).__name__}: {error}", t_s) from error
        try:
            speed, turn = map(float, found)
        except (TypeError, ValueError):
            speed = turn = math.nan
        if not (math.isfinite(speed) and math.isfinite(turn)):
            raise failed(f"returned {one_line(repr(found)):.60}", t_s)
        return max(-speed_m_s, min(speed_m_s, speed)), max(-turn_rad_s, min(turn_rad_s, turn))

    def failed(problem: str, t_s: float) -> ConfigError:
        return ConfigError(f"{ROBOT_FAILED} {file_of(name)} {problem} at t = {t_s:.2f} s; {_NEEDED}")

    return steer


_NEEDED = "called with t_s, x_m, y_m, yaw_rad it must return speed and turn rate, in m/s and rad/s"


def try_out(spec: TargetSpec) -> None:
    """Call a path's steering function at the start pose. Raises ConfigError: the function cannot be used."""
    if (steers := course(spec, spec.speed_m_s, spec.turn_rate_rad_s)) is not None:
        steers(0.0, *spec.position_m, spec.heading_rad)


# number of values of the pad's motion: time, ns; position of the pad centre, ENU, m; heading, rad; velocity
# in the body frame, m/s; velocity in ENU, m/s; turn rate, rad/s
PAD = 12


class MotionRecord(Record):
    """Commands of the robot, the state of its axle, and the resulting motion of the pad."""

    demand: Annotated[F64, 4]  # commanded speed and turn rate in both sections of the path
    phase_s: float
    period_s: float
    speed_max: float
    turn_rate_max: float
    accel_max: float
    turn_accel_max: float
    behind: float  # distance of the pad behind the axle, m
    height: float  # mean height of the pad's top above the floor, m
    heave: float  # amplitude of the heave, m
    heave_rad_s: float
    heave_phase: float
    driven_s: float
    x: float  # position of the axle, ENU, m
    y: float
    yaw: float
    v: float  # speed of the axle, m/s
    w: float  # yaw rate of the robot, rad/s
    pad: Annotated[F64, PAD]


@jitted
def arc(length_m: float, turn_rad: float) -> tuple[float, float]:
    """Return the exact displacement (forward, left) on an arc of ``length_m`` that turns by ``turn_rad``."""
    if abs(turn_rad) < 1e-9:
        return length_m, 0.5 * length_m * turn_rad
    return length_m * math.sin(turn_rad) / turn_rad, length_m * (1.0 - math.cos(turn_rad)) / turn_rad


@jitted
def wrap(angle_rad: float) -> float:
    """Return the equal angle in the interval (-pi, pi]."""
    return math.pi - (math.pi - angle_rad) % (2.0 * math.pi)


@jitted
def _clip(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))


@jitted
def _height(m: MotionRecord, time_s: float) -> float:
    return m.height + m.heave * math.sin(m.heave_rad_s * time_s + m.heave_phase)


@jitted
def publish(motion: Cell[MotionRecord], dt_s: float) -> None:
    """Compute the pad's motion from the axle's state; the pad, behind the axle, moves sideways in turns."""
    m = motion[0]
    pad, c, s = m.pad, math.cos(m.yaw), math.sin(m.yaw)
    time_s = pad[0] / NS
    z = _height(m, time_s)
    vx, vy, vz = m.v, -m.behind * m.w, (_height(m, time_s + dt_s) - z) / dt_s
    pad[1], pad[2], pad[3], pad[4] = m.x - m.behind * c, m.y - m.behind * s, z, m.yaw
    pad[5], pad[6], pad[7] = vx, vy, vz
    pad[8], pad[9], pad[10], pad[11] = c * vx - s * vy, s * vx + c * vy, vz, m.w


@jitted
def drive(motion: Cell[MotionRecord], dt_s: float, driving: bool) -> None:
    """Advance by ``dt_s`` with the current twist, then choose the next twist; brake if not ``driving``."""
    m = motion[0]
    forward, left = arc(m.v * dt_s, m.w * dt_s)
    c, s = math.cos(m.yaw), math.sin(m.yaw)
    m.x += c * forward - s * left
    m.y += s * forward + c * left
    m.yaw = wrap(m.yaw + m.w * dt_s)
    m.pad[0] += round(dt_s * NS)
    demand_v = demand_w = 0.0
    if driving:
        first = 2 * (int((m.driven_s + m.phase_s) / m.period_s) % 2)
        demand_v, demand_w = m.demand[first], m.demand[first + 1]
        m.driven_s += dt_s
    lag = -math.expm1(-dt_s / DRIVE_LAG_S)
    dv = _clip(lag * (demand_v - m.v), m.accel_max * dt_s)
    dw = _clip(lag * (demand_w - m.w), m.turn_accel_max * dt_s)
    m.v = _clip(m.v + dv, m.speed_max)
    m.w = _clip(m.w + dw, m.turn_rate_max)
    publish(motion, dt_s)


@jitted
def drive_on(motion: Cell[MotionRecord], dt_s: float, driving: bool, pads: F64) -> None:
    """Call ``drive`` once for each row, and write the resulting motion of the pad to the row.

    ``dt_s``: duration of each step; ``driving``: False brakes in all steps; ``pads``: (n, PAD), filled here.
    """
    for row in pads:
        drive(motion, dt_s, driving)
        copy(motion[0].pad, row)


class TargetModel:
    """Model of the target's true motion.

    The twist in the body frame is constant until the next step. The heave, like waves, continues while the
    robot stands.

    ``spec``: path, speeds, limits, pad; ``seed``: determines speed, turn rate and heading if ``spec`` makes
    them random, the time of the first speed change of a stop-and-go or reversing path, and the heave's phase;
    ``step_s``: expected time between steps (for the heave velocity in the first interval).
    """

    def __init__(self, spec: TargetSpec, seed: int, *, step_s: float = 0.01) -> None:
        rng = stream(seed, "target")
        speed, turn, heading, phase, heave = rng.uniform(0.0, 1.0, 5).tolist()
        share, turn_share = (speed, 2.0 * turn - 1.0) if spec.random_speed else (1.0, 1.0)
        speed_m_s = min(spec.speed_m_s * share, spec.speed_max_m_s)
        turn_rate_rad_s = float(_clip(spec.turn_rate_rad_s * turn_share, spec.turn_rate_max_rad_s))
        self._record = m = new(MotionRecord)
        m.demand[:] = DEMANDS.get(spec.path, (0.0, 0.0, 0.0, 0.0))
        m.demand *= (speed_m_s, turn_rate_rad_s, speed_m_s, turn_rate_rad_s)
        m.phase_s, m.period_s = phase * spec.stop_period_s, spec.stop_period_s
        if spec.path is PathKind.FIGURE_OF_EIGHT and turn_rate_rad_s:
            m.phase_s, m.period_s = 0.0, 2.0 * math.pi / abs(turn_rate_rad_s)
        self._course = course(spec, speed_m_s, turn_rate_rad_s)
        m.speed_max, m.turn_rate_max = spec.speed_max_m_s, spec.turn_rate_max_rad_s
        m.accel_max = spec.acceleration_max_m_s2
        m.turn_accel_max = spec.acceleration_max_m_s2 / load().robot.wheel_half_track_m
        m.behind, m.height = spec.pad_behind_axle_m, spec.pad_height_m
        m.heave, m.heave_rad_s = spec.heave_amplitude_m, 2.0 * math.pi * spec.heave_rate_hz
        m.heave_phase = 2.0 * math.pi * heave
        m.x, m.y = spec.position_m
        m.yaw = wrap(2.0 * math.pi * heading) if spec.random_heading else wrap(spec.heading_rad)
        self._cell = cell_of_numbers(m)
        publish(self._cell, step_s)
        # compile or load the code before the simulated time starts
        drive_on(cell_of_numbers(new(MotionRecord)), step_s, False, np.empty((1, PAD)))

    def stop(self) -> None:
        """Stop at once, as with locked wheels; ``pad`` shows the stop after the next step."""
        self._record.v = self._record.w = 0.0

    @property
    def pad(self) -> Deck:
        """Motion of the pad now."""
        _, x, y, z, yaw, _, _, _, vx, vy, vz, rate = self._record.pad.tolist()
        return Deck((x, y, z), yaw, (vx, vy, vz), rate)

    def row(self) -> F64:
        """Return the motion of the pad now, in the form of ``run``."""
        return np.array([self._record.pad])

    def run(self, steps: int, dt_s: float, driving: bool) -> F64:
        """Run ``steps`` steps; return the pad's motion after each, (steps, PAD)."""
        pads = np.empty((steps, PAD))
        if self._course is None or not driving:
            drive_on(self._cell, dt_s, driving, pads)
        else:
            m = self._record
            for n in range(steps):
                m.demand[:] = 2 * self._course(m.driven_s, m.x, m.y, m.yaw)
                drive_on(self._cell, dt_s, True, pads[n : n + 1])
        return pads


MEASURED = [1, 2, 3, 4, 5, 6, 7, 11]  # measured columns: position, heading, body velocity, turn rate


class TargetOdometry:
    """Odometry of the target with the noise, loss and delay of its link.

    Call ``run`` for time zero and for every step of the model: each step measures at most one sample, so a
    step must not be longer than the link's period. The noise of the yaw rate follows from speed noise of two
    wheels: velocity noise divided by half the track width. With ``link.error`` a sample first gets the errors
    of a recorded flight, then noise, loss and delay.
    """

    def __init__(self, link: TargetLink, seed: int) -> None:
        p, v = link.position_noise_m, link.velocity_noise_m_s
        sigmas = (p, p, p, link.yaw_noise_rad, v, v, v, v / load().robot.wheel_half_track_m)
        self._channel = MeasurementChannel(link, sigmas, seed, "target.odometry")
        self._errors = None if link.error is None else ErrorRows(link.error, seed, "target", link.rate_hz)
        self._left, past = np.empty((0, WIDTH)), new(PastRecord)
        past.rate = link.rate_hz
        self._past = cell(past)

    def run(self, pads: F64) -> tuple[list[int], F64]:
        """Measure the due samples; return the samples that the link releases in these steps, oldest first.

        ``pads``: (n, PAD) true motion after each step.
        Returns the index of the step in which each sample arrived, and the samples, (m, 9).
        """
        times_ns = pads[:, 0].astype(np.int64).tolist()
        arrived, samples = self._channel.run(times_ns, lambda due: self._measured(pads[due]))
        _finish(samples)
        return arrived, samples

    def _measured(self, pads: F64) -> F64:
        values, count = pads[:, MEASURED], len(pads)
        if self._errors is not None:
            while len(self._left) < count:
                self._left = np.concatenate((self._left, self._errors.take(BLOCK)))
            rows, self._left = self._left[:count], self._left[count:]
            late = np.empty((count, 6))
            mismeasured_path(self._past, pads[:, 1:4].copy(), pads[:, 8:11].copy(), rows, late)
            _mismeasured(pads, rows, late, values)
        return values


@jitted
def _mismeasured(pads: F64, rows: F64, late: F64, values: F64) -> None:
    """Fill in position, heading and velocity in the body frame as motion capture measures them.

    ``rows``: errors; ``late``: measured position and velocity, ENU.
    """
    for n in range(len(pads)):
        value, v = values[n], late[n]
        yaw = pads[n, 4] - pads[n, 11] * rows[n, DELAY] + rows[n, TURN + 2]
        c, s = math.cos(yaw), math.sin(yaw)
        for i in range(3):
            value[i] = v[i]
        value[3], value[4], value[5], value[6] = yaw, c * v[3] + s * v[4], c * v[4] - s * v[3], v[5]


@jitted
def _finish(samples: F64) -> None:
    """Convert the samples' times from nanoseconds to seconds, and wrap their headings."""
    for sample in samples:
        sample[0] /= NS
        sample[4] = wrap(sample[4])
