"""Flights for docs/how_it_works/vehicle.md; fixed seeds and parameters give reproducible numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from logs.schema.events import ContactBit
from sim.plant.params import STEP_S, Plant, load
from sim.plant.rotors import Rotors, turn_rotors
from sim.robot.target import TargetModel
from sim.scenarios.scenario import (
    OdometryLink,
    PathKind,
    Start,
    StartKind,
    TargetSpec,
    VehicleSpec,
    VelocityLoop,
)
from sim.vehicle.vehicle import Truth, VehicleSim
from tests.unit.vehicle.vehicle_sim_helpers import QUIET, scenario

F64 = npt.NDArray[np.float64]
SEED = 1
PROMPT = OdometryLink(100.0)  # motion capture without delay, as in the linear models
PARAMS = load()


@dataclass(frozen=True)
class Run:
    """Recorded values, one sample per millisecond; ENU, SI units."""

    t: F64
    position: F64  # position of the vehicle, (n, 3)
    velocity: F64
    roll: F64
    yaw: F64
    rpm: F64  # rotor speeds, rpm, (n, 4)
    ground_factor: F64  # mean ground-effect factor of the four rotors
    relative: F64  # position of the vehicle minus that of the pad, (n, 3)
    relative_velocity: F64
    pad_contact: npt.NDArray[np.bool_]
    battery_v: F64


def make(height_m: float = 3.0, *, target: TargetSpec | None = None, **vehicle: object) -> VehicleSim:
    """Return a vehicle in hover above the pad, motion capture without noise."""
    spec = VehicleSpec(**{"mocap": QUIET, **vehicle})
    start = Start(StartKind.HOVER, offset_m=(0.0, 0.0, height_m))
    return VehicleSim(scenario(start=start, vehicle=spec, target=target or TargetSpec()), SEED)


def _row(sim: VehicleSim, truth: Truth) -> tuple[object, ...]:
    w, x, y, z = truth.quaternion
    e = [a - b for a, b in zip(truth.position_enu_m, truth.pad_position_enu_m, strict=True)]
    v = [a - b for a, b in zip(truth.velocity_enu_m_s, truth.pad_velocity_enu_m_s, strict=True)]
    return (
        truth.time_s, truth.position_enu_m, truth.velocity_enu_m_s,
        math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
        truth.rotor_rpm, sim._rotors.record.ground_factors.mean(), e, v,
        bool(truth.contacts & ContactBit.PAD), truth.battery_v,
    )  # fmt: skip


def record(
    sim: VehicleSim, seconds: float, each: Callable[[int], bool] | None = None, *, every_ms: int = 1
) -> Run:
    """Run the vehicle and record it; ``each`` is called every 10 ms and ends the run if it returns True."""
    rows = []
    begin = sim.truth().time_s
    for ms in range(0, round(seconds * 1000.0), every_ms):
        if ms % 10 == 0 and each is not None and each(ms):
            break
        sim.advance(every_ms)
        rows.append(_row(sim, sim.truth()))
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    columns[0] = columns[0] - begin
    return Run(*columns)


def hold(sim: VehicleSim, velocity: tuple[float, float, float], yaw: float = 0.0) -> Callable[[int], bool]:
    """Send this set-point to the vehicle every 10 ms."""

    def send(ms: int) -> bool:
        sim.set_velocity(velocity, yaw)
        return False

    return send


def hover_until_empty(seconds: float) -> Run:
    """Hover with a decreasing battery charge; return the record with a sample every 100 ms."""
    sim = make()
    return record(sim, seconds, hold(sim, (0.0, 0.0, 0.0)), every_ms=100)


def motor_step(slow: bool, from_rpm: float, to_rpm: float, seconds: float) -> tuple[F64, F64]:
    """Return time and speed of a rotor after a step of its command."""
    rotors = Rotors(PARAMS.rotor, Plant(), slow, STEP_S)
    rotors.rpm = (from_rpm,) * 4
    speeds = [from_rpm]
    for _ in range(round(seconds / STEP_S)):
        turn_rotors(rotors.record, np.full(4, to_rpm), 0.0, 0.0)
        speeds.append(rotors.rpm[0])
    return np.arange(len(speeds)) * STEP_S, np.array(speeds)


def velocity_step(
    velocity: tuple[float, float, float],
    seconds: float,
    *,
    slow: bool = False,
    mocap: OdometryLink = PROMPT,
) -> Run:
    """Return the record of a velocity step from hover at time zero, without the radio's delay."""
    sim = make(velocity_loop=VelocityLoop.PAPER, slow_motors=slow, mocap=mocap, setpoint_delay_s=0.0)
    record(sim, 0.5, hold(sim, (0.0, 0.0, 0.0)))
    return record(sim, seconds, hold(sim, velocity))


def yaw_step(yaw_rad: float, seconds: float, *, slow: bool = False) -> Run:
    """Return the record of a yaw step from hover at time zero, without the radio's delay."""
    sim = make(velocity_loop=VelocityLoop.PAPER, slow_motors=slow, mocap=PROMPT, setpoint_delay_s=0.0)
    record(sim, 0.5, hold(sim, (0.0, 0.0, 0.0)))
    return record(sim, seconds, hold(sim, (0.0, 0.0, 0.0), yaw_rad))


def roll_release(roll_rad: float, seconds: float, *, slow: bool = False) -> Run:
    """Return the record after a release at a roll angle; the firmware levels out, as with old set-points.

    The firmware holds zero roll, independent of the velocity. The initial estimate is exact.
    """
    sim = make(velocity_loop=VelocityLoop.PAPER, slow_motors=slow)
    record(sim, 0.5, hold(sim, (0.0, 0.0, 0.0)))
    while "levelling" not in sim.state_text:
        sim.advance(1)
    quaternion = (math.cos(0.5 * roll_rad), math.sin(0.5 * roll_rad), 0.0, 0.0)
    sim._world.set_vehicle(sim._world.position, quaternion)
    sim._settle()
    return record(sim, seconds)


def touchdown(
    speed_m_s: float, *, motors_off_below_m: float | None = None, target: TargetSpec | None = None
) -> Run:
    """Return the record of a descent to the pad from 25 cm at the pad's horizontal velocity.

    ``motors_off_below_m``: height over the pad at which the motors stop; None: 0.5 s after contact;
    ``target``: a driving pad; None: the pad at rest.
    """
    spec = target or TargetSpec()
    deck = TargetModel(spec, SEED)
    for _ in range(300):  # the pad reaches its speed before time zero
        deck.step(0.01, True)
    sim = make(0.25, target=spec)
    pad = deck.pose.position_enu_m
    sim._world.set_vehicle((pad[0], pad[1], pad[2] + 0.25), velocity=deck.velocity_enu_m_s)
    sim._settle()
    off = False

    def each(ms: int) -> bool:
        nonlocal off
        sim.set_deck(deck.pose.position_enu_m, deck.pose.yaw_rad, deck.velocity_enu_m_s, deck.yaw_rate_rad_s)
        vx, vy, vz = deck.velocity_enu_m_s
        deck.step(0.01, True)
        height = sim._world.position[2] - sim._world.deck_position[2]
        off = off or sim.landed or (motors_off_below_m is not None and height < motors_off_below_m)
        if off:
            sim.stop_setpoint()
        else:
            sim.set_velocity((vx, vy, vz - speed_m_s), 0.0)
        return False

    return record(sim, 2.5, each)


DRIVING = TargetSpec(path=PathKind.CIRCLE, speed_m_s=0.1, turn_rate_rad_s=0.1)  # scenario 2 of the paper
