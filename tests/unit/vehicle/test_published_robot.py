"""Tests the robot in lockstep (odometry, ticks computed in advance) and the buffer of the set-points."""

from types import SimpleNamespace

import pytest
from msgspec import msgpack

import flightstack as fs
from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import open_session
from flightstack.common.hangup import Stop
from flightstack.common.pacing import EPOCH_NS, RUN_AHEAD_TICKS
from flightstack.compiled.records import new
from logs.recorder.feed import Feed
from sim.clock import TickGrid
from sim.firmware.setpoint import ROOM, STOP, Inbox, InboxRecord, SetpointRecord, receive, set_point
from sim.runners import published_robot
from sim.runners.log import EventLog
from sim.runners.published_robot import LockstepRobot
from tests.processes.bounded import wait_for
from tests.processes.ports import free_endpoint

GRID = TickGrid(100)


class Log(EventLog):
    def __init__(self):
        super().__init__(Feed.connect(None, "vehicle", lossless=True), "target", EPOCH_NS)
        self.texts = []

    def event(self, now_ns, level, text):
        self.texts.append((now_ns, text))


@pytest.fixture
def ends():
    """Yield the robot's Zenoh session, subscribers to its odometry and ticks, and a credit publisher."""
    endpoint = free_endpoint()
    ours, theirs = open_session(listen=[endpoint]), open_session(connect=[endpoint])
    wait_for(lambda: zenoh_link.transports(ours) == 1)
    odom, marker = (
        zenoh_link.fifo_subscriber(theirs, f"t/{key}") for key in ("target/odom", "sim/target/ticks")
    )
    credit = zenoh_link.blocking_publisher(theirs, "t/sim/credit")
    yield SimpleNamespace(ours=ours, odom=odom, marker=marker, credit=credit)
    theirs.close()
    ours.close()


def robot_of(ends, log):
    waits = fs.scenario("reversing", {"target.wait_for_landing": True})
    made = LockstepRobot(GRID, ends.ours, Stop(), waits, 3, "t", log)
    wait_for(lambda: zenoh_link.is_matched(ends.credit))
    made.begin()
    return made


def received(subscriber, number):
    """Wait until at least this number of messages has arrived; return all that arrived."""
    came = []
    wait_for(lambda: came.extend(zenoh_link.drain(subscriber)) or len(came) >= number)
    return came


def test_it_drives_ahead_of_the_credit_by_a_fixed_number_of_ticks_and_waits_for_more_once(ends, monkeypatch):
    log = Log()
    robot = robot_of(ends, log)
    for tick in range(RUN_AHEAD_TICKS + 1):
        robot.await_credit(tick)
        robot.take(tick)
        robot.run_ahead(tick)
    _, ahead = received(ends.marker, 2)  # messages for tick 0, and for all ticks that the first credit allows
    first, counts = msgpack.decode(ahead.payload.to_bytes())
    assert (first, len(counts)) == (1, RUN_AHEAD_TICKS)
    monkeypatch.setattr(published_robot, "COMPANION_SILENT_S", 0.05)
    for tick in range(RUN_AHEAD_TICKS + 1, RUN_AHEAD_TICKS + 4):
        robot.await_credit(tick)
        robot.take(tick)
    (text,) = (text for _, text in log.texts)
    assert text == "no credit from the onboard process for 0.05 s: the robot continues without"


class Radio:
    """Sends and reads set-points through the ring buffer of the simulated radio."""

    def __init__(self):
        self.record, self.present = new(InboxRecord), new(SetpointRecord)
        self.inbox = Inbox(self.record, self.present)
        self.inbox.set(STOP, 0)

    def at(self, now_ms):
        """Return vx of the set-point that is active at this time, m/s, and the time of its arrival, ms."""
        receive(self.record, self.present, now_ms)
        return float(self.present.vx), int(self.record.taken_ms)


def test_a_set_point_arrives_whole_and_on_time():
    radio = Radio()
    sent = set_point((0.1, 0.2, 0.3), 0.4)
    radio.inbox.send(sent, 7)
    assert radio.at(6) == (0.0, 0)
    assert bool(radio.present.stop)
    assert radio.at(7) == (0.1, 7)
    assert tuple(radio.present.tolist()) == sent


def test_the_ring_goes_round():
    radio = Radio()
    for k in range(3 * ROOM):
        radio.inbox.send(set_point((float(k), 0.0, 0.0)), k)
        assert radio.at(k) == (float(k), k)


def test_without_room_the_newest_takes_the_last_place():
    radio = Radio()
    for k in range(ROOM + 5):
        radio.inbox.send(set_point((float(k), 0.0, 0.0)), k)
    assert radio.at(ROOM - 2) == (float(ROOM - 2), ROOM - 2)
    assert radio.at(10_000) == (float(ROOM + 4), ROOM + 4)


def test_what_is_set_holds_at_once_and_forgets_what_is_under_way():
    radio = Radio()
    radio.inbox.send(set_point((1.0, 0.0, 0.0)), 5)
    radio.inbox.set(STOP, 3)
    assert radio.at(100) == (0.0, 3)
