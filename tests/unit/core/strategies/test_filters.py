"""Differences between the filters: the paper's law unchanged, and properties of the robust filter."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flightstack.core.memory import TrackingMemory
from flightstack.core.safety.barrier import Barrier, RobustBarrier
from flightstack.core.snapshot import Snapshot
from flightstack.core.strategies.robust import RobustFilter
from flightstack.core.strategies.strategy import PaperFilter
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


def test_the_papers_law_changes_nothing():
    settings_ = config(filter="paper")
    law = PaperFilter(settings_, CONE)
    own = OwnState(1.0, 1.0, (1.0, 2.0, 3.0), (0.3, 0.2, 0.1), 0.5)
    assert law.vehicle(own) is own
    assert law.barrier(seen((0.1, 0.0, 0.0), (0.0, 0.0, 0.0), sigma_m=1.0).relative) is CONE
    wanted = (0.1, 0.2, 0.3)
    assert law.setpoint((9.0, 9.0, 9.0), wanted, (1.0, 1.0, 1.0), 1.0, -math.inf) == wanted
    assert (
        law.climb_m_s(-1.0, (9.0, 9.0, 1.0), (0.0, 0.0, 0.0), seen((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)).relative)
        == -math.inf
    )
    assert (law.rate_1_s, law.acceleration_max_m_s2) == (
        settings_.barrier.omega_1_s, settings_.limits.slew_max_m_s2
    )  # fmt: skip
    law.take(sample(0.0))
    law.observe((1.0, 0.0, 0.0), commanding=True)
    assert math.isnan(law.motion.time_s)
    assert law.tracking == TrackingMemory()
    track = TargetTrack(settings_.checks)
    track.accept(sample(0.0))
    assert law.target(track, 0.1) == track.at(0.1)


def sample(t_s, velocity=(0.2, -0.1, 0.0)):
    position = tuple(1.0 + v * t_s for v in velocity)
    return TargetSample(t_s, 500.0 + t_s, "map", "target", position, velocity, 0.3, 0.0)


rates = st.floats(0.3, 5.0)
velocities = st.tuples(*(st.floats(-0.6, 0.6),) * 3)
legs = st.lists(st.tuples(velocities, velocities, st.floats(0.05, 0.4)), min_size=1, max_size=6)
starts = st.tuples(
    st.floats(0.2, 2.0), st.floats(0.0, 2.0 * math.pi), st.one_of(st.just(0.0), st.floats(0.0, 0.5))
)


def fly(law, held, e, legs_, dt_s):
    """Fly exact kinematics with the vertical velocity at its bound; yield h and distance after each step."""
    climb = None
    for velocity, target, seconds in legs_:
        for _ in range(round(seconds / dt_s)):
            h, gradient, _ = held.evaluate(e, target)
            # exact flight: the last command is the measured velocity
            now = (velocity[0], velocity[1], 0.0 if climb is None else climb)
            climb = law.climb_m_s(h, gradient, now, seen(now, target, e).relative)
            flown = (velocity[0], velocity[1], climb)
            e = tuple(a + (v - t) * dt_s for a, v, t in zip(e, flown, target, strict=True))
            yield held.h(e), math.hypot(e[0], e[1])


@given(rates, st.floats(0.0, 0.1), starts, legs)
@settings(max_examples=40)
def test_climbing_as_told_holds_the_barrier_whatever_is_flown_sideways(rate, margin, start, legs_):
    """At the bound, for any horizontal motion, h decreases only by the step's curvature."""
    law, _ = robust(robust={"rate_1_s": rate})
    held = RobustBarrier(CONE, margin, 0.06)
    d, angle, above = start
    e = (d * math.cos(angle), d * math.sin(angle), 0.0)
    e = (e[0], e[1], above - held.h(e))
    dt_s, near_m = 2e-4, 0.15
    # second derivatives outside that radius: of b, of b along the circle, of the margin, of the smoothing
    curvature = 2.0 * 1.5 + 1.5 / near_m + 4.0 * margin / 0.06**2 * math.exp(-((near_m / 0.06) ** 2)) * 10.0
    speed = 2.0 * math.hypot(0.6, 0.6)
    lost = (
        0.5 * curvature * speed * speed * dt_s + held.slope_max * 0.5 * (0.005 / near_m) ** 2 * speed
    ) / rate
    for h, distance in fly(law, held, e, legs_, dt_s):
        if distance < near_m:
            return  # below the barrier above the pad
        assert h >= -lost


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


def test_what_the_vertical_loop_still_has_to_lose_counts_as_lost():
    law, settings_ = robust()
    lag_s, rate = settings_.velocity_loop.lag_z_s, settings_.robust.rate_1_s
    still, up = (0.0, 0.0, 0.0), (0.0, 0.0, 0.3)
    plain = law.climb_m_s(0.1, up, still, seen(still, still).relative)
    sinking = law.climb_m_s(0.1, up, still, seen((0.0, 0.0, -0.2), still).relative)
    assert sinking - plain == pytest.approx(rate * lag_s * 0.2)
    # climbing faster than commanded gives no credit
    assert law.climb_m_s(0.1, up, still, seen((0.0, 0.0, 0.2), still).relative) == plain


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


def test_a_target_that_is_not_seen_any_more_stays_where_it_was_lost():
    law, settings_ = robust()
    track = TargetTrack(settings_.checks)
    for n in range(50):  # its speed increases all the time
        t_s = 0.02 * n
        rising = sample(t_s)._replace(
            position_enu_m=(0.3 * t_s * t_s, 0.0, 0.2), velocity_enu_m_s=(0.6 * t_s, 0, 0)
        )
        assert track.accept(rising).text == "accepted"
        law.take(rising)
    limit_s = 0.98 + settings_.checks.target_age_max_s
    assert law.target(track, limit_s).position_enu_m > law.target(track, limit_s - 1e-3).position_enu_m
    lost = law.target(track, limit_s)
    for later_s in (1e-6, 1.0, 60.0, 1e9, 1e300):
        found = law.target(track, limit_s + later_s)
        assert found.age_s >= lost.age_s
        for a, b in zip(found[1:], lost[1:], strict=True):
            assert a == pytest.approx(b, abs=1e-9)
    assert math.dist(lost.position_enu_m, (0.3 * limit_s**2, 0.0, 0.2)) < 0.05


def test_the_set_point_is_the_corrected_one_and_stays_in_the_box():
    law, settings_ = robust(limits={"velocity_max_m_s": [0.2, 0.2, 0.5]})
    still = (0.0, 0.0, 0.0)
    slow = law.setpoint((0.1, 0.0, 0.0), (0.1, 0.0, 0.0), still, 1.0, -math.inf)
    assert 0.1 < slow[0] <= 0.2
    assert law.setpoint((0.1, 0.0, 0.0), (0.2, 0.0, 0.0), still, 1.0, -math.inf)[0] == 0.2
    law, _ = robust(limits={"velocity_max_m_s": [0.2, 0.2, 0.5]})
    wanted = (0.1, 0.0, 0.0)  # the commanded velocity replaces an unknown one
    assert law.setpoint(wanted, wanted, wanted, math.nan, -math.inf) == pytest.approx(wanted)
    assert (law.rate_1_s, law.acceleration_max_m_s2) == (
        settings_.robust.rate_1_s, settings_.robust.acceleration_max_m_s2
    )  # fmt: skip


def test_feedback_is_gentler_beyond_the_distance_of_the_configuration():
    feedback = {"horizontal": True, "far_m": 1.0, "far_error_rate_1_s": 2.0, "far_tilt_rate_1_s": 6.0}
    wanted, still = (0.02, 0.0, 0.0), (0.0, 0.0, 0.0)

    def setpoint(distance_m, **changed):
        law = RobustFilter(config(velocity_feedback=feedback | changed), CONE)
        return law.setpoint(wanted, wanted, still, distance_m, -math.inf)

    assert 0.0 < setpoint(1.01)[0] < setpoint(1.0)[0]
    assert setpoint(1.01, far_m=0.0) == setpoint(1.0)
    assert setpoint(1.01)[1:] == setpoint(1.0)[1:]
