"""Each condition flag: when it is set, and when it is not; contact, which is remembered."""

import math
from dataclasses import replace

import pytest

from flightstack.core.memory import Memory
from flightstack.core.mission.conditions import high_enough_m, start_point
from flightstack.core.mission.machine import Mission
from flightstack.core.mission.phases import Condition
from flightstack.core.snapshot import snapshot_of
from flightstack.core.strategies.robust import COMMANDED_SHARE, DRIFT_SHARE, STOPPED_SHARE
from flightstack.core.strategies.strategy import strategy_of
from flightstack.core.target.plausibility import Plausibility
from flightstack.core.target.track import TargetState, TargetTrack
from flightstack.core.types import Inputs, Landed, Mode, Operator, OwnState, Phase, VehicleStatus
from tests.point_mass import World
from tests.unit.core.core_helpers import config

NOW_S = 100.0
STILL = (0.0, 0.0, 0.0)
PAD = (3.0, -2.0, 0.2)
C = Condition


def starting(filter="robust", **sections):
    """A configuration with a point where the landing begins."""
    return config(filter, takeoff={"start_offset_m": [-1.4, 0.5, 0.72]}, **sections)


ROBUST, PAPER = starting(), starting("paper")
BARRIER = ROBUST.barrier.build()


def tick(
    settings=ROBUST, e=(1.0, 0.0, 1.0), velocity=STILL, target_velocity=STILL, *, now_s=NOW_S, memory=None,
    sigma_m=0.0, own_age_s=0.01, target_age_s=0.03, status_age_s=0.2, armed=True, mode=Mode.EXTERNAL,
    landed=Landed.IN_AIR, ready=True, operator=Operator.NONE, failed=False, follows=True, believed=True,
    without=(),
):  # fmt: skip
    """Flags of one tick; everything is well unless told otherwise."""
    position = tuple(a + b for a, b in zip(e, PAD, strict=True))
    own = OwnState(now_s - own_age_s, 0.0, position, velocity, 0.0)
    status = VehicleStatus(now_s - status_age_s, armed, mode, landed, ready)
    target = TargetState(target_age_s, PAD, target_velocity, 0.0, sigma_m)
    inputs = Inputs(
        None if "own" in without else own, None if "status" in without else status, (), operator
    )  # fmt: skip
    known = None if "target" in without else target
    seen = snapshot_of(settings, inputs, known, now_s, believed=believed, follows=follows)
    strategy = strategy_of(settings)
    mission = Mission(settings, BARRIER, strategy, TargetTrack(settings.checks), Plausibility(settings))
    mission.memory = memory if memory is not None else Memory()
    return mission.flags(seen, command_failed=failed, now_s=now_s)


def names(word):
    return {c.name for c in Condition if word & c}


WELL = {"ARMED", "WAS_ARMED", "EXTERNAL", "WAS_EXTERNAL", "READY", "RETRIES_LEFT", "TARGET_KNOWN"}


def test_when_all_is_well():
    assert names(tick(memory=Memory(phase_since_s=NOW_S))) == WELL


@pytest.mark.parametrize(
    ("changes", "more", "less"),
    [
        ({"operator": Operator.EMERGENCY_STOP}, {"EMERGENCY"}, set()),
        ({"operator": Operator.ABORT}, {"ABORT_ASKED"}, set()),
        ({"operator": Operator.LAND}, {"ABORT_ASKED", "LAND_ASKED"}, set()),
        ({"failed": True}, {"COMMAND_FAILED"}, set()),
        ({"follows": False}, {"NOT_FOLLOWING"}, set()),
        ({"believed": False}, {"OWN_LOST"}, {"READY"}),
        ({"without": ("own",)}, {"OWN_LOST"}, {"READY"}),
        ({"without": ("target",)}, {"TARGET_LOST"}, {"READY", "TARGET_KNOWN"}),
        ({"without": ("status",)}, {"LINK_LOST"}, WELL - {"RETRIES_LEFT", "TARGET_KNOWN"}),
        ({"landed": Landed.ON_GROUND}, {"STANDING"}, set()),
        # disarmed in the external mode is where a landing by set-points leaves PX4: nothing of this flight
        ({"armed": False}, set(), {"ARMED", "WAS_ARMED", "WAS_EXTERNAL"}),
        ({"armed": False, "ready": False}, set(), {"ARMED", "WAS_ARMED", "WAS_EXTERNAL", "READY"}),
        ({"ready": False}, set(), set()),  # armed is more than ready to arm
        ({"mode": Mode.HOLD}, set(), {"EXTERNAL", "WAS_EXTERNAL"}),
    ],
)
def test_one_thing_at_a_time(changes, more, less):
    assert names(tick(memory=Memory(phase_since_s=NOW_S), **changes)) == (WELL | more) - less


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


def test_what_was_seen_once_is_remembered():
    memory = Memory()
    tick(memory=memory)
    found = names(tick(memory=memory, armed=False, mode=Mode.HOLD))
    assert {"WAS_ARMED", "WAS_EXTERNAL"} <= found
    assert not {"ARMED", "EXTERNAL"} & found


def test_recovered_is_good_for_long_enough_without_a_break():
    memory, wait_s = Memory(), ROBUST.checks.recovery_time_s
    assert "RECOVERED" not in names(tick(memory=memory))
    assert "RECOVERED" not in names(tick(memory=memory, now_s=NOW_S + wait_s - 1e-6))
    assert "RECOVERED" in names(tick(memory=memory, now_s=NOW_S + wait_s + 1e-6))
    for without in ("own", "target", "status"):
        assert "RECOVERED" not in names(tick(memory=memory, now_s=NOW_S + 1.0, without=(without,)))
        assert "RECOVERED" not in names(tick(memory=memory, now_s=NOW_S + 1.01))
        assert "RECOVERED" in names(tick(memory=memory, now_s=NOW_S + 1.02 + wait_s))


def test_retries_are_counted():
    most = ROBUST.checks.retries_max
    assert "RETRIES_LEFT" in names(tick(memory=Memory(retries=most - 1)))
    assert "RETRIES_LEFT" not in names(tick(memory=Memory(retries=most)))


@pytest.mark.parametrize(
    ("phase", "limit_s"),
    [
        (Phase.WAIT, ROBUST.checks.wait_time_max_s),
        (Phase.TAKEOFF, ROBUST.takeoff.timeout_s),
        (Phase.TOUCHDOWN, ROBUST.touchdown.timeout_s),
        (Phase.HOLD, ROBUST.checks.hold_time_s),
        (Phase.CLIMB, ROBUST.checks.climb_time_max_s),
    ],
)
def test_a_phase_has_its_time(phase, limit_s):
    for spent_s, over in ((limit_s - 1e-6, False), (limit_s + 1e-6, True)):
        memory = Memory(phase=phase, phase_since_s=NOW_S - spent_s)
        assert ("PHASE_TIME_OVER" in names(tick(memory=memory))) is over


def test_the_landing_has_its_time():
    limit_s = ROBUST.checks.landing_time_max_s
    assert not {"STARTED", "LANDING_TIME_OVER"} & names(tick(memory=Memory(phase=Phase.APPROACH)))
    for spent_s, over in ((limit_s - 1e-6, False), (limit_s + 1e-6, True)):
        found = names(tick(memory=Memory(phase=Phase.APPROACH, started_s=NOW_S - spent_s)))
        assert "STARTED" in found
        assert ("LANDING_TIME_OVER" in found) is over


def test_high_enough_is_above_the_peak_over_where_the_target_was_last():
    memory = Memory(phase=Phase.CLIMB, target_position_enu_m=PAD)
    edge = high_enough_m(ROBUST, BARRIER, memory)
    assert edge == pytest.approx(PAD[2] + 1.5 / math.e + ROBUST.retreat.climb_margin_m)
    assert high_enough_m(ROBUST, BARRIER, Memory()) == pytest.approx(edge - PAD[2])
    for above, expected in ((1e-9, True), (-1e-9, False)):
        e = (0.5, 0.0, edge - PAD[2] + above)
        assert ("HIGH_ENOUGH" in names(tick(e=e, memory=memory))) is expected
        assert "HIGH_ENOUGH" not in names(tick(e=e, memory=replace(memory, phase=Phase.HOLD)))


def test_the_start_is_reached_slowly_and_after_the_climb():
    assert start_point(config(takeoff={}), TargetState(0.0, PAD, STILL, 0.0)) is None
    memory, start = Memory(phase=Phase.TAKEOFF, climbed=True), (-1.4, 0.5, 0.72)
    assert start_point(ROBUST, TargetState(0.0, PAD, STILL, 0.0)) == pytest.approx((1.6, -1.5, 0.92))
    assert "AT_START" in names(tick(e=start, memory=memory))
    assert "AT_START" not in names(tick(e=start, memory=Memory(phase=Phase.TAKEOFF)))
    assert "AT_START" not in names(tick(e=start, memory=Memory(phase=Phase.HOLD, climbed=True)))
    radius, speed = ROBUST.takeoff.arrival_radius_m, ROBUST.takeoff.arrival_speed_m_s
    for share, expected in ((0.99, True), (1.01, False)):
        beside = (start[0] + share * radius, *start[1:])
        assert ("AT_START" in names(tick(e=beside, memory=memory))) is expected
        assert (
            "AT_START" in names(tick(e=start, velocity=(0.0, share * speed, 0.0), memory=memory))
        ) is expected
    assert "AT_START" in names(tick(config(takeoff={}), memory=memory, velocity=(1.0, 0.0, 0.0)))


def test_over_the_pad_is_left_at_a_wider_radius_than_it_is_entered():
    radius = ROBUST.touchdown.pad_radius_m
    for phase, limit in ((Phase.APPROACH, radius), (Phase.LAND, 1.5 * radius)):
        for d, expected in ((limit - 1e-9, True), (limit + 1e-9, False)):
            found = names(tick(e=(0.0, -d, 0.3), memory=Memory(phase=phase)))
            assert ("OVER_PAD" in found) is expected
    peak = BARRIER.peak_height_m
    for z, expected in ((peak - 1e-9, True), (peak + 1e-9, False)):
        assert ("OVER_PAD" in names(tick(e=(0.01, 0.0, z), memory=Memory(phase=Phase.APPROACH)))) is expected


def touch(settings, e, **changes):
    return "TOUCH" in names(tick(settings, e=e, memory=Memory(phase=Phase.LAND), **changes))


def test_the_papers_touchdown_rule():
    assert touch(PAPER, (0.0, 0.0, 0.049))
    assert not touch(PAPER, (0.0, 0.0, 0.051))
    assert not touch(PAPER, (0.03, 0.0, 0.9 * BARRIER.height(0.03)))  # outside the cone
    assert touch(PAPER, (0.03, 0.0, 1.01 * BARRIER.height(0.03)))
    wide = starting("paper", touchdown={"height_m": 0.2, "pad_radius_m": 0.05})
    assert touch(wide, (0.049, 0.0, 0.15))
    assert not touch(wide, (0.051, 0.0, 0.15))
    # how fast and how certain does not matter to it
    assert touch(PAPER, (0.0, 0.0, 0.049), velocity=(0.4, 0.0, 0.0), sigma_m=1.0)


def test_the_robust_rule_commits_low_in_the_middle_and_moving_along():
    r = ROBUST.robust
    e = (0.5 * r.commit_radius_m, 0.0, 0.9 * r.commit_height_m)
    assert touch(ROBUST, e)
    assert not touch(ROBUST, (*e[:2], 1.01 * r.commit_height_m))
    assert not touch(ROBUST, (0.0, 1.01 * r.commit_radius_m, e[2]))
    for share, expected in ((0.99, True), (1.01, False)):
        slip = (0.0, share * r.commit_speed_m_s, 0.0)
        assert touch(ROBUST, e, velocity=slip) is expected
        assert touch(ROBUST, e, target_velocity=slip) is expected
        both = (0.3, share * r.commit_speed_m_s, 0.0)
        assert touch(ROBUST, e, velocity=both, target_velocity=(0.3, 0.0, 0.0)) is expected
    assert touch(ROBUST, e, velocity=(0.0, 0.0, -0.5))  # sinking is no slip
    # and not where the pad may be somewhere else
    unsure = (r.corridor_m - e[0]) / r.sigma_factor
    assert touch(ROBUST, e, sigma_m=0.99 * unsure)
    assert not touch(ROBUST, e, sigma_m=1.01 * unsure)


def test_a_gust_that_pressed_it_onto_the_pad_is_a_touchdown_all_the_same():
    low = ROBUST.touchdown.feet_below_reference_m + ROBUST.contact.gap_m
    edge = ROBUST.touchdown.pad_radius_m
    for z, d, expected in (
        (low - 1e-6, edge - 1e-6, True),
        (low + 1e-6, edge - 1e-6, False),
        (low - 1e-6, edge + 1e-6, False),
    ):
        assert touch(ROBUST, (0.0, d, z), velocity=(0.5, 0.0, 0.0), sigma_m=1.0) is expected


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
    assert not drifted(ROBUST, (d, 0.0, high - 1e-6), **ask)  # too low to climb away
    assert not drifted(ROBUST, (d, 0.0, high + 1e-6), contact=True, **ask)
    assert not drifted(ROBUST, (d, 0.0, high + 1e-6), phase=Phase.LAND, **ask)
    assert not drifted(PAPER, (d, 0.0, high + 1e-6), **ask)
    near = DRIFT_SHARE * corridor
    for x, expected in ((near - 1e-6, False), (near + 1e-6, True)):
        assert drifted(ROBUST, (x, 0.0, 0.2), velocity=(5.0, 0.0, 0.0)) is expected


def test_a_contact_counts_in_the_touchdown_alone():
    for phase in Phase:
        found = names(tick(memory=Memory(phase=phase, contact=True)))
        assert ("ON_PAD" in found) is (phase is Phase.TOUCHDOWN)
    assert "ON_PAD" not in names(tick(memory=Memory(phase=Phase.TOUCHDOWN)))


def test_a_target_that_was_known_once_stays_known():
    memory = Memory()
    assert "TARGET_KNOWN" not in names(tick(memory=memory, target_age_s=9.0))
    tick(memory=memory)
    assert "TARGET_KNOWN" in names(tick(memory=memory, without=("target",)))


ON_PAD = (0.02, 0.0, 0.0144)


def contact_after(settings, memory, seconds, **changes):
    """Whether contact is found, ticking every 10 ms."""
    for n in range(round(seconds / 0.01) + 1):
        tick(settings, memory=memory, now_s=NOW_S + 0.01 * n, **changes)
    return memory.contact


@pytest.mark.parametrize("settings", [PAPER, ROBUST])
def test_contact_is_standing_there_for_a_while_or_saying_so(settings):
    def down(**changes):
        return Memory(phase=Phase.TOUCHDOWN, **changes)

    assert contact_after(settings, down(), 0.0, e=ON_PAD, landed=Landed.ON_GROUND)
    contact = settings.contact
    assert not contact_after(settings, down(), contact.time_s - 0.02, e=ON_PAD)
    assert contact_after(settings, down(), contact.time_s + 0.01, e=ON_PAD)
    high = (*ON_PAD[:2], settings.touchdown.feet_below_reference_m + contact.gap_m + 1e-6)
    assert not contact_after(settings, down(), 1.0, e=high)
    assert not contact_after(settings, down(), 1.0, e=(settings.touchdown.pad_radius_m + 1e-6, 0.0, 0.0144))
    fast = (0.0, 0.0, -1.01 * contact.speed_m_s)
    assert not contact_after(settings, down(), 1.0, e=ON_PAD, velocity=fast, landed=Landed.ON_GROUND)
    assert not contact_after(
        settings, down(), 1.0, e=ON_PAD, target_velocity=(0.0, 0.0, 1.01 * contact.speed_m_s)
    )
    assert contact_after(settings, down(), 1.0, e=ON_PAD, velocity=tuple(0.9 * v for v in fast))
    assert contact_after(settings, down(contact=True), 0.0, e=(2.0, 0.0, 2.0))  # once is enough
    assert not contact_after(settings, Memory(phase=Phase.LAND), 1.0, e=ON_PAD, landed=Landed.ON_GROUND)


def test_contact_starts_anew_when_it_bounces():
    memory = Memory(phase=Phase.TOUCHDOWN)
    for n in range(40):
        up = n % 8 == 7
        tick(PAPER, e=(*ON_PAD[:2], 0.05 if up else 0.0144), memory=memory, now_s=NOW_S + 0.01 * n)
        assert not memory.contact


def test_a_descent_that_stopped_low_over_the_pad_is_contact():
    r, stopped_s = ROBUST.robust, ROBUST.contact.stopped_time_s
    told = (0.0, 0.0, -1.01 * COMMANDED_SHARE * r.descent_m_s)
    slow = (0.0, 0.0, -0.99 * STOPPED_SHARE * r.descent_m_s)
    low = (0.02, 0.0, 0.9 * r.touch_height_m)

    def found(seconds, command=told, **changes):
        changes = {"e": low, "velocity": slow, **changes}
        return contact_after(ROBUST, Memory(phase=Phase.TOUCHDOWN, command=command), seconds, **changes)

    assert found(stopped_s + 0.01)
    assert not found(stopped_s - 0.02)
    assert not found(1.0, command=tuple(0.98 * v for v in told))
    assert not found(1.0, velocity=tuple(1.02 * v for v in slow))
    assert not found(1.0, e=(*low[:2], 1.01 * r.touch_height_m))
    assert not found(1.0, e=(0.0, 1.01 * ROBUST.touchdown.pad_radius_m, low[2]))
    # both velocities are those against the pad
    rising = (0.0, 0.0, 0.3)
    assert found(
        0.05, command=(0.0, 0.0, told[2] + 0.3), velocity=(0.0, 0.0, slow[2] + 0.3), target_velocity=rising
    )
    assert not found(1.0, target_velocity=(0.0, 0.0, -0.3))
    memory = Memory(phase=Phase.TOUCHDOWN, command=told)
    assert not contact_after(PAPER, memory, 1.0, e=low, velocity=slow)


def test_a_target_out_of_sight_in_the_last_centimetres():
    r = ROBUST.robust
    gone = {"target_age_s": 9.0, "e": (0.02, 0.0, 0.9 * r.touch_height_m)}
    told = (0.0, 0.0, -r.descent_m_s)
    for settings in (PAPER, ROBUST):
        memory = Memory(phase=Phase.TOUCHDOWN)
        assert not contact_after(settings, memory, 1.0, **gone)
        assert contact_after(settings, memory, 0.0, landed=Landed.ON_GROUND, **gone)
        assert not contact_after(settings, Memory(phase=Phase.LAND), 1.0, landed=Landed.ON_GROUND, **gone)
    stopped_s = ROBUST.contact.stopped_time_s
    assert contact_after(ROBUST, Memory(phase=Phase.TOUCHDOWN, command=told), stopped_s + 0.01, **gone)
    assert not contact_after(PAPER, Memory(phase=Phase.TOUCHDOWN, command=told), 1.0, **gone)
    high = {**gone, "e": (0.02, 0.0, 1.1 * r.touch_height_m)}
    assert not contact_after(ROBUST, Memory(phase=Phase.TOUCHDOWN, command=told), 1.0, **high)
    blind = {**gone, "own_age_s": 9.0}
    assert not contact_after(ROBUST, Memory(phase=Phase.TOUCHDOWN, command=told), 1.0, **blind)


CALM = config(
    touchdown={"calm_wait_s": 12.0, "calm_speed_m_s": 0.05, "calm_height_m": 0.3}
)  # the robot: 0.1 m/s


def touches_s(settings):
    """Time from the landing's begin to the commit, and the lowest height over the pad before it."""
    world = World(settings)
    world.run(30.0, until=lambda w: w.phase is Phase.TOUCHDOWN)
    assert world.phase is Phase.TOUCHDOWN
    return world.t_s - world.controller.memory.started_s, min(
        o.snapshot.e_m[2] for o in world.outputs if o.phase is Phase.LAND
    )


def test_over_a_fast_target_it_waits_for_a_slower_one_but_not_for_ever():
    at_once_s, _ = touches_s(config())
    waited_s, lowest_m = touches_s(CALM)
    assert at_once_s < 9.0
    assert 12.0 <= waited_s < 15.0
    assert lowest_m > 0.1


def test_while_it_waits_for_a_slower_target_it_stays_high():
    world = World(CALM)
    world.run(30.0, until=lambda w: w.controller.memory.started_s < w.t_s - 11.5)
    heights_m = [o.snapshot.e_m[2] for o in world.outputs if o.phase is Phase.LAND]
    assert min(heights_m) == pytest.approx(0.3, abs=0.03)


def test_a_slow_target_is_not_waited_for():
    slow = config(touchdown={"calm_wait_s": 12.0, "calm_speed_m_s": 0.2, "calm_height_m": 0.3})
    assert touches_s(slow) == touches_s(config())


@pytest.mark.parametrize(("height_m", "waits"), [(0.02, False), (0.1, True)])
def test_a_vehicle_that_is_on_the_pad_already_stays_there(height_m, waits):
    at = tick(CALM, (0.0, 0.0, height_m), target_velocity=(0.1, 0.0, 0.0), velocity=(0.1, 0.0, 0.0))
    assert bool(at & C.TOUCH) is not waits
