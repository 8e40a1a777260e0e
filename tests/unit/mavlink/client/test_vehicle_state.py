"""Decoder of the vehicle link: telemetry into state and status, bad numbers refused."""

import math

import pytest

from bridge.mavlink.client.vehicle_state import VehicleState
from bridge.mavlink.endpoint import dialect
from bridge.mavlink.profiles.autopilots import ARDUPILOT, OWN_SITL, PX4, profile
from flightstack.core.types import Landed, Mode, VehicleStatus
from tests.unit.mavlink.client.vehicle_link_fakes import (
    LAND,
    LOITER,
    OFFBOARD,
    TAKEOFF,
    attitude,
    heartbeat,
    position,
)


@pytest.fixture
def state():
    return VehicleState(PX4)


def test_position_and_attitude_become_own_state_in_enu(state):
    state.update(attitude(990, yaw=math.pi / 2), 4.9)
    state.update(position(1000), 5.0)
    own = state.own
    assert own.position_enu_m == pytest.approx((2.0, 1.0, 3.0))
    assert own.velocity_enu_m_s == pytest.approx((0.2, 0.1, 0.3))
    assert own.yaw_rad == pytest.approx(0.0)
    assert (own.arrival_s, own.source_time_s) == (5.0, pytest.approx(1.0))


def test_no_own_state_without_a_heading(state):
    state.update(position(1000), 5.0)
    assert state.own is None
    assert state.counters.without_yaw == 1


def test_own_state_stops_when_the_heading_stops(state):
    state.update(attitude(1000), 1.0)
    state.update(position(1400), 1.4)
    state.update(position(1600), 1.6)
    assert state.own.arrival_s == 1.4
    assert state.counters.without_yaw == 1


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e30])
@pytest.mark.parametrize("field", ["x", "y", "z", "vx", "vy", "vz"])
def test_position_with_a_bad_number_is_never_used(state, field, value):
    state.update(attitude(1000), 1.0)
    state.update(position(1000), 1.0)
    state.update(position(1010, **{field: value}), 1.01)
    assert state.own.arrival_s == 1.0
    assert state.counters.not_finite == 1


@pytest.mark.parametrize("field", ["yaw", "roll"])
def test_attitude_with_a_bad_number_is_never_used(state, field):
    state.update(attitude(1000, yaw=0.5), 1.0)
    state.update(attitude(1010, **{field: math.nan}), 1.01)
    state.update(position(1010), 1.01)
    assert state.own.yaw_rad == pytest.approx(math.pi / 2 - 0.5)
    assert state.counters.not_finite == 1


@pytest.mark.parametrize("late_ms", [1000, 990, 100])
def test_repeated_and_late_positions_do_not_refresh_the_state(state, late_ms):
    state.update(attitude(1000), 1.0)
    state.update(position(1000), 1.0)
    state.update(position(late_ms, x=9.0), 1.1)
    assert state.own.arrival_s == 1.0
    assert state.counters.out_of_order == 1


def test_a_rebooted_vehicle_is_followed(state):
    state.update(attitude(60_000), 1.0)
    state.update(position(60_000), 1.0)
    state.update(position(100, x=9.0), 2.0)  # no heading of the new life yet
    assert state.own.arrival_s == 1.0
    state.update(attitude(110), 2.01)
    state.update(position(120, x=9.0), 2.02)
    assert state.own.position_enu_m[1] == pytest.approx(9.0)


@pytest.mark.parametrize("shows", [attitude, position])
def test_a_boot_clock_that_falls_back_is_a_restart(state, shows):
    state.update(attitude(60_000), 1.0)
    state.update(position(60_000), 1.0)
    state.update(dialect.MAVLink_gps_global_origin_message(0, 0, 0, 0), 1.0)
    state.update(attitude(60_000 + 100), 1.1)
    state.update(attitude(60_000 - 100), 1.2)  # a late datagram
    assert (state.restarted_s, state.origin_known) == (-math.inf, True)
    state.update(attitude(59_000 - 600), 2.0)
    if shows is position:
        state.restarted_s = -math.inf
        state.update(position(58_500), 2.0)
    assert (state.restarted_s, state.origin_known) == (2.0, False)


def test_a_heartbeat_after_a_silence_may_be_a_restart(state):
    for second in range(4):
        state.update(heartbeat(), 10.0 + second)
    state.update(heartbeat(), 15.4)  # one lost, the next late
    assert state.restarted_s == -math.inf
    state.update(heartbeat(), 18.0)
    assert state.restarted_s == 18.0


def test_status_is_put_together_from_three_messages(state):
    state.update(dialect.MAVLink_extended_sys_state_message(0, 2), 0.5)
    assert state.status is None  # without a heartbeat nothing is known
    state.update(heartbeat(OFFBOARD, armed=True), 1.0)
    assert state.status == VehicleStatus(1.0, True, Mode.EXTERNAL, Landed.IN_AIR, False)
    health = dialect.MAV_SYS_STATUS_PREARM_CHECK
    state.update(dialect.MAVLink_sys_status_message(0, 0, health, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0), 1.5)
    state.update(dialect.MAVLink_extended_sys_state_message(0, 1), 1.6)
    assert state.status == VehicleStatus(1.0, True, Mode.EXTERNAL, Landed.ON_GROUND, True)
    state.update(dialect.MAVLink_extended_sys_state_message(0, 77), 1.7)
    assert state.status.landed is Landed.UNKNOWN


@pytest.mark.parametrize(
    ("custom_mode", "mode"),
    [
        (OFFBOARD, Mode.EXTERNAL),
        (LOITER, Mode.HOLD),
        (TAKEOFF, Mode.TAKEOFF),
        (LAND, Mode.LAND),
        (3 << 16, Mode.OTHER),
    ],
)
def test_px4_modes(state, custom_mode, mode):
    state.update(heartbeat(custom_mode), 0.0)
    assert state.status.mode is mode


def test_ardupilot_modes():
    assert [ARDUPILOT.mode(m) for m in (4, 9, 17, 0)] == [Mode.EXTERNAL, Mode.LAND, Mode.HOLD, Mode.OTHER]


def test_heartbeat_of_another_autopilot_is_no_status(state):
    state.update(heartbeat(4, armed=True, autopilot=3), 0.0)
    assert state.status is None
    assert state.counters.other_autopilot == 1


def test_profile_by_name():
    assert profile("px4") is PX4
    assert profile("sitl") is OWN_SITL
    with pytest.raises(ValueError, match="sitl, crazyflie, px4, ardupilot"):
        profile("betaflight")
