"""The gate: default deny, limits to the last step, and no other maker of set-points."""

import math

import pytest

from flightstack.barrier import Barrier
from flightstack.gate import ApprovedSetpoint, BarrierCheck, Gate, GateVerdict
from flightstack.safety_filter import FilterStatus

GATE = Gate(Barrier(1.0, 1.5), 0.7, (0.2, 0.2, 0.5), 3.0, 0.01)
GOOD = {"own_fresh": True, "target_fresh": True, "altitude_m": 1.0, "barrier_check": None}


def check(velocity=(0.1, 0.0, -0.1), yaw=0.0, **changes):
    return GATE.check(velocity, yaw, **{**GOOD, **changes})


def test_a_good_set_point_passes_unchanged():
    verdict, setpoint = check()
    assert verdict is GateVerdict.APPROVED
    assert (setpoint.velocity_enu_m_s, setpoint.yaw_rad) == ((0.1, 0.0, -0.1), 0.0)


def test_nobody_else_makes_an_approved_set_point():
    with pytest.raises(TypeError, match="gate only"):
        ApprovedSetpoint(object(), (0.0, 0.0, 0.0), 0.0)


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({"own_fresh": False}, GateVerdict.OWN_STALE),
        ({"target_fresh": False}, GateVerdict.TARGET_STALE),
        ({"velocity": (math.nan, 0.0, 0.0)}, GateVerdict.NOT_FINITE),
        ({"velocity": (0.0, math.inf, 0.0)}, GateVerdict.NOT_FINITE),
        ({"yaw": math.nan}, GateVerdict.NOT_FINITE),
        ({"altitude_m": math.nan}, GateVerdict.NOT_FINITE),
        ({"altitude_m": 3.01, "velocity": (0.0, 0.0, 0.01)}, GateVerdict.TOO_HIGH),
        ({"altitude_m": 3.01, "velocity": (0.0, 0.0, -0.01)}, GateVerdict.APPROVED),
    ],
)
def test_refusals(changes, verdict):
    found, setpoint = check(**changes)
    assert found is verdict
    assert (setpoint is not None) == (verdict is GateVerdict.APPROVED)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_box_is_exact_on_each_side(axis, sign):
    limit = (0.2, 0.2, 0.5)[axis]
    for excess in (-1e-3, -1e-6, 0.0, 1e-6, 1e-3):
        velocity = [0.0, 0.0, 0.0]
        velocity[axis] = sign * (limit + excess)
        expected = GateVerdict.OUTSIDE_BOX if excess > 0 else GateVerdict.APPROVED
        assert check(tuple(velocity))[0] is expected


def test_a_command_that_breaks_the_filters_promise_is_refused():
    e = (0.5, 0.0, Barrier(1.0, 1.5).height(0.5))  # h = 0
    still = (0.0, 0.0, 0.0)
    sinking = BarrierCheck(e, still, FilterStatus.SOLVED)
    assert check((0.0, 0.0, -0.5), barrier_check=sinking)[0] is GateVerdict.BARRIER
    assert check((0.0, 0.0, 0.1), barrier_check=sinking)[0] is GateVerdict.APPROVED
    coming = BarrierCheck((-0.5, 0.0, e[2]), (-0.5, 0.0, 0.0), FilterStatus.SOLVED)
    away = BarrierCheck((-0.5, 0.0, e[2]), (0.5, 0.0, 0.0), FilterStatus.SOLVED)
    verdicts = {check(still, barrier_check=c)[0] for c in (coming, away)}
    assert verdicts == {GateVerdict.BARRIER, GateVerdict.APPROVED}  # the target's motion counts


@pytest.mark.parametrize("status", [FilterStatus.NOT_RUN, FilterStatus.REJECTED])
def test_without_a_filter_result_nothing_passes_in_a_landing(status):
    e = (0.5, 0.0, 2.0)
    assert check(barrier_check=BarrierCheck(e, (0.0, 0.0, 0.0), status))[0] is GateVerdict.BARRIER


def test_the_stop_needs_to_know_where_it_is():
    assert GATE.stop(0.0, own_fresh=True).velocity_enu_m_s == (0.0, 0.0, 0.0)
    assert GATE.stop(0.0, own_fresh=False) is None
    assert GATE.stop(math.nan, own_fresh=True) is None
