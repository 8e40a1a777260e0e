"""Tests when each condition flag is set, and when it is clear."""

import math
from dataclasses import replace

import pytest

from flightstack.core.fleet.precedence import ALONE, Permissions
from flightstack.core.memory import Memory
from flightstack.core.mission.conditions import LANDED_SETTLE_S, Situation, high_enough_m
from flightstack.core.strategies.packaged.robust import DRIFT_SHARE
from flightstack.core.types import Charge, Landed, Mode, Operator, Phase
from tests.unit.core.mission.mission_helpers import BARRIER, NOW_S, PAD, PAPER, ROBUST, names, starting, tick

WELL = {"ARMED", "WAS_ARMED", "EXTERNAL", "WAS_EXTERNAL", "READY", "RETRIES_LEFT", "TARGET_KNOWN"}


def test_when_all_is_well():
    assert names(tick(memory=Memory(phase_since_s=NOW_S))) == WELL


@pytest.mark.parametrize(
    ("changes", "more", "less"),
    [
        ({"operator": Operator.EMERGENCY_STOP}, {"EMERGENCY"}, set()),
        ({"operator": Operator.ABORT}, {"ABORT_ASKED"}, set()),
        ({"operator": Operator.TIME_OVER}, {"ABORT_ASKED"}, set()),
        ({"operator": Operator.LAND}, {"ABORT_ASKED", "LAND_ASKED"}, set()),
        ({"failed": True}, {"COMMAND_FAILED"}, set()),
        ({"follows": False}, {"NOT_FOLLOWING"}, set()),
        ({"trusted": False}, {"OWN_LOST"}, {"READY"}),
        ({"without": ("own",)}, {"OWN_LOST"}, {"READY"}),
        ({"without": ("target",)}, {"TARGET_LOST"}, {"READY", "TARGET_KNOWN"}),
        ({"without": ("status",)}, {"LINK_LOST"}, WELL - {"RETRIES_LEFT", "TARGET_KNOWN"}),
        ({"landed": Landed.ON_GROUND, "e": (1.0, 0.0, 0.0)}, {"STANDING"}, set()),
        # PX4 remains in external mode when disarmed after a landing by set-points: WAS_EXTERNAL is clear
        ({"armed": False}, set(), {"ARMED", "WAS_ARMED", "WAS_EXTERNAL"}),
        ({"armed": False, "ready": False}, set(), {"ARMED", "WAS_ARMED", "WAS_EXTERNAL", "READY"}),
        ({"ready": False}, set(), set()),  # "not ready to arm" changes no flag of an armed vehicle
        ({"mode": Mode.HOLD}, set(), {"EXTERNAL", "WAS_EXTERNAL"}),
    ],
)
def test_one_thing_at_a_time(changes, more, less):
    assert names(tick(memory=Memory(phase_since_s=NOW_S), **changes)) == (WELL | more) - less


@pytest.mark.parametrize(
    ("below_m", "landed", "phase", "ready"),
    [
        (0.14, Landed.ON_GROUND, Phase.WAIT, True),
        (0.16, Landed.ON_GROUND, Phase.WAIT, False),
        (0.16, Landed.IN_AIR, Phase.WAIT, True),
        (0.16, Landed.ON_GROUND, Phase.HOLD, True),
    ],
)
def test_a_landing_spot_below_the_ground_allows_no_take_off(below_m, landed, phase, ready):
    e = (1.0, 0.0, ROBUST.touchdown.feet_below_reference_m + below_m)
    flags = names(tick(e=e, landed=landed, memory=Memory(phase=phase, phase_since_s=NOW_S)))
    assert ("READY" in flags) is ready


def test_a_vehicle_on_a_table_takes_off_where_the_configuration_allows_it():
    table = starting(checks={"target_below_max_m": 0.8})
    flags = tick(table, e=(1.0, 0.0, 0.75), landed=Landed.ON_GROUND, memory=Memory(phase_since_s=NOW_S))
    assert "READY" in names(flags)


@pytest.mark.parametrize(
    ("name", "limit_s", "lost"),
    [
        ("own_age_s", ROBUST.checks.own_age_max_s, "OWN_LOST"),
        ("target_age_s", ROBUST.checks.target_age_max_s, "TARGET_LOST"),
        ("status_age_s", ROBUST.checks.status_age_max_s, "LINK_LOST"),
    ],
)
def test_inputs_are_lost_when_they_are_too_old(name, limit_s, lost):
    for age_s, expected in ((limit_s - 1e-9, False), (limit_s + 1e-9, True), (1e9, True)):
        assert (lost in names(tick(**{name: age_s}))) is expected
    assert lost in names(tick(**{name: math.nan}))


def test_a_state_from_the_future_is_as_wrong_as_an_old_one():
    assert "OWN_LOST" not in names(tick(own_age_s=-0.049))
    assert "OWN_LOST" in names(tick(own_age_s=-0.051))


def test_recovered_is_good_for_long_enough_without_a_break():
    memory, wait_s = Memory(phase=Phase.HOLD), ROBUST.checks.recovery_time_s
    assert "RECOVERED" not in names(tick(memory=memory))
    assert "RECOVERED" not in names(tick(memory=memory, now_s=NOW_S + wait_s - 1e-6))
    assert "RECOVERED" in names(tick(memory=memory, now_s=NOW_S + wait_s + 1e-6))
    for without in ("own", "target", "status"):
        assert "RECOVERED" not in names(tick(memory=memory, now_s=NOW_S + 1.0, without=(without,)))
        assert "RECOVERED" not in names(tick(memory=memory, now_s=NOW_S + 1.01))
        assert "RECOVERED" in names(tick(memory=memory, now_s=NOW_S + 1.02 + wait_s))


@pytest.mark.parametrize(
    ("phase", "limit_s"),
    [
        (Phase.WAIT, ROBUST.checks.wait_time_max_s),
        (Phase.TAKEOFF, ROBUST.takeoff.timeout_s),
        (Phase.TOUCHDOWN, ROBUST.touchdown.timeout_s),
        (Phase.HOLD, ROBUST.checks.hold_time_s),
        (Phase.CLIMB, ROBUST.checks.climb_time_max_s),
        (Phase.LEAVE, ROBUST.retreat.abort_time_max_s),
    ],
)
def test_a_phase_has_its_time(phase, limit_s):
    for spent_s, over in ((limit_s - 1e-6, False), (limit_s + 1e-6, True)):
        memory = Memory(phase=phase, phase_since_s=NOW_S - spent_s)
        assert ("PHASE_TIME_OVER" in names(tick(memory=memory))) is over


@pytest.mark.parametrize(
    ("changes", "wanted"),
    [
        ({}, True),
        ({"permissions": ALONE}, False),
        ({"memory": Memory(phase=Phase.LANDED, phase_since_s=NOW_S - LANDED_SETTLE_S + 1e-6)}, False),
        ({"memory": Memory(phase=Phase.TOUCHDOWN)}, False),
        ({"charge": Charge.TIRED}, False),
        ({"charge": Charge.UNKNOWN}, False),
        *[({"without": (lost,)}, False) for lost in ("own", "target", "status")],
    ],
)
def test_a_pad_is_left_after_the_rest_with_all_that_a_flight_needs(changes, wanted):
    rested = Memory(phase=Phase.LANDED, phase_since_s=NOW_S - LANDED_SETTLE_S - 1e-6)
    given = {"memory": rested, "permissions": Permissions(pad_wanted=True), "armed": False, "ready": False}
    found = tick(**{**given, **changes})
    assert ("PAD_WANTED" in names(found)) is wanted


def test_the_landing_has_its_time():
    limit_s = ROBUST.checks.landing_time_max_s
    assert not {"STARTED", "LANDING_TIME_OVER"} & names(tick(memory=Memory(phase=Phase.APPROACH)))
    for spent_s, over in ((limit_s - 1e-6, False), (limit_s + 1e-6, True)):
        found = names(tick(memory=Memory(phase=Phase.APPROACH, started_s=NOW_S - spent_s)))
        assert "STARTED" in found
        assert ("LANDING_TIME_OVER" in found) is over


def test_high_enough_is_above_the_peak_over_where_the_target_was_last():
    memory = Memory(phase=Phase.CLIMB, target_position_enu_m=PAD)
    edge = high_enough_m(Situation(ROBUST, None, memory))
    assert edge == pytest.approx(PAD[2] + 1.5 / math.e + ROBUST.retreat.climb_margin_m)
    assert high_enough_m(Situation(ROBUST, None, Memory())) == pytest.approx(edge - PAD[2])
    for above, expected in ((1e-9, True), (-1e-9, False)):
        e = (0.5, 0.0, edge - PAD[2] + above)
        assert ("HIGH_ENOUGH" in names(tick(e=e, memory=memory))) is expected
        assert "HIGH_ENOUGH" not in names(tick(e=e, memory=replace(memory, phase=Phase.HOLD)))


def touch(settings, e, **changes):
    return "TOUCH" in names(tick(settings, e=e, memory=Memory(phase=Phase.LAND), **changes))


def test_the_papers_touchdown_rule():
    assert touch(PAPER, (0.0, 0.0, 0.049))
    assert not touch(PAPER, (0.0, 0.0, 0.051))
    assert not touch(PAPER, (0.03, 0.0, 0.9 * BARRIER.height(0.03)))  # h < 0: the vehicle is outside the cone
    assert touch(PAPER, (0.03, 0.0, 1.01 * BARRIER.height(0.03)))
    wide = starting("paper", touchdown={"height_m": 0.2, "pad_radius_m": 0.05})
    assert touch(wide, (0.049, 0.0, 0.15))
    assert not touch(wide, (0.051, 0.0, 0.15))
    # the rule depends neither on the velocity nor on the uncertainty
    assert touch(PAPER, (0.0, 0.0, 0.049), velocity=(0.4, 0.0, 0.0), sigma_m=1.0)


def drifted(settings, e, **changes):
    memory = Memory(phase=changes.pop("phase", Phase.TOUCHDOWN), contact=changes.pop("contact", False))
    return "DRIFTED" in names(tick(settings, e=e, memory=memory, **changes))


def test_it_goes_around_when_it_is_going_to_leave_the_corridor():
    corridor = ROBUST.robust.corridor_m
    d = 0.8 * corridor
    high = BARRIER.height(d) + ROBUST.retreat.h_left_m
    edge = (corridor - d) / ROBUST.retreat.drift_time_s
    for axis, sign in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
        for share, expected in ((1.01, True), (0.99, False)):
            e, v = [0.0, 0.0, high + 1e-6], [0.0, 0.0, -0.2]
            e[axis], v[axis] = sign * d, sign * share * edge
            moving = tuple(v)
            assert drifted(ROBUST, tuple(e), velocity=moving) is expected
            assert drifted(ROBUST, tuple(e), target_velocity=tuple(-x for x in moving)) is expected
            assert not drifted(ROBUST, tuple(e), velocity=tuple(-x for x in moving))
    ask = {"velocity": (2.0 * edge, 0.0, 0.0)}
    assert drifted(ROBUST, (d, 0.0, high + 1e-6), **ask)
    assert not drifted(ROBUST, (d, 0.0, high - 1e-6), **ask)  # the vehicle is too low for a go-around
    assert not drifted(ROBUST, (d, 0.0, high + 1e-6), contact=True, **ask)
    assert not drifted(ROBUST, (d, 0.0, high + 1e-6), phase=Phase.LAND, **ask)
    assert not drifted(PAPER, (d, 0.0, high + 1e-6), **ask)
    near = DRIFT_SHARE * corridor
    for x, expected in ((near - 1e-6, False), (near + 1e-6, True)):
        assert drifted(ROBUST, (x, 0.0, 0.2), velocity=(5.0, 0.0, 0.0)) is expected


def test_retries_are_counted():
    most = ROBUST.checks.retries_max
    assert "RETRIES_LEFT" in names(tick(memory=Memory(retries=most - 1)))
    assert "RETRIES_LEFT" not in names(tick(memory=Memory(retries=most)))


def test_over_the_pad_is_left_at_a_wider_radius_than_it_is_entered():
    radius = ROBUST.touchdown.pad_radius_m
    for phase, limit in ((Phase.APPROACH, radius), (Phase.LAND, 1.5 * radius)):
        for d, expected in ((limit - 1e-9, True), (limit + 1e-9, False)):
            found = names(tick(e=(0.0, -d, 0.3), memory=Memory(phase=phase)))
            assert ("OVER_PAD" in found) is expected
    peak = BARRIER.peak_height_m
    for z, expected in ((peak - 1e-9, True), (peak + 1e-9, False)):
        assert ("OVER_PAD" in names(tick(e=(0.01, 0.0, z), memory=Memory(phase=Phase.APPROACH)))) is expected
