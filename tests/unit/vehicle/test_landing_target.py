"""The robot of a landing in one process: driving ahead changes nothing of what is seen at a tick."""

from dataclasses import replace

import pytest

from bridge.frames import quaternion_from_yaw, world_from_body, yaw_from_quaternion
from flightstack.common.pacing import RUN_AHEAD_TICKS
from flightstack.core.types import TargetSample
from sim.clock import TickGrid
from sim.robot.target_motion import TargetMotion
from sim.runners.landing_target import DirectTarget, in_world
from sim.scenarios.scenario import load

TICKS = 400
SCENARIOS = {
    name: replace(load(name), target=replace(load(name).target, wait_for_landing=waits))
    for name, waits in (("fault_target_dropout", True), ("reversing", True), ("deck", False))
}


def tick_by_tick(scenario, seed, chosen_at):
    """Deck and samples of every tick, by the formulas of both ends in plain Python."""
    grid = TickGrid(100)
    motion = TargetMotion(scenario, seed, grid)
    driving, go_tick = motion.drives_at_once, chosen_at + RUN_AHEAD_TICKS + 1
    for tick in range(TICKS):
        if tick > 0:
            if go_tick <= tick:
                motion.faults.landing_began(grid.ns(go_tick))
                driving = True
            motion.step(driving)
        model, q = motion.model, quaternion_from_yaw(motion.model.pose.yaw_rad)
        deck = (
            model.pose.position_enu_m,
            yaw_from_quaternion(q),
            world_from_body(q, model.velocity_body_m_s),
            model.yaw_rate_rad_s,
            b"",
        )
        due, motion.due = motion.due, []
        yield deck, tuple(TargetSample(0.01 * tick, *in_world(sample)) for sample in due)


def ahead(scenario, seed, chosen_at):
    """The same by ``DirectTarget``; the onboard side chooses while it answers for a tick."""
    target = DirectTarget(scenario, seed, TickGrid(100))
    for tick in range(TICKS):
        assert target.has(tick)
        yield tuple(target.take(tick)), target.samples(0.01 * tick).samples
        if tick == chosen_at:
            target.landing_began(tick)


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("chosen_at", [0, 1, 18, 19, 20, 21, 137])
def test_the_same_as_tick_by_tick(name, chosen_at):
    expected = list(tick_by_tick(SCENARIOS[name], 3, chosen_at))
    assert repr(list(ahead(SCENARIOS[name], 3, chosen_at))) == repr(expected)
    assert expected[-1][0][2] != (0.0, 0.0, 0.0)
    assert any(samples for _, samples in expected)


def test_samples_nobody_took_come_with_the_next_ones():
    target = DirectTarget(SCENARIOS["deck"], 3, TickGrid(100))
    target.take(0)
    for tick in range(1, 50):
        target.take(tick)
    expected = [s for _, samples in list(tick_by_tick(SCENARIOS["deck"], 3, 0))[:50] for s in samples]
    assert [s.source_time_s for s in target.samples(1.0).samples] == [s.source_time_s for s in expected]
    assert target.samples(1.0).samples == ()
