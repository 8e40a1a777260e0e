"""Differences between the filters: the paper's law unchanged, and properties of the robust filter."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.safety.barrier import Barrier
from flightstack.core.snapshot import Snapshot
from flightstack.core.strategies.robust import RobustFilter
from flightstack.core.target.track import TargetState, TargetTrack
from flightstack.core.types import Inputs, OwnState, TargetSample
from tests.unit.core.core_helpers import config

CONE = Barrier(1.0, 1.5)


def robust(**sections):
    settings_ = config(**sections)
    return RobustFilter(settings_, settings_.barrier.build()), settings_


def seen(own_velocity, target_velocity, e=(1.0, 0.0, 1.0), sigma_m=0.0, sigma_z_m=0.0):
    own = OwnState(0.0, 0.0, e, own_velocity, 0.0)
    target = TargetState(0.0, (0.0, 0.0, 0.0), target_velocity, 0.0, sigma_m, sigma_z_m)
    return Snapshot(Inputs(own), target, True, True, True, e)


def sample(t_s, velocity=(0.2, -0.1, 0.0)):
    position = tuple(1.0 + v * t_s for v in velocity)
    return TargetSample(t_s, 500.0 + t_s, "map", "target", position, velocity, 0.3, 0.0)


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


def test_target_and_vehicle_are_carried_on_by_their_delays():
    law, settings_ = robust(own={"delay_s": 0.05}, target={"delay_s": 0.1})
    track = TargetTrack(settings_.checks)
    for n in range(50):
        assert track.accept(sample(0.02 * n)).text == "accepted"
        law.take(sample(0.02 * n))
    found = law.target(track, 1.0)  # the newest: measured at 0.98, 0.1 s more latency than the clocks show
    assert found.age_s == pytest.approx(0.02 + 0.1)
    assert found.position_enu_m == pytest.approx(sample(1.1).position_enu_m, abs=1e-6)
    assert found.velocity_enu_m_s == pytest.approx((0.2, -0.1, 0.0), abs=1e-6)
    assert found.position_sigma_m > 0.0
    assert law.target(track, 1.2).position_sigma_m > found.position_sigma_m
    assert law.target(track, 1.2).position_sigma_z_m > found.position_sigma_z_m > 0.0
    assert found.position_sigma_z_m < found.position_sigma_m  # it is configured to drive on a floor
    own = OwnState(3.0, 2.9, (1.0, 2.0, 3.0), (1.0, -2.0, 0.5), 0.7)
    moved = law.vehicle(own)
    assert moved.position_enu_m == pytest.approx((1.05, 1.9, 3.025))
    assert moved._replace(position_enu_m=own.position_enu_m) == own
