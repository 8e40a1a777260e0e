"""Tests fleet messages over Zenoh: times are converted to the receiver's clock, bad messages rejected."""

import time
from unittest import mock

import pytest

from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import open_session
from flightstack.core.parameters.fleet import Fleet
from flightstack.core.types import Intent, MemberStatus
from flightstack.onboard.fleet_wire import BYTES_MAX, LiveStatuses
from logs.schema.controller_rows import Echo, status_row
from logs.schema.rows import MemberStatusRow
from tests.processes.bounded import wait_for
from tests.processes.ports import free_endpoint

EPOCH_NS = 1_700_000_000_000_000_000
AHEAD_NS = 5_000_000_000  # offset of vehicle 7's clock relative to vehicle 3's
DELAY_S = 0.01
MEMBERS = (3, 7)
HERE, PROCESS = (1.0, 2.0, 3.0), 99


def told(id_=7, stamp_s=1.0, **more):
    return MemberStatus(id_, stamp_s, stamp_s, HERE, (0.1, 0.2, 0.3), (0.4, 0.5, 0.6), 0.01, **more)


@pytest.fixture
def sessions():
    endpoint = free_endpoint()
    listener = open_session([endpoint])
    dialler = open_session(connect=[endpoint])
    wait_for(lambda: zenoh_link.transports(listener) == 1)
    yield listener, dialler
    dialler.close()
    listener.close()


class Side:
    """A vehicle's connection with a clock that the test sets."""

    def __init__(self, session, id_, epoch_ns):
        fleet, self.id = Fleet(id_, MEMBERS), id_
        self.wire, self.now_s = LiveStatuses(session, f"cf{id_}", fleet), 1.0
        self.wire.begin(epoch_ns, lambda: self.now_s)

    def hear(self):
        """Wait for messages; return them."""
        found = []
        wait_for(lambda: found.extend(self.wire.statuses()) or found)
        return found


@pytest.fixture
def sides(sessions):
    """Yield vehicles 3 and 7, with different clocks, after an exchange of messages."""
    a, b = Side(sessions[0], 3, EPOCH_NS), Side(sessions[1], 7, EPOCH_NS + AHEAD_NS)
    greet(a, b)
    yield a, b
    a.wire.close()
    b.wire.close()


def pass_time(*sides):
    for side in sides:
        side.now_s += DELAY_S


def taken(side, count=1):
    """Receive at least ``count`` messages, also rejected messages; return the accepted messages."""
    read, words, drain = [], [], zenoh_link.drain

    def drained(subscriber):
        read.extend(samples := drain(subscriber))
        return samples

    with mock.patch.object(zenoh_link, "drain", drained):
        wait_for(lambda: words.extend(side.wire.statuses()) or len(read) >= count)
    return words


def greet(a, b):
    """Send from both vehicles in turn until each has accepted a message of the other vehicle."""
    heard = set()

    def in_turn():
        for teller, hearer in ((a, b), (b, a)):
            teller.wire.say(told(teller.id, teller.now_s))
            before_ns = hearer.wire._members[teller.id].heard_ns
            pass_time(a, b)
            end_s = time.monotonic() + 0.5  # the connection may not be complete yet
            while hearer.wire._members[teller.id].heard_ns == before_ns and time.monotonic() < end_s:
                heard.update(word.id for word in hearer.wire.statuses())
                time.sleep(0.001)
        return heard == {a.id, b.id}

    wait_for(in_turn)


@pytest.fixture
def stranger(sessions):
    """Yield a function that publishes arbitrary data on the fleet status key of a foreign namespace."""
    publisher = zenoh_link.blocking_publisher(sessions[1], "somewhere/else/fleet/status")
    wait_for(lambda: zenoh_link.is_matched(publisher))
    yield publisher.put
    publisher.undeclare()


def test_a_word_arrives_on_the_clock_of_who_reads_it(sides):
    a, b = sides
    said = told(
        7, b.now_s, intent=Intent.LANDING, claim_s=0.5, pad_position_enu_m=(4.0, 5.0, 0.2),
        pad_velocity_enu_m_s=(0.1, 0.0, 0.0), yields_to=(3,),
    )  # fmt: skip
    b.wire.say(said)
    pass_time(a, b)
    (word,) = a.hear()
    assert word.stamp_s == pytest.approx(said.stamp_s, abs=1e-4)  # equal clock readings, epochs 5 s apart
    assert word.claim_s == pytest.approx(0.5, abs=1e-4)
    assert word.clock_bound_s == pytest.approx(DELAY_S, rel=0.02)
    assert word.arrival_s == a.now_s
    same = {"stamp_s": 0.0, "arrival_s": 0.0, "claim_s": 0.0, "clock_bound_s": 0.0}
    assert word._replace(**same) == said._replace(**same)


def test_what_is_no_word_is_refused_and_said_on_doublings(sides, stranger):
    a, _ = sides
    for payload in (b"", b"\x00\x01\x00\x00nonsense", b"x" * (BYTES_MAX + 1), *[b"y"] * 4):
        stranger(payload)
    assert taken(a, 7) == []
    texts = a.wire.texts()
    assert [text.rpartition(": ")[2] for text in texts] == [f"{n} messages rejected" for n in (1, 2, 4)]
    assert all(text.startswith("fleet: malformed (") for text in texts)
    assert a.wire.texts() == []


def sent(stranger, id_=7, stamp_s=1.5, process=PROCESS, echoes=(), **more):
    row = status_row(told(id_, stamp_s), EPOCH_NS + AHEAD_NS, process, echoes)
    stranger(row._replace(**more).pack())


def test_a_second_process_of_this_vehicle_is_told_in_flight(sides, stranger):
    sent(stranger, 3)
    assert taken(sides[0]) == []
    (text,) = sides[0].wire.texts()
    assert text.startswith("fleet: another process has the vehicle id 3 of this one")


def test_of_two_processes_of_another_vehicle_the_first_is_heard(sides, stranger):
    a, _ = sides
    sent(stranger, 7)
    assert taken(a) == []
    assert a.wire.texts() == ["fleet: two processes have the vehicle id 7: 1 messages rejected"]
    a.now_s += 10.0  # longer than a silent vehicle may continue to fly
    sent(stranger, 7, echoes=(Echo(3, a.wire._process, AHEAD_NS + 9_000_000_000),))
    taken(a)
    texts = a.wire.texts()
    assert "fleet: vehicle 7 has a new process after 10.0 s" in texts[0]


@pytest.mark.parametrize(
    ("stamp_s", "clock_s", "lost"), [(3600.0, 0.0, 1), (0.0, 3600.0, 22), (0.0, -0.9, 22)]
)
def test_a_wrong_stamp_costs_one_word_and_a_clock_that_was_set_is_followed(sides, stamp_s, clock_s, lost):
    """After one wrong stamp one message is lost; after a step of the sender's clock, at most 22."""
    a, b = sides
    heard = []
    for n in range(60):
        pass_time(a, b)
        pass_time(a, b)
        b.now_s += clock_s * (n == 20)
        b.wire.say(told(7, b.now_s + stamp_s * (n == 20)))
        a.wire.say(told(3, a.now_s))
        heard += [n] * bool(taken(a))
        taken(b)
    missing = sorted(set(range(20, 60)) - set(heard))
    assert missing == list(range(20, 20 + len(missing)))
    assert 1 <= len(missing) <= lost


def test_a_word_counts_when_its_teller_hears_this_one(sides, stranger):
    """A message is rejected until the sender has received this vehicle's messages, as its time is unknown."""
    a, _ = sides
    a.now_s += 10.0
    sent(stranger, 7, 11.0)
    assert taken(a) == []
    sent(stranger, 7, 11.01, echoes=(Echo(3, a.wire._process + 1, AHEAD_NS),))  # echo of an earlier process
    assert taken(a) == []
    sent(stranger, 7, 11.02, echoes=(Echo(3, a.wire._process, AHEAD_NS + 20_000_000),))
    (word,) = taken(a)
    assert word.stamp_s == pytest.approx(11.02, abs=word.clock_bound_s)


def test_a_member_that_does_not_hear_this_one_is_told_once_and_the_next_time_again(sides, stranger):
    a, b = sides
    process = MemberStatusRow.unpack(b.wire.say(told(7, b.now_s))).process
    a.hear()
    texts = []
    for n, hears in enumerate((False, False, False, True, False, False), 1):
        a.now_s += 2.5
        echo = (Echo(3, a.wire._process, AHEAD_NS + 50_000_000),) if hears else ()
        sent(stranger, 7, b.now_s + 2.5 * n, process, echo)
        taken(a)
        texts += [n for text in a.wire.texts() if "receives no messages of this one" in text]
    assert texts == [2, 6]
