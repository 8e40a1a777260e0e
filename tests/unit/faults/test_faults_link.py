"""Tests faults of the MAVLink connection: lost, late, duplicated, damaged, changed messages, exceptions."""

from collections import Counter

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.codec.framing import split_frames
from sim.faults.link import CONCERNS, LinkFaults, Way, clock_ns
from sim.plant.sensors import NS
from sim.runners.vehicle_node import HELD_MAX, Wire
from sim.scenarios.fault_spec import TABLE, Kind, What
from tests.unit.faults.fault_helpers import running

MS = NS // 1000
PEER = ("127.0.0.1", 14540)
LINK_CELLS = [(what, kind) for what in CONCERNS for kind in TABLE[what]]


class FakeEndpoint:
    """Packs messages, and stores those that are sent."""

    peers = (PEER,)

    def __init__(self):
        self._mav = mav.MAVLink(None, 1, 1)
        self.sent = []

    def send(self, messages, peer):
        self.sent += [self.pack(message) for message in messages]

    def pack(self, message):
        frame = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame

    def repeat(self, frame, peer):
        assert peer == PEER
        self.sent.append(frame)


def position(ms):
    return mav.MAVLink_local_position_ned_message(ms, 1.0, 2.0, -3.0, 0.0, 0.0, 0.0)


def heartbeat(base_mode=157):
    return mav.MAVLink_heartbeat_message(2, 12, base_mode, 0x00060000, 4, 3)


def out(*faults, make=position, seconds=10.0, end_s=None):
    """Send a message every 10 ms, with faults from 1 s on; return wire and arrivals (sent_ms, message)."""
    link, parser = LinkFaults(), mav.MAVLink(None)
    endpoint = FakeEndpoint()
    wire, got = Wire(endpoint, link), []
    for ms in range(0, round(seconds * 1000), 10):
        if ms == 1000:
            for one in faults:
                link.begin(one)
        if end_s is not None and ms == round(end_s * 1000):
            for one in faults:
                one.over = True
                link.end(one, ms * MS)
        wire.send([make(ms)], ms * MS)
        counters = Counter()
        for raw in endpoint.sent:
            frames = split_frames(raw, counters)
            got += [(ms, parser.decode(bytearray(frame))) for frame in frames]
        endpoint.sent.clear()
    return wire, got


def late(kind, what=What.LINK_OUT, **values):
    return running(what, kind, 1.0, **values)


@pytest.mark.parametrize(("what", "kind"), LINK_CELLS)
def test_a_fault_that_is_over_leaves_nothing_behind(what, kind):
    fault = late(kind, what)
    wire, got = out(fault, end_s=5.0)
    clean = [(ms, m.time_boot_ms) for ms, m in got if ms > 5300]
    assert clean == [(ms, ms) for ms in range(5310, 10_000, 10)]
    assert wire.sound


def test_a_duplicate_arrives_twice_at_once():
    _, got = out(late(Kind.DUPLICATE, value=1.0), seconds=2.0)
    assert [ms for ms, _ in got if ms >= 1000] == [ms for ms in range(1000, 2000, 10) for _ in range(2)]


def test_a_stalled_wire_lets_everything_go_at_the_end_within_its_bound():
    _, got = out(late(Kind.STUCK), end_s=3.0)
    assert not [ms for ms, _ in got if 1000 <= ms < 3000]
    assert [m.time_boot_ms for ms, m in got if ms == 3000] == list(range(1000, 3010, 10))
    wire, got = out(late(Kind.STUCK), seconds=60.0)
    assert wire._leaving.size == HELD_MAX


def test_faults_of_set_points_leave_commands_alone():
    link = LinkFaults()
    link.begin(running(What.SETPOINTS, Kind.OFF))
    arm = mav.MAVLink_command_long_message(1, 1, 400, 0, 1.0, 0, 0, 0, 0, 0, 0)
    assert link.fate(Way.IN, arm, 0).due_ns == (0,)


@pytest.mark.parametrize(
    ("kind", "values", "shown_s"),
    [
        (Kind.OFF, {}, 0.0),
        (Kind.STUCK, {}, 1.0),
        (Kind.WRONG, {"value": 10.0}, 13.25),
        (Kind.WRONG, {"value": -10.0}, 0.0),
        (Kind.DELAYED, {"value": 0.2}, 3.05),
        (Kind.SLOW, {"value": 0.5}, 2.125),
        (Kind.INTERMITTENT, {"value": 0.3, "period_s": 1.0}, 3.0),  # 3.25 s is 0.25 s into a pause
    ],
)
def test_what_a_faulty_clock_shows_at_3_25_s(kind, values, shown_s):
    one = late(kind, What.CLOCK, **values)
    assert clock_ns(one, 3_250_000_000) == round(shown_s * NS)
    _, got = out(one, seconds=3.26)
    assert got[-1][1].time_boot_ms == round(shown_s * 1000)


def test_all_time_stamps_follow_the_clock_but_a_request_for_the_time():
    link = LinkFaults()
    link.begin(running(What.CLOCK, Kind.WRONG, value=5.0))
    system_time = mav.MAVLink_system_time_message(1_000_000_000, 2000)
    home = mav.MAVLink_gps_global_origin_message(0, 0, 0, 2_000_000)
    request, answer = mav.MAVLink_timesync_message(0, 7), mav.MAVLink_timesync_message(2 * NS, 7)
    beat = heartbeat()
    for message in (system_time, home, request, answer, beat):
        link.fate(Way.OUT, message, 2 * NS)
    assert (system_time.time_unix_usec, system_time.time_boot_ms) == (1_005_000_000, 7000)
    assert home.time_usec == 7_000_000
    assert (request.tc1, answer.tc1, answer.ts1) == (0, 7 * NS, 7)
