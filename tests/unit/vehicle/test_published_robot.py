"""The robot of the world process in lockstep: what it publishes, how far ahead, and when it drives off."""

import struct
from types import SimpleNamespace

import pytest

from bridge.target.odometry import sample_from_cdr
from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import open_session
from flightstack.common.hangup import Stop
from flightstack.common.pacing import EPOCH_NS, NO_GO, PAIR, RUN_AHEAD_TICKS
from logs.recorder.feed import Feed
from sim.clock import TickGrid
from sim.runners import published_robot
from sim.runners.deck import deck_state
from sim.runners.log import EventLog
from sim.runners.published_robot import LockstepRobot
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
    """A session for the robot, and a reader of all that it publishes."""
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
    """Drive tick by tick like its vehicle, with a reader that gives credit; the decks and log texts."""
    log = Log()
    robot, decks = robot_of(ends, name, log), []
    for tick in range(TICKS):
        if tick % 10 == 0:
            ends.credit.put(PAIR.pack(tick, NO_GO))
        decks.append(robot.take(tick))
        robot.run_ahead(tick)
        if tick == chosen_at:
            ends.credit.put(PAIR.pack(tick, tick + RUN_AHEAD_TICKS + 1))
    return decks, log.texts


def received(subscriber, number):
    """All that came, once so much has come."""
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
        arrived = tuple(sample_from_cdr(each.payload.to_bytes(), 0.01 * tick) for each in come)
        assert repr(arrived) == repr(samples), tick


def test_it_drives_ahead_of_the_credit_by_a_fixed_number_of_ticks_and_waits_for_more_once(ends, monkeypatch):
    log = Log()
    robot = robot_of(ends, "reversing", log)
    for tick in range(RUN_AHEAD_TICKS + 1):
        robot.take(tick)
        robot.run_ahead(tick)
    markers = received(ends.marker, RUN_AHEAD_TICKS + 1)
    assert PAIR.unpack(markers[-1].payload.to_bytes())[0] == RUN_AHEAD_TICKS
    monkeypatch.setattr(published_robot, "COMPANION_SILENT_S", 0.05)
    for tick in range(RUN_AHEAD_TICKS + 1, RUN_AHEAD_TICKS + 4):
        robot.take(tick)
    (text,) = (text for _, text in log.texts)
    assert text == "no credit from the onboard process for 0.05 s: the robot continues without"
