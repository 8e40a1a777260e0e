"""The vehicle link over a slow line, and with PX4's events."""

import pytest

from bridge.mavlink.client.link import VehicleLink
from bridge.mavlink.client.texts import EVENT
from bridge.mavlink.codec.wide_messages import MESSAGES
from bridge.mavlink.endpoint import dialect
from bridge.mavlink.line_budget import plan
from tests.unit.mavlink.client.vehicle_link_fakes import HEIGHT, FakeAutopilot, Setpoint, poll


@pytest.fixture
def vehicle():
    fake = FakeAutopilot()
    yield fake
    fake.endpoint.close()


def joined(vehicle, line=None):
    link = VehicleLink(f"udpout:127.0.0.1:{vehicle.endpoint.local_port}", takeoff_height_m=HEIGHT, line=line)
    link.poll(0.0)
    vehicle.take("HEARTBEAT")
    vehicle.beat()
    poll(link, 0.0)
    return link


@pytest.mark.parametrize(("baud", "interval_us", "setpoints"), [(None, 10_000, 100), (57_600, 20_000, 50)])
def test_rates_are_those_of_the_line(vehicle, baud, interval_us, setpoints):
    link = joined(vehicle, plan(baud, 100.0, 0.2))
    for tick in range(100):
        assert link.send_setpoint(Setpoint((0.1, 0.0, 0.0), 0.0), tick / 100)
    link.flush([dialect.MAVLink_timesync_message(1, 1)])
    received = vehicle.take("TIMESYNC")
    asked = {int(m.param1): m.param2 for m in received if m.get_type() == "COMMAND_LONG" and m.command == 511}
    assert asked[dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED] == interval_us
    assert asked[dialect.MAVLINK_MSG_ID_ATTITUDE] == interval_us
    sent = [m for m in received if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
    assert len(sent) == setpoints
    link.close()


def test_event_of_px4_becomes_a_text(vehicle):
    link = joined(vehicle)
    arguments = [0, 64, 0, 0, 20, *[0] * 35]
    vehicle.send(MESSAGES[EVENT](0, 0, 0x012F1DC7, 0, 1, 0x33, arguments))
    poll(link, 0.1)
    assert link.take_texts() == [(3, "No offboard signal")]
    vehicle.send(MESSAGES[EVENT](0, 0, 0x01A893E0, 0, 2, 0x88, arguments), MESSAGES[411](2, 0))
    poll(link, 0.2)
    assert link.take_texts() == []
    link.close()
