"""Tests the companion's side of the vehicle link with each autopilot, over sockets and a slow serial line."""

import math
from itertools import pairwise

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.companion import Origin
from bridge.mavlink.line_budget import LineTooSlowError, plan
from bridge.mavlink.profiles import PX4
from flightstack.core.types import Mode, Request
from tests.unit.mavlink.client.vehicle_link_fakes import (
    FakeAutopilot,
    Setpoint,
    attitude,
    heartbeat,
    linked,
    poll,
    position,
)


@pytest.fixture
def vehicle():
    fake = FakeAutopilot()
    yield fake
    fake.endpoint.close()


@pytest.fixture
def link(vehicle):
    opened = linked(vehicle)
    yield opened
    opened.close()


def test_setpoint_on_the_wire(vehicle, link):
    assert link.send_setpoint(Setpoint((0.1, 0.2, 0.3), 0.0), now_s=1.2345)
    link.flush()
    (m,) = vehicle.take("SET_POSITION_TARGET_LOCAL_NED")
    assert (m.coordinate_frame, m.type_mask, m.time_boot_ms) == (1, 2503, 1234)
    assert (m.target_system, m.target_component) == (1, 1)
    assert (m.vx, m.vy, m.vz) == pytest.approx((0.2, 0.1, -0.3))
    assert m.yaw == pytest.approx(math.pi / 2)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_setpoint_that_is_not_finite_never_leaves(link, bad):
    assert not link.send_setpoint(Setpoint((0.0, bad, 0.0), 0.0), 0.0)
    assert not link.send_setpoint(Setpoint((0.0, 0.0, 0.0), bad), 0.0)


def test_timesync_is_answered_at_once_in_real_time(vehicle, link):
    vehicle.send(dialect.MAVLink_timesync_message(0, 123), dialect.MAVLink_timesync_message(9, 5))
    poll(link, 2.5)
    (reply,) = vehicle.take("TIMESYNC")
    assert (reply.tc1, reply.ts1) == (2_500_000_000, 123)
    assert link.take_timesync() is None


def test_lockstep_stamps_what_came_with_the_time_of_the_request(vehicle):
    link = linked(vehicle, defer_timesync=True)
    vehicle.send(heartbeat(), attitude(30), position(30))
    poll(link, 77.0)
    assert link.state.own is None  # messages wait for the TIMESYNC request
    vehicle.send(dialect.MAVLink_timesync_message(0, 30_000_000))
    poll(link, 77.0)
    assert link.state.own.arrival_s == 30_000_000 / 1e9
    assert link.state.status.arrival_s == 30_000_000 / 1e9
    assert link.take_timesync() == 30_000_000
    assert link.take_timesync() is None
    link.flush([link.timesync_reply(30_000_000)])
    sent = vehicle.take("TIMESYNC")
    assert (sent[-1].tc1, sent[-1].ts1) == (30_000_001, 30_000_000)
    link.close()


@pytest.fixture
def auto(vehicle):
    opened = linked(vehicle, profile=None, origin=Origin(47.4, 8.5, 10.0))
    yield opened
    opened.close()


def test_auto_takes_the_profile_of_the_first_heartbeat(vehicle, auto):
    assert auto.state.profile is None
    assert auto.failed is None
    auto.command(Request.LAND, 0.0)  # this command is ignored, because no vehicle is known yet
    assert not auto.send_setpoint(Setpoint((0.0, 0.0, 0.0), 0.0), 0.0)
    vehicle.send(position(10))
    poll(auto, 0.1)
    assert auto.state.profile is None
    vehicle.beat()
    poll(auto, 0.2)
    assert auto.state.profile is PX4
    assert auto.state.status.mode is Mode.HOLD
    assert auto.refused is None
    auto.command(Request.LAND, 0.2)
    vehicle.armed = True
    vehicle.beat()
    poll(auto, 0.3)
    auto.command(Request.LAND, 0.3)
    auto.flush()
    sent = vehicle.take("COMMAND_LONG")
    assert [m.command for m in sent if m.get_type() == "COMMAND_LONG"] == [511, 511, 511, 21]
    assert auto.take_texts() == [(6, "its heartbeat says: PX4, OFFBOARD")]
    for now_s in (0.4, 60.0):  # the profile does not change, even after a long silence
        vehicle.send(heartbeat(4, autopilot=3))
        poll(auto, now_s)
    assert (auto.state.profile, auto.refused, auto.senders.ignored) == (PX4, None, 2)
    assert auto.state.status.mode is Mode.HOLD


@pytest.mark.parametrize(("autopilot", "type_", "word"), [(0, 2, "GENERIC (0)"), (3, 1, "FIXED_WING (1)")])
def test_auto_refuses_who_is_not_known(vehicle, auto, autopilot, type_, word):
    for _ in range(3):
        vehicle.send(dialect.MAVLink_heartbeat_message(type_, autopilot, 1, 0, 3, 3))
        poll(auto, 0.1)
    assert word in auto.refused
    assert auto.take_texts() == [(3, auto.refused)]
    assert (auto.state.profile, auto.state.status) == (None, None)
    assert not auto.send_setpoint(Setpoint((0.0, 0.0, 0.0), 0.0), 0.1)


def test_ardupilot_is_prepared_told_its_origin_and_asked_for_everything(vehicle, auto):
    vehicle.send(heartbeat(0, autopilot=3))
    poll(auto, 1.0)
    auto.command(Request.NONE, 1.0)
    auto.flush()
    sent = vehicle.take("SET_GPS_GLOBAL_ORIGIN")
    asked = [(m.command, m.param1, m.param2) for m in sent if m.get_type() == "COMMAND_LONG"]
    assert {(511, float(i)) for i in (1, 30, 32, 245)} <= {(number, first) for number, first, _ in asked}
    assert (176, 1.0, 4.0) in asked
    vehicle.send(dialect.MAVLink_gps_global_origin_message(0, 0, 0, 0))
    poll(auto, 2.5)
    auto.command(Request.NONE, 2.5)
    auto.flush([dialect.MAVLink_ping_message(0, 0, 0, 0)])
    assert not any(m.get_type() == "SET_GPS_GLOBAL_ORIGIN" for m in vehicle.take("PING"))


def test_a_vehicle_that_restarts_while_it_is_waited_for_is_asked_and_told_anew(vehicle, auto):
    def tick(now_s, *shown):
        """Run one tick of the loop; return the requests."""
        if shown:
            vehicle.send(*shown)
            poll(auto, now_s)
        else:
            auto.poll(now_s)
        auto.command(Request.NONE, now_s)
        auto.flush([dialect.MAVLink_ping_message(0, 0, 0, 0)])
        return [m for m in vehicle.take("PING") if m.get_type() != "PING"]

    def asked(messages):
        return {m.param1 for m in messages if m.get_type() == "COMMAND_LONG" and m.command == 511}

    beat = heartbeat(4, autopilot=3)
    for second in range(1, 30):
        tick(float(second), beat)  # no position arrives, and requests become rare
    tick(30.0, beat, dialect.MAVLink_gps_global_origin_message(0, 0, 0, 0))
    tick(30.1, attitude(30_000), position(30_000))
    assert auto.state.own.arrival_s == 30.1
    assert not any(m.get_type() == "SET_GPS_GLOBAL_ORIGIN" for m in tick(31.5, beat))
    auto.take_texts()
    again = tick(40.0, beat)  # a heartbeat after a silence, as after a restart
    assert asked(again) == {1.0, 30.0, 32.0, 245.0}
    assert any(m.get_type() == "SET_GPS_GLOBAL_ORIGIN" for m in again)
    assert [text for _, text in auto.take_texts()] == [
        "restarted, or heard again after a silence: missing telemetry is requested again"
    ]
    seen = [second for second in range(41, 140) if 32.0 in asked(tick(float(second), beat))]
    assert len(seen) > 10  # the requests continue without end
    assert max(b - a for a, b in pairwise(seen)) <= 20
    tick(140.1, beat, attitude(90_000), position(90_000))
    assert auto.state.own.arrival_s == 140.1
    assert not any(m.get_type() == "SET_GPS_GLOBAL_ORIGIN" for m in tick(142.0, beat))


def test_ardupilot_gets_no_set_point_on_the_ground_and_follows_from_the_first_in_the_air(vehicle, auto):
    still = Setpoint((0.0, 0.0, 0.0), 0.0)
    landed = dialect.MAVLink_extended_sys_state_message

    def shows(now_s, state):
        vehicle.send(heartbeat(4, armed=True, autopilot=3), landed(0, state))
        poll(auto, now_s)

    shows(1.0, 1)
    assert auto.state.status.mode is Mode.TAKEOFF
    auto.command(Request.EXTERNAL, 1.0)
    assert not auto.send_setpoint(still, 1.0)  # a set-point would prevent the take-off
    auto.command(Request.TAKEOFF, 1.1)
    assert not auto.send_setpoint(still, 1.1)
    shows(4.0, 3)
    assert auto.state.status.mode is Mode.TAKEOFF
    auto.command(Request.EXTERNAL, 4.0)
    assert auto.send_setpoint(still, 4.0)
    assert auto.state.status.mode is Mode.EXTERNAL  # changed by the first set-point, without a heartbeat
    shows(5.0, 1)  # on the pad, set-points still press the vehicle down
    assert auto.send_setpoint(still, 5.0)
    assert auto.state.status.mode is Mode.EXTERNAL


@pytest.mark.parametrize(
    ("age_s", "baud", "enough"), [(0.2, 9_600, 38_400), (0.2, 19_200, 38_400), (0.05, 57_600, 115_200)]
)
def test_too_slow_a_line_is_refused_with_the_numbers(age_s, baud, enough):
    with pytest.raises(LineTooSlowError) as refused:
        plan(baud, 100.0, age_s)
    text = str(refused.value)
    assert f"serial line of {baud} baud is too slow" in text
    assert f"checks.own_age_max_s = {age_s:g} s" in text
    assert f"carries {baud / 10:.0f} B/s" in text
    assert f"set the line to {enough} baud or more" in text
    plan(enough, 100.0, age_s)  # the recommended baud rate is sufficient
