"""Tests that the gate rejects by default, and that its limits are exact to the last bit."""

import copy
import math
import re
from dataclasses import FrozenInstanceError
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.safety.barrier import Barrier, RobustBarrier
from flightstack.core.safety.gate import (
    BOX_TOLERANCE_M_S,
    SOLVER_TOLERANCE_M_S,
    ApprovedSetpoint,
    BarrierCheck,
    Gate,
    GateVerdict,
)
from flightstack.core.safety.qp_filter import RESIDUAL_MAX_M_S, SafetyFilter
from flightstack.core.types import ZERO, FilterStatus
from tests.examples import examples

CONE = Barrier(1.0, 1.5)
BOX = (0.2, 0.3, 0.5)
GATE = Gate(0.7, BOX, 3.0, 0.01)
GOOD = {"own_fresh": True, "target_fresh": True, "altitude_m": 1.0, "barrier_check": None}
STILL = (0.0, 0.0, 0.0)
APPROVED = GateVerdict.APPROVED
LEAST = math.ulp(0.0)
PASSING = (
    FilterStatus.SOLVED, FilterStatus.CLOSED_FORM, FilterStatus.INFEASIBLE, FilterStatus.CROWDED,
    FilterStatus.OWN,
)  # fmt: skip


def check(velocity=(0.1, 0.0, -0.1), yaw=0.0, setpoint=None, **changes):
    verdict, approved = GATE.check(
        velocity, velocity if setpoint is None else setpoint, yaw, **{**GOOD, **changes}
    )
    assert (approved is not None) == (verdict is APPROVED)
    return verdict, approved


def ulps(value, count=5):
    """Return ``count`` neighbouring floats below and above a value, each with its offset in floats."""
    low = high = value
    found = [(0, value)]
    for n in range(1, count + 1):
        low, high = math.nextafter(low, -math.inf), math.nextafter(high, math.inf)
        found += [(-n, low), (n, high)]
    return sorted(found)


class Plane(NamedTuple):
    """A barrier whose h is the height, so that the expected limits are simple."""

    bend_1_m: float = 0.0

    def h(self, e_m):
        return e_m[2]

    def linearisation_bound_m(self, e_m, moved_m):
        return self.bend_1_m * abs(e_m[0]) * moved_m


def plane_check(e=(1.0, 0.0, 0.1), target=STILL, status=FilterStatus.SOLVED, **shape):
    return BarrierCheck(Plane(**shape), e, target, status)


def lowest_approved(gate, barrier_check, sideways=(0.0, 0.0)):
    """Return the lowest vertical velocity that the gate approves, by bisection to neighbouring floats."""

    def passes(vz):
        v = (*sideways, vz)
        return gate.check(v, v, 0.0, **{**GOOD, "barrier_check": barrier_check})[0] is APPROVED

    refused, approved = -100.0, 100.0
    assert not passes(refused)
    assert passes(approved)
    while math.nextafter(refused, math.inf) < approved:
        middle = 0.5 * (refused + approved)
        refused, approved = (refused, middle) if passes(middle) else (middle, approved)
    return approved


def test_of_several_reasons_the_worst_is_named():
    everything = {
        "own_fresh": False, "target_fresh": False, "velocity": (math.nan, 9.0, 9.0), "altitude_m": 9.0,
        "barrier_check": plane_check(status=FilterStatus.NOT_RUN),
    }  # fmt: skip
    mend = [
        (GateVerdict.OWN_STALE, {"own_fresh": True}),
        (GateVerdict.TARGET_STALE, {"target_fresh": True}),
        (GateVerdict.NOT_FINITE, {"velocity": (0.0, 9.0, 0.1)}),
        (GateVerdict.OUTSIDE_BOX, {"velocity": (0.0, 0.0, 0.1)}),
        (GateVerdict.TOO_HIGH, {"altitude_m": 1.0}),
        (GateVerdict.BARRIER, {"barrier_check": plane_check()}),
    ]
    for verdict, change in mend:
        assert check(**everything)[0] is verdict
        everything |= change
    assert check(**everything)[0] is APPROVED


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["velocity", "setpoint"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_no_number_that_is_not_finite_passes(bad, name, axis):
    vector = [0.0, 0.0, 0.0]
    vector[axis] = bad
    assert check(**{name: tuple(vector)})[0] is GateVerdict.NOT_FINITE
    vector[(axis + 1) % 3] = -bad
    assert check(**{name: tuple(vector)})[0] is GateVerdict.NOT_FINITE
    assert check(yaw=bad)[0] is GateVerdict.NOT_FINITE
    assert check(altitude_m=bad)[0] is GateVerdict.NOT_FINITE


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("status", PASSING)
def test_no_place_or_target_that_is_not_finite_passes_whatever_the_filter_says(bad, axis, status):
    for barrier in (CONE, Plane(), RobustBarrier(CONE, 0.05, 0.06)):
        if isinstance(barrier, Plane) and axis != 2:
            continue  # h of this barrier depends only on the height
        for place, moving in ((bad, 0.0), (0.5, bad), (bad, bad)):
            e, target = [1.0, 0.0, 1.0], [0.0, 0.0, 0.0]
            e[axis], target[axis] = place, moving
            ask = BarrierCheck(barrier, tuple(e), tuple(target), status)
            assert check(barrier_check=ask)[0] is GateVerdict.BARRIER


@pytest.mark.parametrize("name", ["velocity", "setpoint"])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_box_ends_at_the_float(name, axis, sign):
    edge = BOX[axis] + BOX_TOLERANCE_M_S
    for offset, size in ulps(edge):
        vector = [0.0, 0.0, 0.0]
        vector[axis] = sign * size
        expected = GateVerdict.OUTSIDE_BOX if offset > 0 else APPROVED
        assert check(**{name: tuple(vector)})[0] is expected
    assert edge - BOX[axis] == pytest.approx(1e-9, rel=1e-6)


def test_a_corrected_set_point_answers_for_box_and_height_but_not_for_the_barrier():
    """Velocity and set-point must be within box and height limit; only the velocity must keep the barrier."""
    level = (0.0, 0.0, 0.0)
    sinking = (0.0, 0.0, -0.5)
    assert check(level, setpoint=sinking, barrier_check=plane_check((1.0, 0.0, 0.0)))[0] is APPROVED
    assert (
        check(sinking, setpoint=level, barrier_check=plane_check((1.0, 0.0, 0.0)))[0] is GateVerdict.BARRIER
    )
    assert check(level, setpoint=(0.0, 0.0, 0.1), altitude_m=3.1)[0] is GateVerdict.TOO_HIGH
    assert check((0.0, 0.0, 0.1), setpoint=level, altitude_m=3.1)[0] is GateVerdict.TOO_HIGH
    assert check(level, setpoint=(0.0, 0.31, 0.0))[0] is GateVerdict.OUTSIDE_BOX
    assert check((0.0, 0.31, 0.0), setpoint=level)[0] is GateVerdict.OUTSIDE_BOX


def test_the_greatest_height_ends_at_the_float():
    for offset, altitude in ulps(3.0):
        for vz in (LEAST, 0.1, 0.5):
            expected = GateVerdict.TOO_HIGH if offset > 0 else APPROVED
            assert check((0.0, 0.0, vz), altitude_m=altitude)[0] is expected
        for vz in (0.0, -0.0, -LEAST, -0.5):
            assert check((0.0, 0.0, vz), altitude_m=altitude)[0] is APPROVED


@pytest.mark.parametrize(
    ("e", "target"),
    [((1.0, 0.0, 0.1), STILL), ((1.0, 0.0, 0.1), (0.0, 0.0, 0.2)), ((0.0, 1.0, -0.05), (0.0, 0.0, -0.1)),
     ((1.0, 0.0, 0.0), (0.3, 0.0, 0.0))],
)  # fmt: skip
def test_the_filters_promise_is_held_to_the_float(e, target):
    """The gate requires h + (v - v_t) T >= h (1 - omega T), so v >= v_t - omega h, with a tolerance."""
    gate = Gate(0.7, (9e9, 9e9, 9e9), 3.0, 0.01)
    found = lowest_approved(gate, plane_check(e, target))
    assert found == pytest.approx(target[2] - 0.7 * e[2] - SOLVER_TOLERANCE_M_S, abs=1e-13)


@pytest.mark.parametrize("target", [(0.1, 0.7, 0.0), (-0.4, -0.2, 0.3)])
@pytest.mark.parametrize("sideways", [(0.9, 0.0), (0.0, -0.6)])
def test_what_the_barrier_bends_away_by_is_allowed_for_and_no_more(target, sideways):
    """The lower limit is reduced by the linearisation bound for the relative motion in one tick."""
    gate = Gate(0.7, (9e9, 9e9, 9e9), 3.0, 0.01)
    moved_m = 0.01 * math.hypot(sideways[0] - target[0], sideways[1] - target[1])
    straight = target[2] - 0.7 * 0.1 - SOLVER_TOLERANCE_M_S
    for bend, place in ((0.0, 2.0), (3.0, 2.0), (3.0, 0.5)):
        ask = plane_check((place, 0.0, 0.1), target, bend_1_m=bend)
        lowest = straight - bend * place * moved_m / 0.01
        assert lowest_approved(gate, ask, sideways) == pytest.approx(lowest, abs=1e-10)


speeds = st.floats(-1.5, 1.5)


@given(
    st.builds(Barrier, st.floats(0.2, 5.0), st.floats(0.1, 3.0), apex_smoothing_m=st.floats(0.001, 0.02)),
    st.floats(0.0, 0.3), st.floats(0.01, 0.3), st.sampled_from((10, 25, 100, 500)), st.floats(0.3, 3.0),
    st.one_of(st.floats(0.0, 0.1), st.floats(0.0, 2.5)), st.floats(0.0, math.tau), st.floats(-0.3, 0.3),
    st.tuples(speeds, speeds, speeds), st.tuples(speeds, speeds, st.floats(-0.3, 0.3)),
    st.sampled_from((0.2, 1.0, 2.0)),
)  # fmt: skip
@examples(400)
def test_no_valid_result_of_the_filter_is_refused(
    cone, margin, fade, rate_hz, omega, d, angle, above, nominal, target, most
):
    held = RobustBarrier(cone, margin, fade)
    e = (d * math.cos(angle), d * math.sin(angle), 0.0)
    e = (e[0], e[1], above - held.h(e))
    box = (most, most, most)
    result = SafetyFilter(omega).solve(nominal, *held.evaluate(e, target), tuple(-v for v in box), box)
    ask = BarrierCheck(held, e, target, result.status)
    u = result.velocity_enu_m_s
    verdict, _ = Gate(omega, box, 9.0, 1.0 / rate_hz).check(u, u, 0.0, **{**GOOD, "barrier_check": ask})
    assert verdict is APPROVED


@pytest.mark.parametrize("status", [*FilterStatus, 7, -1, None, "SOLVED", math.nan])
def test_only_a_result_of_the_filter_passes_in_a_landing(status):
    verdict = check(barrier_check=plane_check((1.0, 0.0, 2.0), status=status))[0]
    assert (verdict is APPROVED) == (status in PASSING)
    assert verdict in (APPROVED, GateVerdict.BARRIER)


def test_when_nothing_holds_the_barrier_the_best_of_the_box_may_go_out_but_no_more():
    lost = plane_check((1.0, 0.0, -1.0), status=FilterStatus.INFEASIBLE)
    assert check((0.0, 0.0, 0.5), barrier_check=lost)[0] is APPROVED
    assert check((0.0, 0.0, 0.6), barrier_check=lost)[0] is GateVerdict.OUTSIDE_BOX
    assert check((0.0, 0.0, 0.5), barrier_check=lost, altitude_m=3.1)[0] is GateVerdict.TOO_HIGH
    solved = plane_check((1.0, 0.0, -1.0))
    assert check((0.0, 0.0, 0.5), barrier_check=solved)[0] is GateVerdict.BARRIER


numbers = st.one_of(st.floats(), st.floats(-1.0, 1.0))
vectors = st.tuples(numbers, numbers, numbers)


@given(vectors, vectors, numbers, numbers, st.booleans(), st.booleans(), vectors, vectors,
       st.sampled_from(FilterStatus), st.booleans())  # fmt: skip
def test_whatever_passes_was_allowed_to(v, setpoint, yaw, altitude, own, target, e, moving, status, landing):
    ask = BarrierCheck(CONE, e, moving, status) if landing else None
    verdict, approved = GATE.check(
        v, setpoint, yaw, own_fresh=own, target_fresh=target, altitude_m=altitude, barrier_check=ask
    )
    if verdict is not APPROVED:
        assert approved is None
        return
    assert own
    assert target
    assert approved.velocity_enu_m_s == setpoint
    assert approved.yaw_rad == yaw
    assert all(map(math.isfinite, (*v, *setpoint, yaw, altitude)))
    assert all(abs(a) <= b + 1e-9 for vector in (v, setpoint) for a, b in zip(vector, BOX, strict=True))
    assert altitude <= 3.0 or max(v[2], setpoint[2]) <= 0.0
    assert ask is None or status in PASSING


def test_the_stop_needs_to_know_where_it_is():
    stop = GATE.stop(0.4, own_fresh=True)
    assert (stop.velocity_enu_m_s, stop.yaw_rad) == (STILL, 0.4)
    assert GATE.stop(0.0, own_fresh=False) is None
    for bad in (math.nan, math.inf, -math.inf):
        assert GATE.stop(bad, own_fresh=True) is None
        assert GATE.stop(bad, own_fresh=False) is None


def test_the_solvers_tolerance_covers_what_it_may_leave():
    """The gate's tolerance is twice the largest residual that the filter accepts from the solver."""
    assert SOLVER_TOLERANCE_M_S == 2.0 * RESIDUAL_MAX_M_S < 1e-5


def test_the_limits_cannot_be_changed_in_flight():
    with pytest.raises(FrozenInstanceError):
        GATE.altitude_max_m = 30.0


_, CHECKED = GATE.check(
    (0.1, 0.0, -0.1), (0.1, 0.0, -0.1), 0.0,
    own_fresh=True, target_fresh=True, altitude_m=1.0, barrier_check=None,
)  # fmt: skip


@pytest.mark.parametrize("key", [object(), None, 0, True, "key", ApprovedSetpoint, GATE])
def test_nobody_else_makes_an_approved_set_point(key):
    with pytest.raises(TypeError, match="gate only"):
        ApprovedSetpoint(key, ZERO, 0.0)


@pytest.mark.parametrize("approved", [CHECKED, GATE.stop(0.3, own_fresh=True)])
def test_an_approved_set_point_is_not_changed(approved):
    before = (approved.velocity_enu_m_s, approved.yaw_rad)
    for name, value in (("velocity_enu_m_s", (9.0, 0.0, 0.0)), ("yaw_rad", 1.0), ("other", 1)):
        with pytest.raises(AttributeError, match=f"not changed: {name}"):
            setattr(approved, name, value)
        with pytest.raises(AttributeError, match=f"not changed: {name}"):
            delattr(approved, name)
    with pytest.raises(AttributeError):
        copy.copy(approved)
    assert (approved.velocity_enu_m_s, approved.yaw_rad) == before


def test_no_other_source_makes_an_approved_set_point_or_names_the_key():
    root = Path(__file__).parents[3]
    files = [f for room in ("flightstack", "bridge", "sim", "logs") for f in (root / room).rglob("*.py")]
    maker = re.compile(r"ApprovedSetpoint\(|gate import .*_KEY|gate\._KEY")
    found = {f.name: len(maker.findall(f.read_text())) for f in files if maker.search(f.read_text())}
    assert found == {"gate.py": 2}  # one call for a checked velocity, one for the stop command
