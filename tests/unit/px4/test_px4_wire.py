"""Tests the connection between PX4 and its simulator: bytes and time stamps."""

import socket

import pytest
from pymavlink.dialects.v20 import common as mav

from sim.px4.link import Px4Link, parse_endpoint
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
    with socket.create_server(("127.0.0.1", 0)) as server:
        px4 = socket.create_connection(server.getsockname())
        link, found = Px4Link(server.accept()[0]), []
    stream = b"GET / HTTP/1.1\r\n" + WHOLE
    for at in range(0, len(stream), size):
        px4.sendall(stream[at : at + size])
        found += link.receive(0.05)
    assert [m.get_type() for m in found] == KINDS
    assert (found[1].time_usec, found[3].time_usec) == (5, 6)
    assert found[3].controls == pytest.approx(OUTPUTS)
    assert link.garbage_bytes == 16
    for end in (px4, link):
        end.close()


def answer(time_us, lockstep=True):
    return controls(time_us, flags=int(lockstep))


@pytest.mark.parametrize("zero_us", [0, FIRST_US])
def test_answers_are_told_apart_by_px4_s_clock_whether_it_counts_from_the_first_sensor_or_not(zero_us):
    lockstep = Lockstep()
    for k in range(5):
        lockstep.sent(FIRST_US + k * 4000)  # PX4 is still starting and does not answer
    assert not lockstep.started
    assert not lockstep.take(answer(FIRST_US + 3 * 4000 - zero_us))  # an answer to an earlier message
    assert lockstep.started
    assert lockstep.take(answer(FIRST_US + 4 * 4000 - zero_us))
    assert not lockstep.take(answer(FIRST_US + 4 * 4000 - zero_us))  # no answer is accepted twice
    lockstep.sent(FIRST_US + 5 * 4000)
    assert not lockstep.take(answer(FIRST_US + 4 * 4000 - zero_us))
    assert not lockstep.take(answer(0))
    assert lockstep.take(answer(FIRST_US + 5 * 4000 - zero_us))
    assert lockstep.old == 4


@pytest.mark.parametrize("text", ["4560", "127.0.0.1", "tcp:127.0.0.1:4560", "127.0.0.1:70000", ":1", ""])
def test_a_bad_endpoint_is_refused_with_what_is_allowed(text):
    with pytest.raises(ValueError, match="HOST:PORT"):
        parse_endpoint(text, allow_unsigned=True)


def test_a_network_needs_leave():
    assert parse_endpoint("127.0.0.1:4560", allow_unsigned=False) == ("127.0.0.1", 4560)
    with pytest.raises(ValueError, match="allow-unsigned"):
        parse_endpoint("0.0.0.0:4560", allow_unsigned=False)
    assert parse_endpoint("0.0.0.0:4560", allow_unsigned=True) == ("0.0.0.0", 4560)
