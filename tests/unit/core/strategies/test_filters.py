"""Tests the required climb and the margin of the robust filter."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.safety.barrier import Barrier
from flightstack.core.snapshot import Snapshot, relative
from flightstack.core.strategies.packaged.robust import RobustFilter
from flightstack.core.target.track import TargetState
from flightstack.core.types import Inputs, OwnState
from tests.unit.core.core_helpers import config

CONE = Barrier(1.0, 1.5)


def robust(**sections):
    settings_ = config(**sections)
    return RobustFilter(settings_, settings_.barrier), settings_


def seen(own_velocity, target_velocity, e=(1.0, 0.0, 1.0), sigma_m=0.0, sigma_z_m=0.0):
    own = OwnState(0.0, 0.0, e, own_velocity, 0.0)
    target = TargetState(0.0, (0.0, 0.0, 0.0), target_velocity, 0.0, sigma_m, sigma_z_m)
    return Snapshot(Inputs(own), target, True, True, True, relative(own, target))


rates = st.floats(0.3, 5.0)
velocities = st.tuples(*(st.floats(-0.6, 0.6),) * 3)


@given(
    rates,
    velocities,
    velocities,
    st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.just(1.0)),
    st.floats(-1.0, 1.0),
)
def test_the_climb_is_what_the_barriers_derivative_asks_for(rate, own, target, gradient, h):
    law, _ = robust(robust={"rate_1_s": rate})
    climb = law.climb_m_s(h, gradient, own, seen(own, target).relative)
    flown = (own[0], own[1], climb)
    derivative = sum(g * (v - t) for g, v, t in zip(gradient, flown, target, strict=True))
    assert derivative == pytest.approx(-rate * h, abs=1e-9)


def test_the_margin_grows_with_what_is_not_known_and_is_whole_at_the_pads_edge():
    law, settings_ = robust()
    still, edge = (0.0, 0.0, 0.0), (settings_.touchdown.pad_radius_m, 0.0, 0.5)

    def margin(view_):
        return CONE.h(edge) - law.barrier(view_.relative).h(edge)

    margins = [margin(seen(still, still, sigma_m=s, sigma_z_m=0.7 * s)) for s in (0.0, 0.005, 0.01, 0.1)]
    assert margins == sorted(margins)
    assert margins[0] >= settings_.robust.tracking_error_m_s / settings_.robust.rate_1_s
    slope = CONE.slope(settings_.touchdown.pad_radius_m)
    own_m = settings_.own.position_noise_m
    expected = settings_.robust.margin_m(slope, math.hypot(0.01, own_m), math.hypot(0.007, own_m))
    assert margins[2] == pytest.approx(expected)
    assert law.barrier(seen(still, still).relative).fade_radius_m == settings_.robust.fade_radius_m
