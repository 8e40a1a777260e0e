"""A plant for tests of the set-point's corrections, and a flight of references with it."""

import numpy as np
from scipy.linalg import expm

from flightstack.core.parameters.robust import VelocityLoop
from flightstack.core.strategies.velocity_tracking import VelocityTracking
from flightstack.core.types import ZERO

T_S = 0.01
LOOP = VelocityLoop()
WIDE = (5.0, 5.0, 5.0)
AXES = (0, 1, 2)


class Plant:
    """Second order on each axis, carried exactly from tick to tick: v'' = w^2 (u + push - v) - 2 z w v'."""

    def __init__(self, loop=LOOP, rate=1.0, damping=1.0, push=ZERO):
        rates = (loop.rate_xy_1_s, loop.rate_xy_1_s, loop.rate_z_1_s)
        self.state, self.push, self.steps = [np.zeros(2) for _ in AXES], push, []
        for w in (rate * r for r in rates):
            block = np.zeros((3, 3))
            block[0, 1], block[1] = 1.0, (-w * w, -2.0 * damping * loop.damping * w, w * w)
            self.steps.append(expm(block * T_S))

    @property
    def velocity(self):
        return tuple(float(s[0]) for s in self.state)

    def fly(self, setpoint):
        for axis, (step, u, push) in enumerate(zip(self.steps, setpoint, self.push, strict=True)):
            self.state[axis] = step[:2, :2] @ self.state[axis] + step[:2, 2] * (u + push)


def flown(references, plant, tracking=None, most=WIDE):
    """Fly references tick by tick; returns the tracker, set-points and velocities."""
    tracking = tracking or VelocityTracking(LOOP, T_S)
    before, setpoints, velocities = references[0], [], []
    for reference in references:
        tracking.observe(plant.velocity, commanding=bool(setpoints))
        setpoints.append(tracking.command(before, reference, plant.velocity, most))
        plant.fly(setpoints[-1])
        velocities.append(plant.velocity)
        before = reference
    return tracking, setpoints, np.array(velocities)


def constant(reference, seconds=20.0):
    return [reference] * round(seconds / T_S)
