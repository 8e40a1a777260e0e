"""The ground robot: a unicycle with speed and acceleration limits on a path, and its odometry.

Between steps the twist is constant and the pose moves on the exact arc; a step ends by choosing the twist of
the next interval. Whoever integrates pose and twist over the same interval ends on the same pose.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from flightstack.types import Vec3
from sim.params import load
from sim.scenario import OdometryLink, PathKind, TargetSpec
from sim.sensors import NS, MeasurementChannel, stream

DRIVE_LAG_S = 0.1  # first-order lag of the drive; not documented by ROBOTIS, 0.05 to 0.15 s (assumption)


@dataclass(frozen=True, slots=True)
class PadPose:
    """Pose of the pad centre (top surface), ENU."""

    position_enu_m: Vec3
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class TargetMeasurement:
    """One odometry sample; twist in the body frame (x forward, y left)."""

    time_s: float  # of the measurement
    position_enu_m: Vec3
    yaw_rad: float
    velocity_body_m_s: Vec3
    yaw_rate_rad_s: float


def arc(length_m: float, turn_rad: float) -> tuple[float, float]:
    """Displacement (forward, left) after driving ``length_m`` while turning by ``turn_rad``, exact."""
    if abs(turn_rad) < 1e-9:
        return length_m, 0.5 * length_m * turn_rad
    return length_m * math.sin(turn_rad) / turn_rad, length_m * (1.0 - math.cos(turn_rad)) / turn_rad


def wrap(angle_rad: float) -> float:
    """Angle in (-pi, pi]."""
    return math.pi - (math.pi - angle_rad) % (2.0 * math.pi)


Demand = Callable[["TargetModel", float], tuple[float, float]]


def _still(_model: TargetModel, _time_s: float) -> tuple[float, float]:
    return 0.0, 0.0


def _straight(model: TargetModel, _time_s: float) -> tuple[float, float]:
    return model.speed_m_s, 0.0


def _circle(model: TargetModel, _time_s: float) -> tuple[float, float]:
    return model.speed_m_s, model.turn_rate_rad_s


def _stop_and_go(model: TargetModel, time_s: float) -> tuple[float, float]:
    go = int((time_s + model.phase_s) / model.spec.stop_period_s) % 2 == 0
    return (model.speed_m_s, model.turn_rate_rad_s) if go else (0.0, 0.0)


def _reversing(model: TargetModel, time_s: float) -> tuple[float, float]:
    forward = int((time_s + model.phase_s) / model.spec.stop_period_s) % 2 == 0
    return (model.speed_m_s if forward else -model.speed_m_s), model.turn_rate_rad_s


DEMANDS: dict[PathKind, Demand] = {
    PathKind.STILL: _still,
    PathKind.STRAIGHT: _straight,
    PathKind.CIRCLE: _circle,
    PathKind.STOP_AND_GO: _stop_and_go,
    PathKind.REVERSING: _reversing,
}


class TargetModel:
    """True motion of the target.

    ``pose``, ``velocity_enu_m_s``, ``velocity_body_m_s`` and ``yaw_rate_rad_s`` are of the pad centre at
    ``time_s``; the body-frame twist holds until the next step. Heave goes on all the time, driving or not: it
    is the sea's.

    Args:
        spec: path, speeds, limits, pad.
        seed: draws speed, turn rate and heading where the spec asks for it, the time until the first change
            of stop-and-go and reversing, and the phase of the heave.
        step_s: expected time between steps (used to choose the heave velocity of the first interval).
    """

    def __init__(self, spec: TargetSpec, seed: int, *, step_s: float = 0.01) -> None:
        self.spec = spec
        rng = stream(seed, "target")
        speed, turn, heading, phase, heave = rng.uniform(0.0, 1.0, 5).tolist()
        share, turn_share = (speed, 2.0 * turn - 1.0) if spec.random_speed else (1.0, 1.0)
        self.speed_m_s = min(spec.speed_m_s * share, spec.speed_max_m_s)
        self.turn_rate_rad_s = _clip(spec.turn_rate_rad_s * turn_share, spec.turn_rate_max_rad_s)
        self.phase_s = phase * spec.stop_period_s
        self._heave_phase = 2.0 * math.pi * heave
        self._yaw_max_rad_s2 = spec.acceleration_max_m_s2 / load().robot.wheel_half_track_m
        self._x, self._y = spec.position_m
        self._yaw = wrap(2.0 * math.pi * heading) if spec.random_heading else wrap(spec.heading_rad)
        self._v = self._w = 0.0
        self._time_ns = 0
        self._driven_s = 0.0
        self._z, self._vz = self._height(0.0), 0.0
        self._publish(step_s)

    def _height(self, time_s: float) -> float:
        angle = 2.0 * math.pi * self.spec.heave_rate_hz * time_s + self._heave_phase
        return self.spec.pad_height_m + self.spec.heave_amplitude_m * math.sin(angle)

    def step(self, dt_s: float, driving: bool) -> None:
        """Move on by ``dt_s`` with the twist chosen before, then choose the next; not driving: braking."""
        forward, left = arc(self._v * dt_s, self._w * dt_s)
        c, s = math.cos(self._yaw), math.sin(self._yaw)
        self._x += c * forward - s * left
        self._y += s * forward + c * left
        self._yaw = wrap(self._yaw + self._w * dt_s)
        self._time_ns += round(dt_s * NS)
        self._z = self._height(self._time_ns / NS)
        demand_v, demand_w = DEMANDS[self.spec.path](self, self._driven_s) if driving else (0.0, 0.0)
        if driving:
            self._driven_s += dt_s
        lag = -math.expm1(-dt_s / DRIVE_LAG_S)
        dv = _clip(lag * (demand_v - self._v), self.spec.acceleration_max_m_s2 * dt_s)
        dw = _clip(lag * (demand_w - self._w), self._yaw_max_rad_s2 * dt_s)
        self._v = _clip(self._v + dv, self.spec.speed_max_m_s)
        self._w = _clip(self._w + dw, self.spec.turn_rate_max_rad_s)
        self._publish(dt_s)

    def _publish(self, dt_s: float) -> None:
        """Turn the axle's state into the pad's; the pad stands behind the axle and swings with the yaw."""
        self.time_s = self._time_ns / NS
        self._vz = (self._height(self.time_s + dt_s) - self._z) / dt_s
        behind = self.spec.pad_behind_axle_m
        c, s = math.cos(self._yaw), math.sin(self._yaw)
        self.pose = PadPose((self._x - behind * c, self._y - behind * s, self._z), self._yaw)
        self.yaw_rate_rad_s = self._w
        vx, vy = self._v, -behind * self._w
        self.velocity_body_m_s: Vec3 = (vx, vy, self._vz)
        self.velocity_enu_m_s: Vec3 = (c * vx - s * vy, s * vx + c * vy, self._vz)


class TargetOdometry:
    """Odometry of the target through its link.

    Call ``step`` at time zero and after every step of the model: it measures when a sample is due and returns
    the samples released by now, oldest first. One sample a call at most, so step at least at the link's rate.
    Yaw-rate noise is that of two wheels with the given speed noise: velocity noise over half the track.
    """

    def __init__(self, link: OdometryLink, seed: int) -> None:
        p, v = link.position_noise_m, link.velocity_noise_m_s
        sigmas = (p, p, p, link.yaw_noise_rad, v, v, v, v / load().robot.wheel_half_track_m)
        self.channel = MeasurementChannel(link, sigmas, seed, "target.odometry")

    def step(self, model: TargetModel) -> list[TargetMeasurement]:
        """Measure if due and return what has arrived."""
        now_ns = round(model.time_s * NS)
        channel = self.channel
        if now_ns >= channel.due_ns:
            values = (
                *model.pose.position_enu_m,
                model.pose.yaw_rad,
                *model.velocity_body_m_s,
                model.yaw_rate_rad_s,
            )
            channel.sample(now_ns, values)
        if now_ns < channel.release_ns:
            return []
        return [
            TargetMeasurement(t_ns / NS, (v[0], v[1], v[2]), wrap(v[3]), (v[4], v[5], v[6]), v[7])
            for t_ns, v in channel.release(now_ns)
        ]


def _clip(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))
