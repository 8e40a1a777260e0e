"""Flies the recorded set-points with the simulated vehicle and its firmware, and compares both flights.

The simulated vehicle starts at the recorded position and receives the recorded set-points at the recorded
times. The first seconds of a recording identify what differs between airframes and days: battery voltage,
motor thrust relative to the vehicle file, and differences between the motors. The vehicle file has all other
parameters. The on-board estimate gets random errors as in recorded flights.
Only flights with the PID controller are flown; the simulated firmware has no other position controller.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass

import numpy as np

from flightstack.core.parameters.flight import FlightConfig, Takeoff
from flightstack.core.safety.barrier import Barrier
from sim.flights.recording import Floats, Recording
from sim.flights.screening import Mask, Screened
from sim.plant.params import STEP_S, Params, Plant
from sim.scenarios.scenario import Scenario
from sim.scenarios.tables import Start, StartKind, StateError, TargetSpec, VehicleSpec, VelocityLoop
from sim.vehicle.vehicle import VehicleSim

SETTLE_S = 0.2  # time on the floor before the first set-point, s
AWAY_M = 100.0  # distance of the robot to the east of the vehicle, m; too far to affect the flight
SATURATED = 1.0 - 1e-6  # duty cycle from which a motor counts as saturated
KNOWN_S = 8.0  # duration of the first compared samples, s; they identify the airframe


@dataclass(frozen=True, slots=True)
class Flown:
    """Statistics of one flight, recorded or simulated."""

    horizontal_m: float  # rms of the horizontal distance between position and set-point
    vertical_m: float  # rms of the vertical distance between position and set-point
    duty: float  # mean duty cycle of the motors, 0 to 1
    saturated: float  # fraction of samples with a motor at full duty

    @property
    def tracking_rms_m(self) -> float:
        return math.hypot(self.horizontal_m, self.vertical_m)


@dataclass(frozen=True, slots=True)
class ClosedLoop:
    """A recorded flight and its simulation."""

    thrust: float  # ratio of this airframe's motor thrust to that of the vehicle file
    recorded: Flown
    simulated: Flown


def fly(flight: Screened, params: Params, seed: int) -> ClosedLoop | None:
    """Fly the set-points of a flight; return None if the flight has no PID set-points from the ground on.

    Only the usable pieces are compared. The noise is drawn from ``seed`` and the name of the flight.
    """
    r = flight.recording
    span = _commanded(r)
    if not flight.usable or not r.by_pid or span is None or r.setpoint_position_m is None:
        return None
    compared = np.zeros(len(r.time_s), dtype=bool)
    for piece in flight.pieces:
        compared[piece] = True
    compared &= np.isfinite(r.setpoint_position_m).all(axis=1)
    compared[: span.start] = compared[span.stop :] = False
    if not compared.any():
        return None
    plant = _airframe(r, span.start, compared, params)
    simulated = _simulate(r, span, params, plant, seed ^ zlib.crc32(r.name.encode()))
    if simulated is None:
        return None
    return ClosedLoop(
        plant.thrust, _flown(r, compared, r.position_m, r.duty), _flown(r, compared, *simulated)
    )


def _commanded(r: Recording) -> slice | None:
    """Return the samples from the first set-point to the last; None if the recording starts in flight."""
    if r.setpoint_position_m is None:
        return None
    given = np.isfinite(r.setpoint_position_m).all(axis=1) & np.any(r.setpoint_position_m != 0.0, axis=1)
    runs = np.flatnonzero((r.duty.max(axis=1) > 0.0) & given)
    if len(runs) == 0 or runs[0] == 0 or not np.isfinite(r.position_m[runs[0]]).all():
        return None
    return slice(int(runs[0]), int(runs[-1]) + 1)


def _simulate(
    r: Recording, span: slice, params: Params, plant: Plant, seed: int
) -> tuple[Floats, Floats] | None:
    """Return positions (n, 3), duty cycles (n, 4), NaN outside ``span``; None: arming is rejected."""
    start, stop = span.start, span.stop
    assert r.setpoint_position_m is not None
    x, y, ground = r.position_m[start].tolist()
    up = -params.geometry.foot_bottom_m - ground  # recorded height + up = height above the simulated floor
    scenario = Scenario(
        "closed_loop",
        "recorded set-points",
        FlightConfig(Barrier(1.0, 1.5), takeoff=Takeoff(start_offset_m=(0.0, 0.0, 1.0))),
        start=Start(StartKind.GROUND, ground_position_m=(x, y)),
        target=TargetSpec(position_m=(x + AWAY_M, y)),
        vehicle=VehicleSpec(velocity_loop=VelocityLoop.PID, own=StateError()),
    )
    vehicle = VehicleSim(scenario, seed, params, plant)
    vehicle.advance(round(SETTLE_S / STEP_S))
    if vehicle.arm() is not None:
        return None
    setpoints = r.setpoint_position_m + np.array((0.0, 0.0, up))
    yaw_rad = np.zeros(len(r.time_s)) if r.setpoint_yaw_rad is None else np.nan_to_num(r.setpoint_yaw_rad)
    times_ms = np.rint((r.time_s - r.time_s[start]) / STEP_S).astype(int)
    position_m, duty = np.full((len(r.time_s), 3), np.nan), np.full((len(r.time_s), 4), np.nan)
    for k in range(start, stop):
        if np.isfinite(setpoints[k]).all():
            vehicle.set_position(tuple(setpoints[k].tolist()), float(yaw_rad[k]))
        if k > start:
            vehicle.advance(int(times_ms[k] - times_ms[k - 1]))
        position_m[k], duty[k] = vehicle.body().position_enu_m, vehicle.duty
    position_m[:, 2] -= up
    return position_m, duty


def _airframe(r: Recording, start: int, compared: Mask, params: Params) -> Plant:
    """Identify thrust, motors and battery of this airframe from the first compared seconds."""
    rotor, battery = params.rotor, params.battery
    first = np.flatnonzero(compared)[: round(KNOWN_S / r.step_s)]
    sag_v = battery.hover_sag_v  # mean motor voltage = duty * (voltage at rest) - sag
    volts = r.duty[first] * (r.battery_v[first, None] + sag_v) - sag_v
    rpm = battery.speed_at_zero_v_rpm + battery.speed_per_volt_rpm * volts
    thrust_n = np.maximum(0.0, (rotor.thrust_linear_n_rpm + rotor.thrust_square_n_rpm2 * rpm) * rpm)
    share = 1.0 / np.maximum(thrust_n.mean(axis=0), rotor.thrust_min_n)  # weak motors get higher duty cycles
    share /= share.mean()
    gained_m_s = r.velocity_m_s[first[-1], 2] - r.velocity_m_s[first[0], 2]
    lift_m_s2 = params.contact.gravity_m_s2 + gained_m_s / (r.time_s[first[-1]] - r.time_s[first[0]])
    x, y = r.attitude[first, 1], r.attitude[first, 2]
    up = 1.0 - 2.0 * (x * x + y * y)  # z component of the body's z axis; 1: level
    thrust = params.body.mass_kg * lift_m_s2 / float((thrust_n @ share * up).mean())
    m1, m2, m3, m4 = share.tolist()
    hover_rpm = rotor.rpm(params.body.mass_kg * params.contact.gravity_m_s2 / 4.0 / thrust)
    power = float((rpm * rpm * rpm).mean()) / hover_rpm**3  # mean power divided by the power of hover
    current_a = battery.idle_current_a + battery.hover_current_a * power
    rest_v = float(r.battery_v[first].mean()) + battery.resistance_ohm * current_a
    charge = (rest_v - battery.empty_v) / (battery.full_v - battery.empty_v)
    # charge used in the take-off
    charge += current_a * (r.time_s[first].mean() - r.time_s[start]) / battery.charge_a_s
    return Plant(thrust=thrust, motors=(m1, m2, m3, m4), battery_charge=charge)


def _flown(r: Recording, compared: Mask, position_m: Floats, duty: Floats) -> Flown:
    assert r.setpoint_position_m is not None
    error, duty = (position_m - r.setpoint_position_m)[compared], duty[compared]
    return Flown(
        float(np.sqrt((error[:, :2] ** 2).sum(axis=1).mean())),
        float(np.sqrt((error[:, 2] ** 2).mean())),
        float(duty.mean()),
        float((duty.max(axis=1) >= SATURATED).mean()),
    )
