import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge import frames

finite = st.floats(-1e3, 1e3)
vectors = st.tuples(finite, finite, finite)
angles = st.floats(-50.0, 50.0)


@st.composite
def unit_quaternions(draw):
    raw = draw(st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: sum(c * c for c in q) > 1e-2))
    norm = math.sqrt(sum(c * c for c in raw))
    return tuple(c / norm for c in raw)


def test_east_north_up_becomes_north_east_down():
    assert frames.ned_from_enu((1.0, 2.0, 3.0)) == (2.0, 1.0, -3.0)
    assert frames.enu_from_ned((2.0, 1.0, -3.0)) == (1.0, 2.0, 3.0)


def test_forward_left_up_becomes_forward_right_down():
    assert frames.frd_from_flu((1.0, 2.0, 3.0)) == (1.0, -2.0, -3.0)


@pytest.mark.parametrize(
    ("yaw_enu_deg", "yaw_ned_deg"), [(0, 90), (90, 0), (180, -90), (-90, 180), (45, 45), (-135, -135)]
)
def test_headings_by_hand(yaw_enu_deg, yaw_ned_deg):
    assert frames.yaw_ned_from_enu(math.radians(yaw_enu_deg)) == pytest.approx(math.radians(yaw_ned_deg))
    assert frames.yaw_enu_from_ned(math.radians(yaw_ned_deg)) == pytest.approx(math.radians(yaw_enu_deg))


@given(angles)
def test_heading_round_trip_and_range(yaw):
    there = frames.yaw_ned_from_enu(yaw)
    back = frames.yaw_enu_from_ned(there)
    assert -math.pi < there <= math.pi
    assert -math.pi < back <= math.pi
    assert math.remainder(back - yaw, math.tau) == pytest.approx(0.0, abs=1e-12)


@given(unit_quaternions(), vectors)
def test_attitude_and_vector_conversions_agree(q, v_flu):
    """The conversion from body FLU to NED gives the same vector by way of ENU and by way of FRD."""
    through_enu = frames.ned_from_enu(frames.world_from_body(q, v_flu))
    through_frd = frames.world_from_body(frames.ned_frd_from_enu_flu(q), frames.frd_from_flu(v_flu))
    assert through_enu == pytest.approx(through_frd, abs=1e-9)


@given(st.floats(-3.1, 3.1), st.floats(-1.4, 1.4), st.floats(-3.1, 3.1))
def test_yaw_survives_pitch_and_roll_and_agrees_between_frames(yaw, pitch, roll):
    cy, sy, cp, sp, cr, sr = (f(a / 2) for a in (yaw, pitch, roll) for f in (math.cos, math.sin))
    q = (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    yaw_enu = frames.yaw_from_quaternion(q)
    yaw_ned = frames.yaw_from_quaternion(frames.ned_frd_from_enu_flu(q))
    assert math.remainder(yaw_enu - yaw, math.tau) == pytest.approx(0.0, abs=1e-9)
    assert math.remainder(yaw_ned - frames.yaw_ned_from_enu(yaw), math.tau) == pytest.approx(0.0, abs=1e-9)
