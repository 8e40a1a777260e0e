"""A take-off beside a robot that drives already: the start is reached relative to it."""

from dataclasses import replace

import pytest

from flightstack.core.types import Phase
from sim.runners.landing import land
from sim.scenarios.scenario import load

LAB, GROUND = load("lab"), load("paper_moving_1")
STRAIGHT, CIRCLE = load("straight").target.path, GROUND.target.path


def take_off(path, speed_m_s, turn_rate_rad_s=0.0):
    """Phases of a flight from the ground, with the reason why each began."""
    target = replace(
        GROUND.target, path=path, speed_m_s=speed_m_s, speed_max_m_s=speed_m_s, heading_rad=2.0,
        turn_rate_rad_s=turn_rate_rad_s, wait_for_landing=False,
    )  # fmt: skip
    onboard = replace(LAB.onboard, takeoff=replace(GROUND.onboard.takeoff, timeout_s=15.0))
    phases = {}

    def note(tick, out):
        if out.transition is not None:
            phases.setdefault(out.transition.after, (tick.now_s, out.transition.reason))

    scenario = replace(LAB, start=GROUND.start, target=target, onboard=onboard, duration_max_s=40.0)
    land(scenario, 5, on_step=note)
    return phases


@pytest.mark.slow
@pytest.mark.parametrize("speed_m_s", [0.3])
@pytest.mark.parametrize(("path", "turn_rate_rad_s"), [(STRAIGHT, 0.0), (CIRCLE, 0.5), (CIRCLE, -0.2)])
def test_the_start_beside_a_driving_robot_is_reached(path, turn_rate_rad_s, speed_m_s):
    phases = take_off(path, speed_m_s, turn_rate_rad_s)
    assert phases[Phase.APPROACH][1] == "start reached"
    assert Phase.LANDED in phases
