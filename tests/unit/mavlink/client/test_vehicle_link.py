"""Tests the companion's side of the vehicle link over real sockets."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

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
    assert link.counters.setpoints_refused == 2


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
    assert link.state.own is None  # the state is empty until a tick reads the messages
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
