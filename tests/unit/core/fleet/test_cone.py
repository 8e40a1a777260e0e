"""Above its pad and next to others, a vehicle sinks and leaves the cone only as fast as its climb allows."""

import math

from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.fleet.program import OUTWARD_PART, Cone
from flightstack.core.safety.barrier import Barrier

BARRIER = Barrier(1.0, 1.5)
CONE = Cone(1.5, BARRIER.slope_max, 0.3, 0.01)
speeds = st.floats(-1.0, 1.0)
vectors = st.tuples(speeds, speeds, speeds)


@given(st.floats(0.0, 2.0), st.floats(-0.1, 1.0), vectors, vectors, vectors)
def test_nothing_sinks_faster_than_wanted_or_than_h_alone_allows(d_m, h_m, nominal, target, before):
    reached = tuple(v - 0.05 for v in before), tuple(v + 0.05 for v in before)
    lower, upper = CONE.box(d_m, h_m, nominal, target, *reached)
    for axis in range(3):
        assert reached[0][axis] <= lower[axis] <= upper[axis] <= reached[1][axis]
    allowed = target[2] - CONE.rate_1_s * max(0.0, h_m)
    assert lower[2] >= min(allowed, reached[1][2])
    assert lower[2] >= min(nominal[2], target[2], reached[1][2])
    assert lower[2] <= max(target[2], reached[0][2])  # its current height above the pad is always high enough
    assert upper[2] == reached[1][2]


@given(st.floats(0.05, 0.9), st.floats(0.0, math.tau), st.floats(0.0, 0.3), vectors, vectors)
def test_velocity_out_of_the_cone_grows_by_half_of_what_the_rate_allows(d_m, azimuth, h_m, before, target):
    x, y = d_m * math.cos(azimuth), d_m * math.sin(azimuth)
    _, gradient, _ = BARRIER.evaluate((x, y, BARRIER.height(d_m) + h_m), target)

    def lowers_m_s(velocity):
        return sum(g * (t - v) for g, t, v in zip(gradient[:2], target, velocity, strict=False))

    row = CONE.outward(h_m, gradient, before, target)
    most_m_s = lowers_m_s((0.0, 0.0)) - row.bound_m_s  # part of the velocity that fulfils the row
    grows_m_s = OUTWARD_PART * CONE.period_s * CONE.rate_1_s * h_m / CONE.lag_s
    assert row.g == (*gradient[:2], 0.0)
    assert math.isclose(most_m_s, max(0.0, lowers_m_s(before)) + grows_m_s, abs_tol=1e-9)
