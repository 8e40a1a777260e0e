"""Flies the recorded set-points with the simulated vehicle and its firmware, and compares the two flights.

The simulated vehicle stands where the real one stood, and gets the recorded set-points at the recorded times.
What differs from airframe to airframe and from day to day is taken from the recording: the battery's voltage,
and how unequal the motors are. Everything else is the vehicle file's.

The real vehicles were given positions and no velocities, but for take-off and landing, which the firmware's
own commander flies with velocities: only so do the Mellinger flights climb and hover as recorded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flightstack.core.parameters.ends import Takeoff
from flightstack.core.parameters.flight import BarrierShape, FlightConfig
from sim.flights.recording import Floats, Recording
from sim.flights.screening import Mask, Screened
from sim.plant.params import STEP_S, Battery, Params, Plant
from sim.scenarios.scenario import (
    OdometryLink,
    Scenario,
    Start,
    StartKind,
    TargetSpec,
    VehicleSpec,
    VelocityLoop,
)
from sim.vehicle.vehicle import VehicleSim

MOCAP = OdometryLink(100.0, 0.001, 0.0, 0.005, 0.020)  # delay: median of the recorded flights
SETTLE_S = 0.2  # on the ground, before the first set-point
AWAY_M = 100.0  # where the ground robot stands
SATURATED = 1.0 - 1e-6  # of the duty
SIDEWAYS_M = 0.005
LOADED_S = 2.0  # the voltage is taken from the first seconds of what is compared
THRUST_EXPONENT = 1.5  # of the voltage at the motor, near hover


class Flown(NamedTuple):
    """What a flight shows.

    Attributes:
        horizontal_m: rms of the distance between position and set-point, level.
        vertical_m: the same, up and down.
        duty: mean over the motors, 0 to 1.
        saturated: share of samples with a motor at full duty.
        tilt_rms_rad: of body z against the vertical.
        tilt_p95_rad: 95th percentile of it.
        sag_v_s: how fast the voltage falls.
    """

    horizontal_m: float
    vertical_m: float
    duty: float
    saturated: float
    tilt_rms_rad: float
    tilt_p95_rad: float
    sag_v_s: float


@dataclass(frozen=True, slots=True)
class ClosedLoop:
    """A flight beside its simulation; ``controller`` is pid or mellinger."""

    controller: str
    recorded: Flown
    simulated: Flown


class Track(NamedTuple):
    """n samples: position (n, 3), height of the body's z axis (n,), duty (n, 4), voltage under load (n,)."""

    position_m: Floats
    up: Floats
    duty: Floats
    battery_v: Floats


def fly(flight: Screened, params: Params, seed: int) -> ClosedLoop | None:
    """Fly the set-points of a flight; None where it has none, or does not begin on the ground.

    Args:
        flight: with pieces; only what lies in them is compared.
        params: of the simulated vehicle.
        seed: of noise.
    """
    r = flight.recording
    span = _commanded(r)
    if not flight.usable or span is None or r.setpoint_position_m is None:
        return None
    compared = np.zeros(len(r.time_s), dtype=bool)
    for piece in flight.pieces:
        compared[piece] = True
    compared &= np.isfinite(r.setpoint_position_m).all(axis=1)
    compared[: span.start] = compared[span.stop :] = False
    if not compared.any():
        return None
    x, y = r.attitude[:, 1], r.attitude[:, 2]
    recorded = Track(r.position_m, 1.0 - 2.0 * (x * x + y * y), r.duty, r.battery_v)
    simulated = _simulate(r, span, compared, params, seed)
    return ClosedLoop(
        "pid" if r.by_pid else "mellinger", _flown(r, recorded, compared), _flown(r, simulated, compared)
    )


def _commanded(r: Recording) -> slice | None:
    """Find the samples from the first set-point to the last; None where it flies before the first."""
    if r.setpoint_position_m is None:
        return None
    runs = np.flatnonzero((r.duty.max(axis=1) > 0.0) & np.any(r.setpoint_position_m != 0.0, axis=1))
    if len(runs) == 0 or runs[0] == 0:
        return None
    return slice(int(runs[0]), int(runs[-1]) + 1)


def _simulate(r: Recording, span: slice, compared: Mask, params: Params, seed: int) -> Track:
    """Fly the set-points; what lies outside ``span`` is NaN."""
    start, stop = span.start, span.stop
    assert r.setpoint_position_m is not None
    x, y, ground = r.position_m[start].tolist()
    up = (
        -params.geometry.foot_bottom_m - ground
    )  # of the floor under the simulated vehicle, which stands lower
    scenario = Scenario(
        "closed_loop",
        "recorded set-points",
        FlightConfig(BarrierShape(1.0, 1.5), takeoff=Takeoff(start_offset_m=(0.0, 0.0, 1.0))),
        start=Start(StartKind.GROUND, ground_position_m=(x, y)),
        target=TargetSpec(position_m=(x + AWAY_M, y)),
        vehicle=VehicleSpec(velocity_loop=VelocityLoop.PID, mocap=MOCAP),
    )
    plant = Plant(motors=_motors(r, compared), battery_charge=_charge(r, compared, params.battery))
    vehicle = VehicleSim(scenario, seed, params, plant)
    if not r.by_pid:
        vehicle.choose_mellinger()
    vehicle.advance(round(SETTLE_S / STEP_S))
    refused = vehicle.arm()
    if refused is not None:
        raise ValueError(f"the simulated vehicle can't be armed: {refused}")
    setpoints = r.setpoint_position_m + np.array((0.0, 0.0, up))
    yaw_rad = np.zeros(len(r.time_s)) if r.setpoint_yaw_rad is None else r.setpoint_yaw_rad
    ahead = _fed_forward(r, span)
    times_ms = np.rint((r.time_s - r.time_s[start]) / STEP_S).astype(int)
    track = Track(*(np.full((len(r.time_s), *shape), np.nan) for shape in ((3,), (), (4,), ())))
    for k in range(start, stop):
        vehicle.set_position(tuple(setpoints[k].tolist()), float(yaw_rad[k]), tuple(ahead[k].tolist()))
        if k > start:
            vehicle.advance(int(times_ms[k] - times_ms[k - 1]))
        body = vehicle.body()
        track.position_m[k] = body[:3]
        track.up[k] = 1.0 - 2.0 * (body[7] * body[7] + body[8] * body[8])
        track.duty[k] = vehicle.duty
        track.battery_v[k] = vehicle.battery_v
    track.position_m[:, 2] -= up
    return track


def _motors(r: Recording, compared: Mask) -> tuple[float, float, float, float]:
    """Thrust of each motor at the same voltage, as share of the mean: a weak one is given more to balance."""
    given = np.mean((r.duty[compared] * r.battery_v[compared, None]) ** THRUST_EXPONENT, axis=0)
    share = given.mean() / given
    m1, m2, m3, m4 = (share / share.mean()).tolist()
    return (m1, m2, m3, m4)


def _fed_forward(r: Recording, span: slice) -> Floats:
    """Velocity set-points of the take-off, which ends when the set-point first moves sideways; zero later."""
    assert r.setpoint_position_m is not None
    out = np.zeros_like(r.setpoint_position_m)
    setpoints = r.setpoint_position_m[span]
    sideways = np.abs(setpoints[:, :2] - setpoints[0, :2]).max(axis=1) > SIDEWAYS_M
    end = int(np.argmax(sideways)) if sideways.any() else len(setpoints)
    if end > 2:
        out[span.start : span.start + end, 2] = np.gradient(setpoints[:end, 2], r.time_s[span][:end])
    return out


def _charge(r: Recording, compared: Mask, battery: Battery) -> float:
    """Charge of a cell, as share of a full one, that in hover has the recorded voltage."""
    first = np.flatnonzero(compared)[: round(LOADED_S / r.step_s)]
    current_a = battery.idle_current_a + battery.hover_current_a
    rest_v = float(np.median(r.battery_v[first])) + battery.resistance_ohm * current_a
    return (rest_v - battery.empty_v) / (battery.full_v - battery.empty_v)


def _flown(r: Recording, track: Track, compared: Mask) -> Flown:
    assert r.setpoint_position_m is not None
    error = (track.position_m - r.setpoint_position_m)[compared]
    tilt = np.arccos(np.clip(track.up[compared], -1.0, 1.0))
    duty = track.duty[compared]
    return Flown(
        float(np.sqrt((error[:, :2] ** 2).sum(axis=1).mean())),
        float(np.sqrt((error[:, 2] ** 2).mean())),
        float(duty.mean()),
        float((duty.max(axis=1) >= SATURATED).mean()),
        float(np.sqrt((tilt**2).mean())),
        float(np.percentile(tilt, 95.0)),
        float(-np.polyfit(r.time_s[compared], track.battery_v[compared], 1)[0]),
    )
