"""Tests the messages between PX4 and its simulator: bytes, fields and time stamps."""

import math
import socket

import pytest
from pymavlink.dialects.v20 import common as mav

from sim.px4.link import Px4Server, parse_endpoint
from sim.px4.plant import Answer, Body, Fix, Readings, Slow, hil_gps, hil_sensor, hil_state
from sim.px4.session import FIRST_US, Lockstep

SENDER = mav.MAVLink(None, 1, 1)
OUTPUTS = [0.1 * i for i in range(10)] + [0.0] * 6


def controls(time_us=5, mode=129, flags=1):
    return mav.MAVLink_hil_actuator_controls_message(time_us, OUTPUTS, mode, flags)


def packed(message, version=2):
    return bytes(message.pack(SENDER, force_mavlink1=version == 1))


HEARTBEAT = mav.MAVLink_heartbeat_message(0, 12, 0, 0, 0, 3)
WHOLE = packed(HEARTBEAT) + packed(controls()) + packed(HEARTBEAT, 1) + packed(controls(6), 1)
KINDS = ["HEARTBEAT", "HIL_ACTUATOR_CONTROLS"] * 2


@pytest.mark.parametrize("size", [1, 7, len(WHOLE)])
def test_frames_of_both_versions_come_out_however_the_stream_is_cut(size):
    server = Px4Server("127.0.0.1", 0)
    px4 = socket.create_connection(("127.0.0.1", server.port))
    link, found = server.accept(), []
    stream = b"GET / HTTP/1.1\r\n" + WHOLE
    for at in range(0, len(stream), size):
        px4.sendall(stream[at : at + size])
        found += link.receive(0.05)
    assert [m.get_type() for m in found] == KINDS
    assert (found[1].time_usec, found[3].time_usec) == (5, 6)
    assert found[3].controls == pytest.approx(OUTPUTS)
    assert link.garbage_bytes == 16
    for end in (px4, link, server):
        end.close()


READINGS = Readings((1.0, 2.0, -9.8), (0.1, 0.2, 0.3), None, None)


def over_the_wire(message):
    out = mav.MAVLink(None, 1, 200)
    (found,) = mav.MAVLink(None).parse_buffer(bytes(message.pack(out)))
    return found


def test_hil_sensor_flags_only_what_is_new():
    m = over_the_wire(hil_sensor(123, READINGS))
    assert (m.time_usec, m.fields_updated, m.id) == (123, 0b111111, 0)
    assert (m.xacc, m.yacc, m.zacc) == pytest.approx((1.0, 2.0, -9.8))
    assert (m.xgyro, m.ygyro, m.zgyro) == pytest.approx((0.1, 0.2, 0.3))
    slow = Slow((0.2, 0.0, 0.4), 1013.0, 2.08, 15.0)
    m = over_the_wire(hil_sensor(124, Readings((0, 0, 0), (0, 0, 0), slow, None)))
    assert m.fields_updated == 0b1101111111111  # all sensors except differential pressure
    assert (m.xmag, m.zmag, m.abs_pressure, m.pressure_alt, m.temperature) == pytest.approx(
        (0.2, 0.4, 1013.0, 2.08, 15.0)
    )


def test_hil_gps_in_the_units_of_the_message():
    m = over_the_wire(hil_gps(9, Fix(473977420, 85455940, 1.2345, (0.3, -0.4, -0.12))))
    assert (m.lat, m.lon, m.alt, m.vel, m.vn, m.ve, m.vd) == (473977420, 85455940, 1234, 50, 30, -40, -12)
    assert m.cog == round(math.degrees(math.atan2(-0.4, 0.3)) % 360.0 * 100.0)
    assert m.fix_type >= 3
    assert m.satellites_visible >= 6  # PX4's default of EKF2_REQ_NSATS is 6
    assert over_the_wire(hil_gps(9, Fix(0, 0, 0.0, (0.0, 0.01, 0.0)))).cog == 65535


def test_hil_state_is_ned_and_frd():
    half = math.sqrt(0.5)
    north = Body((1.0, 2.0, 3.0), (0.5, 1.0, 0.2), (half, 0.0, 0.0, half), (0.1, 0.2, 0.3))
    m = over_the_wire(hil_state(9, north, (0.0, 0.0, -9.81), 9.81))
    assert [abs(c) for c in m.attitude_quaternion] == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=1e-6)
    assert (m.rollspeed, m.pitchspeed, m.yawspeed) == pytest.approx((0.1, -0.2, -0.3))
    assert (m.vx, m.vy, m.vz, m.alt, m.zacc) == (100, 50, -20, 3000, -1000)
    assert m.lat > 473977420
    assert m.lon > 85455940


def answer(time_us, lockstep=True):
    return Answer(time_us, (0.0,) * 16, True, lockstep)


@pytest.mark.parametrize("zero_us", [0, FIRST_US])
def test_answers_are_told_apart_by_px4_s_clock_whether_it_counts_from_the_first_sensor_or_not(zero_us):
    lockstep = Lockstep()
    for k in range(5):
        lockstep.sent(FIRST_US + k * 4000)  # PX4 is still starting and sends no answers
    assert not lockstep.started
    assert not lockstep.take(answer(FIRST_US + 3 * 4000 - zero_us))  # it answers an earlier message
    assert lockstep.started
    assert lockstep.take(answer(FIRST_US + 4 * 4000 - zero_us))
    assert not lockstep.take(answer(FIRST_US + 4 * 4000 - zero_us))  # an answer is accepted only once
    lockstep.sent(FIRST_US + 5 * 4000)
    assert not lockstep.take(answer(FIRST_US + 4 * 4000 - zero_us))
    assert not lockstep.take(answer(0))
    assert lockstep.take(answer(FIRST_US + 5 * 4000 - zero_us))
    assert lockstep.old == 4


def test_another_clock_is_believed_after_two_waits_in_vain_with_the_same_difference():
    lockstep = Lockstep()
    for k, time_us in enumerate((777, 4777)):
        lockstep.sent(FIRST_US + k * 4000)
        assert not lockstep.take(answer(time_us))
        lockstep.adopt()
    lockstep.sent(FIRST_US + 8000)
    assert not lockstep.take(answer(4777))
    assert lockstep.take(answer(8777))


@pytest.mark.parametrize("late_us", [(0,), (0, 0), (0, None), (0, 8000)])
def test_late_answers_and_silence_do_not_change_the_clock(late_us):
    lockstep = Lockstep()
    sent_us = FIRST_US
    for late in late_us:
        lockstep.sent(sent_us := sent_us + 4000)
        if late is not None:
            lockstep.take(answer(late))
        lockstep.adopt()
    lockstep.sent(sent_us + 4000)
    assert lockstep.take(answer(sent_us + 4000))


@pytest.mark.parametrize("text", ["4560", "127.0.0.1", "tcp:127.0.0.1:4560", "127.0.0.1:70000", ":1", ""])
def test_a_bad_endpoint_is_refused_with_what_is_allowed(text):
    with pytest.raises(ValueError, match="HOST:PORT"):
        parse_endpoint(text, allow_unsigned=True)


def test_a_network_needs_leave():
    assert parse_endpoint("127.0.0.1:4560", allow_unsigned=False) == ("127.0.0.1", 4560)
    with pytest.raises(ValueError, match="allow-unsigned"):
        parse_endpoint("0.0.0.0:4560", allow_unsigned=False)
    assert parse_endpoint("0.0.0.0:4560", allow_unsigned=True) == ("0.0.0.0", 4560)
