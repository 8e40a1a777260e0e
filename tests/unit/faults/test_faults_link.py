"""Faults of the MAVLink connection: lost, late, duplicated, damaged or rewritten messages, and exceptions."""

import itertools
import statistics

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.codec.framing import split_frames
from bridge.mavlink.endpoint import Received
from bridge.mavlink.transport.transport import EndpointCounters
from sim.faults.link import CONCERNS, LinkFaults, Way, clock_ns
from sim.plant.sensors import NS
from sim.runners.vehicle_node import HELD_MAX, Wire
from sim.scenarios.fault_spec import TABLE, Kind, What
from tests.unit.faults.fault_helpers import running

MS = NS // 1000
PEER = ("127.0.0.1", 14540)
LINK_CELLS = [(what, kind) for what in CONCERNS for kind in TABLE[what]]


class FakeEndpoint:
    """Packs messages and stores the sent ones."""

    def __init__(self):
        self._mav = mav.MAVLink(None, 1, 1)
        self.sent = []

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


def setpoint(north):
    return mav.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 2503, 0.0, 0.0, 0.0, north, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    )


def out(*faults, make=position, seconds=10.0, end_s=None):
    """Return (sent_ms, decoded) of a message every 10 ms, with faults from 1 s on."""
    link, parser = LinkFaults(), mav.MAVLink(None)
    endpoint = FakeEndpoint()
    wire, got = Wire(endpoint, link), []
    for ms in range(0, round(seconds * 1000), 10):
        if ms == 1000:
            for one in faults:
                one.active = True
                link.begin(one)
        if end_s is not None and ms == round(end_s * 1000):
            for one in faults:
                one.active, one.over = False, True
                link.end(one, ms * MS)
        wire.send([make(ms)], [PEER], ms * MS)
        counters = EndpointCounters()
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


def numbers(got):
    return [m.get_header().seq for _, m in got]


@pytest.mark.parametrize("p", [0.02, 0.3])
def test_loss_has_its_probability_and_leaves_gaps_in_the_numbers(p):
    _, got = out(late(Kind.LOSS, value=p), seconds=101.0)
    lost = 1.0 - (len(got) - 100) / 10_000
    assert lost == pytest.approx(p, abs=4 * (p * (1 - p) / 10_000) ** 0.5)
    gaps = sum((b - a) % 256 - 1 for a, b in itertools.pairwise(numbers(got)))
    assert gaps == pytest.approx(10_100 - len(got), abs=3)  # losses at the end show no gap


@pytest.mark.slow
def test_bursts_have_their_mean_lengths():
    _, got = out(late(Kind.BURST_LOSS, value=0.2, period_s=1.0), seconds=301.0)
    arrived = {ms for ms, _ in got}
    runs = [(lost, len(list(group))) for lost, group in itertools.groupby(
        ms not in arrived for ms in range(1000, 301_000, 10)
    )]  # fmt: skip
    bad = [n * 0.01 for lost, n in runs if lost]
    good = [n * 0.01 for lost, n in runs if not lost]
    assert len(bad) > 150
    assert statistics.mean(bad) == pytest.approx(0.2, rel=0.2)
    assert statistics.mean(good) == pytest.approx(1.0, rel=0.2)


def test_off_slow_intermittent_and_delayed():
    _, got = out(late(Kind.OFF))
    assert [ms for ms, _ in got] == list(range(0, 1000, 10))
    _, got = out(late(Kind.SLOW, value=5))
    assert {b - a for (a, _), (b, _) in itertools.pairwise(got) if a > 1100} == {50}
    _, got = out(late(Kind.INTERMITTENT, value=0.2, period_s=0.5))
    assert {(ms - 1000) % 500 for ms, _ in got if ms >= 1000} == set(range(200, 500, 10))
    _, got = out(late(Kind.DELAYED, value=0.3))
    assert {ms - m.time_boot_ms for ms, m in got if ms >= 1300} == {300}


def test_reordered_messages_arrive_after_later_ones_and_none_is_lost():
    _, got = out(late(Kind.REORDER, value=0.2))
    stamps = [m.time_boot_ms for ms, m in got if ms < 9900]
    assert stamps != sorted(stamps)
    assert sorted(stamps)[:980] == list(range(0, 9800, 10))
    assert {ms - m.time_boot_ms for ms, m in got} == {0, 30}


def test_a_stalled_wire_lets_everything_go_at_the_end_within_its_bound():
    _, got = out(late(Kind.STUCK), end_s=3.0)
    assert not [ms for ms, _ in got if 1000 <= ms < 3000]
    assert [m.time_boot_ms for ms, m in got if ms == 3000] == list(range(1000, 3010, 10))
    wire, got = out(late(Kind.STUCK), seconds=60.0)
    assert wire._leaving.size == HELD_MAX
    assert wire._leaving.overflows == 5900 - HELD_MAX


def test_damaged_messages_do_not_pass_the_checksum():
    _, got = out(late(Kind.GARBAGE, value=1.0), end_s=5.0)
    assert [ms for ms, _ in got] == [*range(0, 1000, 10), *range(5000, 10_000, 10)]


def test_the_heartbeat_lies_while_the_rest_is_sound():
    def both(ms):
        return heartbeat() if ms % 20 else position(ms)

    _, got = out(late(Kind.WRONG, What.HEARTBEAT), make=both)
    beats = [m.base_mode for ms, m in got if m.get_type() == "HEARTBEAT" and ms > 1000]
    assert set(beats) == {157 ^ 128}
    _, got = out(late(Kind.GARBAGE, What.HEARTBEAT), make=both)
    beats = {m.custom_mode for ms, m in got if m.get_type() == "HEARTBEAT" and ms > 1000}
    assert len(beats) > 400
    assert len([m for _, m in got if m.get_type() == "LOCAL_POSITION_NED"]) == 500
    _, got = out(late(Kind.OFF, What.HEARTBEAT), make=both)
    assert {m.get_type() for ms, m in got if ms > 1000} == {"LOCAL_POSITION_NED"}


def received(message):
    return Received(message, b"", PEER)


def through(*faults, values=range(100)):
    """Return the northward velocities that reach the autopilot, with one set-point every 10 ms."""
    link = LinkFaults()
    for one in faults:
        link.begin(one)
    wire, got = Wire(FakeEndpoint(), link), []
    for k, north in enumerate(values):
        got += [r.message.vx for r in wire.late(k * 10 * MS)]
        got += [r.message.vx for r in wire.receive(received(setpoint(float(north))), k * 10 * MS)]
    return got


def test_set_points_are_lost_late_twice_or_changed():
    def one(kind, **values):
        return running(What.SETPOINTS, kind, **values)

    assert through() == list(range(100))
    assert through(one(Kind.OFF)) == []
    assert through(one(Kind.STUCK)) == [0.0] * 100
    assert through(one(Kind.WRONG, value=-0.5)) == [-0.5 * k for k in range(100)]
    assert through(one(Kind.DELAYED, value=0.1)) == list(range(90))
    assert through(one(Kind.DUPLICATE, value=1.0)) == [k // 2 for k in range(200)]
    assert len(through(one(Kind.LOSS, value=0.5))) == pytest.approx(50, abs=20)
    assert through(one(Kind.SLOW, value=10)) == list(range(9, 100, 10))
    garbage = through(one(Kind.GARBAGE, value=0.3))
    assert len(set(garbage)) == 100
    assert max(map(abs, garbage)) <= 0.3
    assert sorted(through(one(Kind.REORDER, value=0.3))) != through(one(Kind.REORDER, value=0.3))
    assert through(running(What.LINK_IN, Kind.GARBAGE, value=1.0)) == []


def test_faults_of_set_points_leave_commands_alone():
    link = LinkFaults()
    link.begin(running(What.SETPOINTS, Kind.OFF))
    arm = mav.MAVLink_command_long_message(1, 1, 400, 0, 1.0, 0, 0, 0, 0, 0, 0)
    assert link.fate(Way.IN, arm, 0).due_ns == (0,)


def test_the_injecting_hand_is_never_cut_off():
    link = LinkFaults()
    for what in (What.LINK_IN, What.LINK_OUT):
        for kind in (Kind.OFF, Kind.STUCK):
            link.begin(running(what, kind))
    inject = mav.MAVLink_command_long_message(1, 1, 420, 0, 105.0, 0, 0, 0, 0, 0, 0)
    arm = mav.MAVLink_command_long_message(1, 1, 400, 0, 1.0, 0, 0, 0, 0, 0, 0)
    assert link.fate(Way.IN, inject, 7) == ((7,), False, None)
    assert link.fate(Way.OUT, mav.MAVLink_command_ack_message(420, 0), 7) == ((7,), False, None)
    assert link.fate(Way.IN, arm, 7).due_ns == ()


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
