"""What the compiled parts of a vehicle's millisecond cost, each called in a compiled loop of its own."""

from __future__ import annotations

import statistics
import time

from numba import njit

from sim.firmware.stack import control
from sim.plant.params import CONTROL_STEP_S, STEP_S
from sim.plant.rotors import speed_limit
from sim.vehicle.loop import cushion, push, sense
from sim.vehicle.vehicle import VehicleSim
from sim.world.step import physics_step

CALLS = 50  # short enough to stay near the state they begin in; the noise drawn ahead is enough
REPEATS = 201
CONTROL_MS = round(CONTROL_STEP_S / STEP_S)


@njit
def moves(vehicle, calls):
    """Rotors, forces, the step; MuJoCo's share of a standing vehicle's step is not in it."""
    for _ in range(calls):
        push(vehicle[0])
        physics_step(vehicle[0].world)


@njit
def controls(vehicle, calls):
    """Velocity loop, attitude loop, mixer."""
    for _ in range(calls):
        control(vehicle[0].firmware, speed_limit(vehicle[0].battery))


@njit
def cushions(vehicle, calls):
    """Ground effect."""
    for _ in range(calls):
        cushion(vehicle[0])


@njit
def senses(vehicle, calls):
    """IMU and the estimator's prediction."""
    for _ in range(calls):
        sense(vehicle)


KERNELS = {
    "physics: rotors, drag, ground effect, free flight": ((moves, 1), (cushions, CONTROL_MS)),
    "firmware: velocity and attitude loop, mixer": ((controls, CONTROL_MS),),
    "IMU and estimator": ((senses, CONTROL_MS),),
}


def cost_us(kernel, vehicle: VehicleSim) -> float:
    """Median cost of one call, microseconds; the state is put back every time."""
    state = vehicle._vehicle
    kernel(state, 0)
    vehicle._imu.top_up()
    saved = state.copy()
    times_s = []
    for _ in range(REPEATS):
        start_s = time.perf_counter()
        kernel(state, CALLS)
        times_s.append(time.perf_counter() - start_s)
        state[:] = saved
    return statistics.median(times_s) / CALLS * 1e6


def kernel_us_per_ms(vehicle: VehicleSim) -> dict[str, float]:
    """Cost of each part in microseconds per simulated millisecond."""
    return {
        name: sum(cost_us(kernel, vehicle) / every_ms for kernel, every_ms in parts)
        for name, parts in KERNELS.items()
    }
