"""A second-order velocity loop that replaces the vehicle, and flights along references or to a target."""

import numpy as np
from scipy.linalg import expm

from flightstack.core.parameters.robust import VelocityLoop
from flightstack.core.strategies.velocity_tracking import VelocityTracking
from flightstack.core.types import ZERO
from tests.unit.verify.certificate_helpers import config

T_S = 0.01
LOOP = VelocityLoop()
WIDE = (5.0, 5.0, 5.0)
AXES = (0, 1, 2)


class Plant:
    """Second-order loop per axis, advanced exactly from tick to tick: v'' = w^2 (u + push - v) - 2 z w v'."""

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
    """Fly a sequence of velocity references; return tracker, set-points and velocities of all ticks."""
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


FEEDBACK = {
    "horizontal": True, "error_rate_1_s": 4.5, "tilt_rate_1_s": 15.0, "observer_rate_1_s": 25.0,
}  # fmt: skip
BASE = {
    "velocity_feedback": FEEDBACK,
    "velocity_loop": {"rate_xy_1_s": 5.2, "damping": 0.68, "slope_time_s": 0.04, "error_max_m_s": 5.0},
    "own": {"delay_s": 0.03},
    "robust": {"gain_over_pad_1_s": 2.4},
}


def fed_back(**sections):
    merged = {name: {**values, **sections.get(name, {})} for name, values in BASE.items()}
    return config(**{**sections, **merged})


def flown_behind(settings, factor, accelerations, errors=None, start_m=0.0):
    """Return the position relative to the target after each tick, m; the start is at rest at ``start_m``.

    ``factor``: rate of the vehicle's velocity loop divided by the declared rate; ``accelerations`` of the
    target, m/s^2, and ``errors`` of the wanted velocity, m/s: one value for each tick.
    """
    errors = np.zeros(len(accelerations)) if errors is None else errors
    period_s, gain = 1.0 / settings.loop.rate_hz, settings.robust.gain_over_pad_1_s
    tracking = VelocityTracking(
        settings.velocity_loop, period_s, settings.velocity_feedback, settings.own.delay_s
    )
    plant, late = Plant(settings.velocity_loop, rate=factor), round(settings.own.delay_s / period_s)
    position, target, before, sent = start_m, 0.0, -gain * start_m, ZERO
    measured, path = [0.0] * (late + 1), []
    for n, (acceleration, error) in enumerate(zip(accelerations, errors, strict=True)):
        seen = (measured[-1 - late], 0.0, 0.0)
        tracking.observe(seen, commanding=n > 0)
        wanted = target + error - gain * position
        setpoint = tracking.command((before, 0.0, 0.0), (wanted, 0.0, 0.0), seen, (50.0, 50.0, 50.0))
        plant.fly(sent)  # a set-point takes effect one tick later
        before, sent = wanted, setpoint
        target += period_s * acceleration
        position += period_s * (plant.velocity[0] - target)
        measured.append(plant.velocity[0])
        path.append(position)
    return np.array(path)
