"""Tests the nominal command in each phase."""

import itertools
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.fleet.precedence import ALONE
from flightstack.core.memory import AbortWay, Memory
from flightstack.core.mission.conditions import Situation, high_enough_m
from flightstack.core.mission.guidance import NominalCommand as Command
from flightstack.core.mission.guidance import nominal_command
from flightstack.core.snapshot import Snapshot, relative
from flightstack.core.strategies.strategy import strategy_of
from flightstack.core.target.track import TargetState
from flightstack.core.types import ZERO, Inputs, Landed, Mode, OwnState, Phase, Request, VehicleStatus
from tests.unit.core.core_helpers import config
from tests.unit.core.mission.mission_helpers import mission_of

PAD = (3.0, -2.0, 0.2)
MOVING = (0.1, -0.05, 0.02)


ROBUST, PAPER = config(), config("paper")
BARRIER = ROBUST.barrier
SHAPES = [PAPER, ROBUST]


def asked(
    phase, settings=ROBUST, e=(0.5, -0.4, 1.0), memory=None, *, own=True, target=True, own_ok=True,
    target_ok=True, armed=True, landed=Landed.IN_AIR, status=True, velocity=ZERO, permissions=ALONE,
):  # fmt: skip
    """Return the nominal command in this phase for these inputs; the command must not change the memory."""
    memory = memory if memory is not None else Memory()
    memory.phase = phase
    position = tuple(a + b for a, b in zip(e, PAD, strict=True))
    state = OwnState(0.0, 0.0, position, velocity, 0.0)
    word = VehicleStatus(0.0, armed, Mode.EXTERNAL, landed, True)
    inputs = Inputs(state if own else None, word if status else None)
    known = TargetState(0.0, PAD, MOVING, 0.0)
    at = relative(state, known) if own and target else None
    seen = Snapshot(inputs, known if target else None, own_ok, target_ok, True, at, permissions=permissions)
    strategy = strategy_of(settings)
    mission = mission_of(settings, strategy)
    mission.memory = memory
    mission.progress(seen)
    before = replace(memory)
    command = nominal_command(mission, seen)
    assert memory == before, "guidance only reads"
    return command


LOST = [{}, {"own": False}, {"target": False}, {"own": False, "target": False, "status": False}]


@pytest.mark.parametrize("phase", Phase)
def test_whatever_is_missing_there_is_an_answer_and_only_the_landing_is_filtered(phase):
    for settings, way, lost in itertools.product(SHAPES, AbortWay, LOST):
        found = asked(phase, settings, memory=Memory(abort_way=way), **lost)
        assert isinstance(found, Command)
        filtered = {Phase.APPROACH, Phase.LAND, Phase.LEAVE, *([Phase.WAIT] if settings is ROBUST else [])}
        assert not found.filtered or phase in filtered
        rises = [Request.TAKEOFF] if phase in (Phase.TAKEOFF, Phase.LEAVE) else []
        assert found.velocity is None or (
            found.request in (Request.EXTERNAL, *rises) and all(map(math.isfinite, found.velocity))
        )
        if phase in (Phase.APPROACH, Phase.LAND):
            assert found.filtered == (found.velocity is not None) == (not lost)


def test_waiting_is_doing_nothing_unless_it_is_found_in_the_air():
    """A waiting vehicle in the air hovers; with the robust filter it also avoids an approaching pad."""
    assert asked(Phase.WAIT, PAPER) == Command(Request.EXTERNAL, ZERO)
    assert asked(Phase.WAIT, ROBUST) == Command(Request.EXTERNAL, ZERO, filtered=True)
    for changes in ({"armed": False}, {"landed": Landed.ON_GROUND}, {"target_ok": False}, {"status": False}):
        assert asked(Phase.WAIT, **changes) == Command(Request.NONE)
    assert asked(Phase.LANDED) == Command(Request.NONE)


places = st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(0.0, 2.0))


@given(places)
def test_the_papers_landing_is_proportional_with_the_targets_velocity(e):
    for phase in (Phase.APPROACH, Phase.LAND):
        found = asked(phase, PAPER, e)
        assert found.velocity == pytest.approx([v - x for v, x in zip(MOVING, e, strict=True)])
        assert found.filtered


@given(places)
def test_the_robust_landing_waits_low_over_the_middle(e):
    r = ROBUST.robust
    for phase, gain in ((Phase.APPROACH, r.gain_1_s), (Phase.LAND, r.gain_over_pad_1_s)):
        found = asked(phase, ROBUST, e, velocity=MOVING)
        assert found.velocity[:2] == pytest.approx(
            [v - gain * x for v, x in zip(MOVING[:2], e[:2], strict=True)]
        )
        far = math.hypot(e[0], e[1]) > BARRIER.peak_distance_m  # wait height plus the peak's height
        above = e[2] - r.wait_height_m - (BARRIER.peak_height_m if far else 0.0)
        rising = found.velocity[2] - MOVING[2]
        if above > 0.0:
            down = min(max(r.gain_1_s * above, r.descent_min_m_s), r.descent_max_m_s)
            assert rising == pytest.approx(-down)
        else:
            assert rising == pytest.approx(-r.gain_1_s * above)
        assert found.filtered


def test_holding_is_standing_still_or_following_what_was_followed_and_rising():
    assert asked(Phase.HOLD, PAPER, memory=Memory(started_s=1.0)) == Command(Request.EXTERNAL, ZERO)
    assert asked(Phase.HOLD, ROBUST) == Command(Request.EXTERNAL, ZERO)  # no landing has started: no climb
    assert asked(Phase.HOLD, ROBUST, memory=Memory(started_s=1.0), target=False) == Command(
        Request.EXTERNAL, ZERO
    )
    wide = config(limits={"velocity_max_m_s": [1.0, 1.0, 1.0]})
    found = asked(Phase.HOLD, wide, memory=Memory(started_s=1.0))
    assert found == Command(Request.EXTERNAL, (MOVING[0], MOVING[1], MOVING[2] + wide.retreat.hold_climb_m_s))
    narrow = config(limits={"velocity_max_m_s": [0.05, 0.05, 0.1]})
    assert asked(Phase.HOLD, narrow, memory=Memory(started_s=1.0)).velocity == (0.05, -0.05, 0.1)


def test_the_climb_ends_above_everything_and_never_sinks():
    memory = Memory(target_position_enu_m=PAD)
    top = high_enough_m(Situation(ROBUST, None, memory)) - PAD[2]
    fast, slow = (asked(Phase.CLIMB, e=(0.3, 0.0, z), memory=memory).velocity for z in (0.0, top + 0.05))
    assert fast == (0.0, 0.0, ROBUST.limits.velocity_max_m_s[2])
    assert slow == pytest.approx((0.0, 0.0, 0.05 * ROBUST.position_loop.gain_1_s[2]))
    assert asked(Phase.CLIMB, e=(0.3, 0.0, top + 1.0), memory=memory).velocity == ZERO
    assert asked(Phase.CLIMB, own=False) == Command(Request.EXTERNAL)


@pytest.mark.parametrize(
    ("way", "request_"),
    [
        (AbortWay.NONE, Request.NONE),
        (AbortWay.MOTORS_OFF, Request.MOTORS_OFF),
        (AbortWay.HANDS_OFF, Request.NONE),
        (AbortWay.LAND_HERE, Request.LAND),
    ],
)
def test_ways_to_end_that_fly_nowhere(way, request_):
    assert asked(Phase.ABORT, memory=Memory(abort_way=way)) == Command(request_)


def clearing(e, target_m_s=ZERO, **changes):
    memory = Memory(
        abort_way=AbortWay.FLY_CLEAR, target_position_enu_m=PAD, target_velocity_enu_m_s=target_m_s
    )
    return asked(Phase.ABORT, ROBUST, e, memory, **changes), memory


def test_flying_clear_is_up_then_away_then_down():
    vx, _, vz = ROBUST.limits.velocity_max_m_s
    top = high_enough_m(Situation(ROBUST, None, Memory(target_position_enu_m=PAD))) - PAD[2]
    assert clearing((0.3, 0.0, 0.1))[0] == Command(Request.EXTERNAL, (0.0, 0.0, vz))
    assert clearing((0.3, 0.0, top))[0].velocity == pytest.approx((vx, 0.0, 0.0))
    away = clearing((-0.3, -0.4, top))[0].velocity
    assert away == pytest.approx((-0.6 * vx, -0.8 * vx, 0.0))
    assert clearing((0.0, 0.0, top))[0].velocity == pytest.approx((vx, 0.0, 0.0))  # any direction is valid
    far = ROBUST.checks.clearance_m
    there, memory = clearing((0.0, -far - 1e-6, 0.1))
    assert there == Command(Request.LAND)
    assert memory.clear
    assert asked(Phase.ABORT, e=(0.1, 0.0, 0.1), memory=memory) == Command(Request.LAND)  # LAND continues
    assert clearing((0.0, -far + 1e-6, top))[0].request is Request.EXTERNAL


def test_it_does_not_land_while_it_closes_in():
    """The vehicle lands only if its distance to the target remains above the clearance during the descent."""
    vx, vy, vz = ROBUST.limits.velocity_max_m_s
    far, lag_s = ROBUST.checks.clearance_m, ROBUST.velocity_loop.lag_xy_s
    z = 0.3 - PAD[2]  # 0.3 m above the origin
    sinks_s = 0.3 / ROBUST.retreat.landing_speed_m_s
    coming = {"velocity": (-0.4, 0.0, 0.0)}
    still = clearing((far + 0.4 * lag_s - 1e-6, 0.0, z), **coming)[0]
    assert still == Command(Request.EXTERNAL, (vx, 0.0, vz))  # the vehicle still flies away from the target
    assert clearing((far + 0.4 * lag_s + 1e-6, 0.0, z), **coming)[0] == Command(Request.LAND)
    followed = (0.0, -0.2, 0.0)
    reach_m = far + 0.2 * sinks_s
    assert clearing((0.0, -reach_m + 1e-6, z), followed)[0] == Command(Request.EXTERNAL, (0.0, -vy, vz))
    assert clearing((0.0, -reach_m - 1e-6, z), followed)[0] == Command(Request.LAND)
    assert clearing((0.0, far + 1e-6, z), followed)[0] == Command(Request.LAND)  # the target drives away
    # during the descent the target passes the vehicle at 0.9 times the clearance
    assert clearing((0.9 * far, -0.5 * far, z), (0.0, -5.0, 0.0))[0].request is Request.EXTERNAL
    assert clearing((1.1 * far, -0.5 * far, z), (0.0, -5.0, 0.0))[0] == Command(Request.LAND)


@pytest.mark.parametrize("lost", [{"own": False}, {"own_ok": False}])
def test_without_knowing_where_it_is_it_lands_there(lost):
    assert clearing((0.3, 0.0, 0.5), **lost)[0] == Command(Request.LAND)
    assert asked(Phase.ABORT, memory=Memory(abort_way=AbortWay.FLY_CLEAR)) == Command(Request.LAND)
