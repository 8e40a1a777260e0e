"""Compares the flights of ``runs`` with the linear models; each flight is flown once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from flightstack.compiled.records import new
from sim.plant.rotors import GroundRecord, set_up_ground, thrust_increase
from tests import linear_analysis as analysis
from tests.benchmarks.vehicle import runs
from tests.unit.vehicle.vehicle_sim_helpers import QUIET

F64 = npt.NDArray[np.float64]
C128 = npt.NDArray[np.complex128]
STEP_M_S, TURN_RAD, RELEASE_RAD = 0.2, 0.3, math.radians(10.0)
STEPS_S = {"roll": 0.8, "velocity": 3.0, "yaw": 5.0}
LAGS = {False: analysis.PARAMS.rotor.lag_s, True: analysis.slow_lag_s()}
NAMES = {False: "nominal motors", True: "slow motors"}
ROTOR = analysis.PARAMS.rotor
WEIGHT_N = analysis.MASS * analysis.G


@dataclass(frozen=True)
class Step:
    """Simulated and linear response every 2 ms, divided by the step size, and poles of the linear model."""

    t: F64
    simulated: F64
    linear: F64
    poles: C128 | None

    @property
    def modes(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return natural frequency (rad/s) and damping ratio of the oscillation, simulated and linear.

        One oscillation and one decay are fitted to the simulated response; the model's nearest pole is
        compared.
        """
        assert self.poles is not None
        found = next(p for p in analysis.prony_poles(self.simulated, analysis.DT, 3) if p.imag > 1.0)
        nearest = self.poles[np.argmin(np.abs(self.poles - found))]
        simulated, linear = ((float(abs(p)), float(-p.real / abs(p))) for p in (found, nearest))
        return simulated, linear


def _step(every_ms: F64, linear: F64, poles: C128 | None = None) -> Step:
    """Return a step from a record with one sample per millisecond."""
    simulated = every_ms[1::2]
    return Step(analysis.DT * np.arange(1, len(simulated) + 1), simulated, linear, poles)


@cache
def hover() -> runs.Run:
    """Return the record of a vehicle that hovers until its battery is empty."""
    return runs.hover_until_empty(430.0)


@cache
def roll(slow: bool) -> Step:
    """Return the response after a release of the vehicle at a roll of 10 degrees."""
    rolled = runs.roll_release(RELEASE_RAD, STEPS_S["roll"], slow=slow).roll / RELEASE_RAD
    model = analysis.roll_loop(LAGS[slow])
    return _step(rolled, 1.0 - model.response(STEPS_S["roll"]), model.poles())  # decay of the error


@cache
def velocity(slow: bool, axis: int, *, late: bool = False) -> Step:
    """Return a velocity step: half the difference of a step in both directions, which removes biases.

    ``late``: with the motion capture's delay of 10 ms, which the linear models omit.
    """
    seconds = STEPS_S["velocity"]
    ways = [
        runs.velocity_step(
            tuple(s * STEP_M_S * (i == axis) for i in range(3)),
            seconds,
            slow=slow,
            mocap=QUIET if late else runs.PROMPT,
        )
        for s in (1.0, -1.0)
    ]
    moved = (ways[0].velocity - ways[1].velocity)[:, axis] / (2.0 * STEP_M_S)
    model = (analysis.vertical_loop if axis == 2 else analysis.horizontal_loop)(LAGS[slow])
    return _step(moved, model.response(seconds), model.poles())


@cache
def yaw(slow: bool) -> Step:
    """Return the response to a yaw step with the paper's gains."""
    turned = runs.yaw_step(TURN_RAD, STEPS_S["yaw"], slow=slow).yaw / TURN_RAD
    model = analysis.yaw_loop(LAGS[slow])
    return _step(turned, model.response(STEPS_S["yaw"]), model.poles())


@cache
def landing(speed_m_s: float, drop: bool, driving: bool) -> runs.Run:
    """Return the record of a touchdown by contact, or by a motor stop 5 cm above the pad."""
    return runs.touchdown(
        speed_m_s, motors_off_below_m=0.05 if drop else None, target=runs.DRIVING if driving else None
    )


def touch_index(run: runs.Run) -> int:
    """Return the index of the first step in contact with the pad."""
    return int(np.argmax(run.pad_contact))


def rise_s(t: F64, y: F64, end: float) -> float:
    """Return the rise time from 10 to 90 % of the final value."""
    low, high = (float(t[np.argmax(y >= share * end)]) for share in (0.1, 0.9))
    return high - low


def increase(height_m: float) -> float:
    """Return the relative thrust increase T/T0 - 1 of the simulated rotor in ground effect."""
    return thrust_increase(set_up_ground(new(GroundRecord), ROTOR, 1.0, 0.1), height_m)
