"""The robot of the world process in lockstep: published data, its lead, and the start of its drive."""

import math
import struct
from types import SimpleNamespace

import pytest

from bridge.target.odometry import RawSample, sample_of
from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import open_session
from flightstack.common.hangup import Stop
from flightstack.common.pacing import EPOCH_NS, NO_GO, PAIR, RUN_AHEAD_TICKS
from flightstack.compiled.records import new
from logs.recorder.feed import Feed
from sim.clock import TickGrid
from sim.firmware.setpoint import ROOM, STOP, Inbox, InboxRecord, Setpoint, SetpointRecord, receive
from sim.plant.sensors import NS_PER_MS, MeasurementChannel
from sim.runners import published_robot
from sim.runners.deck import deck_state
from sim.runners.log import EventLog
from sim.runners.published_robot import LockstepRobot
from sim.scenarios.scenario import OdometryLink
from sim.vehicle.mocap import MocapRecord, MocapTape
from sim.world.bodies import BodyRecord
from tests.processes.ports import free_endpoint
from tests.unit.target.ros2_helpers import until
from tests.unit.vehicle.test_target import SCENARIOS, tick_by_tick

GRID = TickGrid(100)
TICKS = 120


class Log(EventLog):
    def __init__(self):
        super().__init__(Feed.connect(None, "vehicle", lossless=True), "target", EPOCH_NS)
        self.texts = []

    def event(self, now_ns, level, text):
        self.texts.append((now_ns, text))


@pytest.fixture
def ends():
    """A session for the robot, and a subscriber to all its data."""
    endpoint = free_endpoint()
    ours, theirs = open_session(listen=[endpoint]), open_session(connect=[endpoint])
    until(lambda: zenoh_link.transports(ours) == 1)
    odom, marker = (
        zenoh_link.fifo_subscriber(theirs, f"t/{key}") for key in ("target/odom", "sim/target/tick")
    )
    credit = zenoh_link.blocking_publisher(theirs, "t/sim/credit")
    yield SimpleNamespace(ours=ours, odom=odom, marker=marker, credit=credit)
    theirs.close()
    ours.close()


def robot_of(ends, name, log):
    made = LockstepRobot(GRID, ends.ours, Stop(), SCENARIOS[name], 3, "t", log)
    until(lambda: zenoh_link.is_matched(ends.credit))
    made.begin()
    return made


def fly(ends, name, chosen_at):
    """Drive tick by tick like its vehicle, with a reader that gives credit; return decks and log texts."""
    log = Log()
    robot, decks = robot_of(ends, name, log), []
    for tick in range(TICKS):
        if tick % 10 == 0:
            ends.credit.put(PAIR.pack(tick, NO_GO))
        robot.await_credit(tick)
        decks.append(robot.take(tick))
        robot.run_ahead(tick)
        if tick == chosen_at:
            ends.credit.put(PAIR.pack(tick, tick + RUN_AHEAD_TICKS + 1))
    return decks, log.texts


def received(subscriber, number):
    """Return all received data, once this much has arrived."""
    came = []
    until(lambda: came.extend(zenoh_link.drain(subscriber)) or len(came) >= number)
    return came


@pytest.mark.parametrize(
    ("name", "chosen_at"), [("reversing", 30), ("deck", 30), ("fault_target_dropout", 19)]
)
def test_poses_samples_and_ticks_are_those_of_a_landing_in_one_process(ends, name, chosen_at):
    decks, _ = fly(ends, name, chosen_at)
    expected = list(tick_by_tick(SCENARIOS[name], 3, chosen_at))[:TICKS]
    assert [repr(tuple(each[:4])) for each in decks] == [repr(tuple(deck[:4])) for deck, _ in expected]
    assert all(repr(deck_state(each.payload)[:4]) == repr(each[:4]) for each in decks)
    markers = [PAIR.unpack(each.payload.to_bytes()) for each in received(ends.marker, TICKS)]
    assert [tick for tick, _ in markers] == list(range(len(markers)))
    counts = [0, *(count for _, count in markers)]
    odom = received(ends.odom, counts[TICKS])
    assert [struct.unpack_from("<q", each.attachment.to_bytes())[0] for each in odom] == [
        n + 1 for n in range(len(odom))
    ]
    for tick, (_, samples) in enumerate(expected):
        come = odom[counts[tick] : counts[tick + 1]]
        arrived = tuple(sample_of(RawSample(each.payload.to_bytes()), 0.01 * tick) for each in come)
        assert repr(arrived) == repr(samples), tick


def test_it_drives_ahead_of_the_credit_by_a_fixed_number_of_ticks_and_waits_for_more_once(ends, monkeypatch):
    log = Log()
    robot = robot_of(ends, "reversing", log)
    for tick in range(RUN_AHEAD_TICKS + 1):
        robot.await_credit(tick)
        robot.take(tick)
        robot.run_ahead(tick)
    markers = received(ends.marker, RUN_AHEAD_TICKS + 1)
    assert PAIR.unpack(markers[-1].payload.to_bytes())[0] == RUN_AHEAD_TICKS
    monkeypatch.setattr(published_robot, "COMPANION_SILENT_S", 0.05)
    for tick in range(RUN_AHEAD_TICKS + 1, RUN_AHEAD_TICKS + 4):
        robot.await_credit(tick)
        robot.take(tick)
    (text,) = (text for _, text in log.texts)
    assert text == "no credit from the onboard process for 0.05 s: the robot continues without"


class Radio:
    """Both ends of the ring buffer."""

    def __init__(self):
        self.record, self.present = new(InboxRecord), new(SetpointRecord)
        self.inbox = Inbox(self.record, self.present)
        self.inbox.set(STOP, 0)

    def at(self, now_ms):
        """Return the speed of the set-point at this time, and its age."""
        receive(self.record, self.present, now_ms)
        return float(self.present.vx), int(self.record.taken_ms)


def test_a_set_point_arrives_whole_and_on_time():
    radio = Radio()
    sent = Setpoint(0.1, 0.2, 0.3, 0.4)
    radio.inbox.send(sent, 7)
    assert radio.at(6) == (0.0, 0)
    assert bool(radio.present.stop)
    assert radio.at(7) == (0.1, 7)
    assert tuple(radio.present.tolist()) == sent.fields()


def test_the_ring_goes_round():
    radio = Radio()
    for k in range(3 * ROOM):
        radio.inbox.send(Setpoint(float(k)), k)
        assert radio.at(k) == (float(k), k)


def test_without_room_the_newest_takes_the_last_place():
    radio = Radio()
    for k in range(ROOM + 5):
        radio.inbox.send(Setpoint(float(k)), k)
    assert radio.at(ROOM - 2) == (float(ROOM - 2), ROOM - 2)
    assert radio.at(10_000) == (float(ROOM + 4), ROOM + 4)


def test_what_is_set_holds_at_once_and_forgets_what_is_under_way():
    radio = Radio()
    radio.inbox.send(Setpoint(1.0), 5)
    radio.inbox.set(STOP, 3)
    assert radio.at(100) == (0.0, 3)


LINKS = {
    "default": OdometryLink(100.0, 0.001, 0.0, 0.005, 0.010),
    "perfect": OdometryLink(100.0),
    "longest": OdometryLink(500.0, 0.001, 0.0, 0.005, 0.5),
    "odd": OdometryLink(30.0, 0.01, 0.0, 0.0, 0.0333),
    "slowest": OdometryLink(1.0, 0.0, 0.0, 0.01, 0.25),
    "bad": OdometryLink(200.0, 0.002, 0.0, 0.005, 0.02, loss=0.2, dropout_every_s=0.7, dropout_max_s=0.5),
    "nothing": OdometryLink(100.0, 0.001, 0.0, 0.005, 0.010, loss=1.0),
}
END_MS = 4_000


def move(body, now_ms):
    """Return a motion; with zeros of both signs at the start."""
    yaw = 0.001 * now_ms
    body.position[:] = (-0.0 if now_ms < 100 else 0.001 * now_ms, math.sin(yaw), 0.0)
    body.quaternion[:] = (math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw))
    return (*body.position.tolist(), math.atan2(2.0 * (body.quaternion[0] * body.quaternion[3]),
            1.0 - 2.0 * body.quaternion[3] ** 2))  # fmt: skip


def by_channel(link, seed):
    noise = link.position_noise_m
    channel = MeasurementChannel(link, (noise, noise, noise, link.yaw_noise_rad), seed, "mocap")
    body, arrived = new(BodyRecord), []
    for now_ms in range(END_MS):
        pose, now_ns = move(body, now_ms), now_ms * NS_PER_MS
        while now_ns >= channel.due_ns:
            channel.sample(now_ns, pose)
        arrived += [(now_ms, *map(float, values)) for _, values in channel.release(now_ns)]
    return arrived


def by_tape(link, seed):
    body, record = new(BodyRecord), new(MocapRecord)
    tape, arrived = MocapTape(link, seed, record, body), []
    for now_ms in range(END_MS):
        if now_ms % 50 == 0:
            tape.top_up()
        move(body, now_ms)
        due_ms = tape.next_ms()
        samples = tape.take(now_ms)
        assert due_ms <= now_ms or not samples
        arrived += [(now_ms, *values) for values in samples]
        assert tape.drawn_until_ms > now_ms
    return arrived


@pytest.mark.parametrize("name", LINKS)
@pytest.mark.parametrize("seed", [7])
def test_the_same_bits_as_a_channel(name, seed):
    expected = by_channel(LINKS[name], seed)
    assert repr(by_tape(LINKS[name], seed)) == repr(expected)
    assert bool(expected) is (name != "nothing")
