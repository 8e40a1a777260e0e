"""A vehicle that swings over the pad: seen by its phases and by the time over the pad, and said so."""

from dataclasses import replace

import pytest

from flightstack.config.files import load as load_config
from flightstack.core.memory import Memory
from flightstack.core.mission.phases import SWINGING
from flightstack.core.types import Phase
from logs.verdict.types import Outcome
from sim.runners.landing import land
from sim.scenarios.scenario import load
from tests.unit.core.mission.mission_helpers import NOW_S, PAPER, ROBUST, names, tick

CHECKS, PAD_M = ROBUST.checks, ROBUST.touchdown.pad_radius_m
IN, OUT = (0.0, 0.0, 0.3), (3.0 * PAD_M, 0.0, 0.3)


@pytest.mark.parametrize(
    ("swings", "in_phase_s", "e", "expected"),
    [
        (CHECKS.swings_max, 0.1, OUT, True),
        (CHECKS.swings_max, 0.1, IN, False),
        (CHECKS.swings_max - 1, 0.1, OUT, False),
        (0, CHECKS.over_pad_time_max_s + 0.1, IN, True),
        (0, CHECKS.over_pad_time_max_s - 0.1, IN, False),
    ],
)
def test_leaving_the_cone_again_and_again_and_staying_in_it_is_swinging(swings, in_phase_s, e, expected):
    began_s = NOW_S - in_phase_s
    memory = Memory(phase=Phase.LAND, swings=swings, phase_since_s=began_s, started_s=began_s)
    assert ("SWINGS" in names(tick(e=e, memory=memory))) is expected
    assert "SWINGS" not in names(tick(PAPER, e=e, memory=memory))  # as printed: it has no such rule
    memory.phase = Phase.APPROACH
    assert "SWINGS" not in names(tick(e=e, memory=memory))


def test_the_wait_for_a_calm_robot_does_not_count():
    settings = replace(ROBUST, touchdown=replace(ROBUST.touchdown, calm_wait_s=10.0))
    for over_s, expected in ((9.9, False), (10.1, True)):
        began_s = NOW_S - CHECKS.over_pad_time_max_s - over_s
        memory = Memory(phase=Phase.LAND, phase_since_s=began_s, started_s=began_s)
        assert ("SWINGS" in names(tick(settings, e=IN, memory=memory))) is expected


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2])
def test_a_loop_slower_than_configured_ends_by_its_own_reason(seed):
    """ArduCopter 4.7's loop with the configuration for the older one swung for two minutes."""
    scenario = replace(load("ardupilot_47"), onboard=load_config("ardupilot-1kg"), duration_max_s=40.0)
    landing = land(scenario, seed, on_step=lambda *_: None)  # tick by tick: nothing else to compile
    assert landing.verdict.outcome is Outcome.ABORTED
    assert f"LAND -> ABORT: {SWINGING}: left the cone over it 4 times" in landing.verdict.reason
    assert landing.simulated_s < 40.0
