"""A configuration with fed-back velocity, and its loop flown behind a target by the code's own ticks."""

import numpy as np

from flightstack.core.strategies.velocity_tracking import VelocityTracking
from flightstack.core.types import ZERO
from tests.unit.core.target.tracking_helpers import Plant
from tests.unit.verify.certificate_helpers import config

FEEDBACK = {
    "horizontal": True, "error_rate_1_s": 4.5, "tilt_rate_1_s": 15.0, "observer_rate_1_s": 25.0,
}  # fmt: skip
BASE = {
    "velocity_feedback": FEEDBACK,
    "velocity_loop": {"rate_xy_1_s": 5.2, "damping": 0.68, "slope_time_s": 0.04, "error_max_m_s": 5.0},
    "own": {"delay_s": 0.03},
    "robust": {"gain_over_pad_1_s": 2.4},
}
WIDE = (50.0, 50.0, 50.0)


def fed_back(**sections):
    merged = {name: {**values, **sections.get(name, {})} for name, values in BASE.items()}
    return config(**{**sections, **merged})


def flown(settings, factor, accelerations, errors=None, start_m=0.0):
    """Position against the target, m, tick by tick, of a vehicle at rest that begins ``start_m`` off.

    Args:
        settings: of the onboard process.
        factor: by which the vehicle's velocity loop is faster than declared.
        accelerations: of the target at each tick, m/s^2.
        errors: of the velocity wanted, m/s; by default none.
        start_m: from the middle.
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
        setpoint = tracking.command((before, 0.0, 0.0), (wanted, 0.0, 0.0), seen, WIDE)
        plant.fly(sent)  # it comes a tick late
        before, sent = wanted, setpoint
        target += period_s * acceleration
        position += period_s * (plant.velocity[0] - target)
        measured.append(plant.velocity[0])
        path.append(position)
    return np.array(path)
