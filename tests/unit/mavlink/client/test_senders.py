"""Tests that ids, the known address and heartbeats identify the frames of the vehicle."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.senders import SILENT_S, Kind, Senders
from bridge.mavlink.codec.messages import decode
from flightstack.onboard.runner import LinkedVehicle
from tests.unit.mavlink.client.vehicle_link_fakes import (
    LAND,
    LOITER,
    OFFBOARD,
    FakeAutopilot,
    attitude,
    heartbeat,
    linked,
    poll,
    position,
)
from tests.unit.mavlink.codec.frames_of_messages import packed

HERE, THERE = ("127.0.0.1", 14580), ("127.0.0.1", 14590)
QUADROTOR, STATION = Kind(2, 12), Kind(6, 8)
TEXT = dialect.MAVLink_statustext_message(4, b"motors on fire")
ACK = dialect.MAVLink_command_ack_message(400, 4)


class Wire:
    """A ``Senders`` object under test, and the newest sequence number of each stream."""

    def __init__(self, **known):
        self.senders = Senders(**known)
        self.numbers = {}

    def admits(self, message, peer=HERE, now_s=0.0, *, armed=False, stream=None):
        number = self.numbers[stream or peer] = (self.numbers.get(stream or peer, 7) + 1) % 256
        decoded = decode(packed(message, number))
        return self.senders.admits(decoded, peer, now_s, armed=armed)

    def beats(self, kind=QUADROTOR, peer=HERE, now_s=0.0, *, armed=False, mode=LOITER, stream=None):
        message = dialect.MAVLink_heartbeat_message(*kind, 128 if armed else 1, mode, 3, 3)
        return self.admits(message, peer, now_s, armed=armed, stream=stream)


@pytest.mark.parametrize("late_s", [0.01, 0.1, 0.3, 0.5])
def test_a_path_that_delivers_all_once_more_and_later_says_nothing_new(late_s):
    senders, path, said = Senders(), [], []
    for k in range(900):  # 300 frames a second; the vehicle is armed after a second
        now_s = k / 300.0
        beat = dialect.MAVLink_heartbeat_message(*QUADROTOR, 128 if k >= 300 else 1, LOITER, 3, 3)
        frame = packed(beat if k % 300 == 0 else position(k) if k % 2 else attitude(k), k % 256)
        path.append((now_s + late_s, frame))
        assert senders.admits(decode(frame), HERE, now_s, armed=k > 300)
        while path and path[0][0] <= now_s:
            said.append(senders.admits(decode(path.pop(0)[1]), HERE, now_s, armed=k > 300))
    assert said
    assert not any(said)
    assert senders.ignored == 0  # no frame counts as a frame of another sender


def test_a_sender_that_numbers_all_its_frames_alike_is_heard():
    senders, frames = (
        Senders(),
        [packed(m) for m in (heartbeat(LOITER), position(), heartbeat(LOITER))],
    )
    assert all(senders.admits(decode(frame), HERE, k, armed=False) for k, frame in enumerate(3 * frames))


def test_requests_of_lockstep_may_come_again():
    senders, request = Senders(), packed(dialect.MAVLink_timesync_message(0, 10), 3)
    assert all(senders.admits(decode(request), HERE, k, armed=True) for k in range(3))


@pytest.mark.parametrize("armed", [False, True])
@pytest.mark.parametrize(
    "foreign",
    [heartbeat(OFFBOARD, armed=True), heartbeat(LOITER), heartbeat(LAND), position(9), attitude(9), ACK, TEXT,
     dialect.MAVLink_heartbeat_message(*STATION, 0, 0, 4, 3)],
)  # fmt: skip
def test_another_address_is_counted_and_ignored_while_the_known_one_is_well(foreign, armed):
    wire = Wire()
    for second in range(4):
        assert wire.beats(now_s=second, armed=armed)
        assert not wire.admits(foreign, THERE, second + 0.9, armed=armed)
    assert wire.senders.known == HERE
    assert wire.senders.ignored == 4
    told = wire.senders.take_notices()
    assert len(told) == 3  # notices at 1, 2 and 4 ignored frames
    words = ("from 127.0.0.1:14590", "the vehicle is at 127.0.0.1:14580", foreign.get_type())
    assert all(word in told[-1] for word in words)


def test_a_vehicle_behind_a_new_port_is_followed_once_the_old_one_is_silent():
    wire = Wire()
    assert wire.beats(armed=True)
    assert not wire.beats(peer=THERE, now_s=SILENT_S, armed=True)
    assert not wire.admits(position(), THERE, SILENT_S + 0.1, armed=True)  # a heartbeat must come first
    assert wire.beats(peer=THERE, now_s=SILENT_S + 0.1, armed=True)
    assert wire.admits(position(), THERE, SILENT_S + 0.1, armed=True)
    assert not wire.admits(position(), HERE, SILENT_S + 0.2, armed=True)
    assert any("sends from 127.0.0.1:14590 now" in text for text in wire.senders.take_notices())


@pytest.mark.parametrize("armed", [False, True])
def test_a_vehicle_whose_heartbeats_are_rare_is_not_silent_while_its_state_comes(armed):
    wire = Wire()
    for tick in range(100):
        now_s = 0.1 * tick
        if tick % 33 == 0:
            assert wire.beats(now_s=now_s, armed=armed)
        assert wire.admits(position(tick), now_s=now_s, armed=armed)
        assert not wire.beats(peer=THERE, now_s=now_s + 0.05, armed=armed)
    assert wire.senders.known == HERE


def test_two_live_addresses_are_named_and_nothing_arms_until_that_is_known():
    wire = Wire()
    assert wire.beats()
    assert not wire.senders.suspects
    for tick in range(1, 7):
        wire.admits(position(tick), THERE, 0.1 * tick)
        assert wire.senders.suspects
        assert wire.senders.doubled is None
        assert wire.admits(position(tick), HERE, 0.1 * tick)
    wire.admits(position(), THERE, 0.8)
    assert "127.0.0.1:14580 and 127.0.0.1:14590" in wire.senders.doubled
    assert "system id" in wire.senders.doubled


@pytest.mark.parametrize("claim", [{"armed": False}, {"mode": LOITER, "armed": True}])
def test_on_one_line_a_heartbeat_out_of_step_must_say_it_twice(claim):
    wire = Wire()
    for tick in range(10):
        wire.admits(position(tick))
    wire.numbers["script"] = 90
    for second in range(3):
        assert wire.beats(now_s=second, armed=True, mode=OFFBOARD)
        message = heartbeat(claim.get("mode", OFFBOARD), armed=claim["armed"])
        assert not wire.admits(message, now_s=second + 0.5, armed=True, stream="script")
    assert not wire.admits(message, now_s=2.9, armed=True, stream="script")
    assert wire.beats(now_s=3.0, armed=True, mode=OFFBOARD)
    wire.numbers[HERE] += 100  # 100 lost frames: one heartbeat is not enough
    assert not wire.admits(message, now_s=4.0, armed=True)
    assert wire.admits(message, now_s=5.0, armed=True)


def test_a_stream_that_a_router_filters_is_believed_at_once():
    wire = Wire()
    for tick in range(20):
        wire.numbers[HERE] = wire.numbers.get(HERE, 0) + 12  # a router drops 12 frames
        assert wire.admits(position(tick), armed=True)
    wire.numbers[HERE] += 12
    assert wire.beats(now_s=0.5, armed=True, mode=OFFBOARD)
    wire.numbers[HERE] += 12
    assert wire.beats(now_s=1.0, armed=True, mode=LOITER)


@pytest.fixture
def listening():
    link = linked()
    ends = [FakeAutopilot(f"udpout:127.0.0.1:{link.endpoint.local_port}") for _ in range(2)]
    yield link, *ends
    for end in (*ends, link):
        (end.endpoint if end is not link else end).close()


def test_a_vehicle_is_not_ready_while_a_second_one_may_be_there(listening):
    link, vehicle, other = listening
    ready = dialect.MAVLink_sys_status_message(0, 0, 1 << 28, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0)
    vehicle.send(heartbeat(), ready)
    poll(link, 0.0)
    seen = LinkedVehicle(link, lockstep=False)
    assert seen.read().status.ready_to_arm
    other.beat()
    poll(link, 0.1)
    assert not seen.read().status.ready_to_arm
    vehicle.beat()
    poll(link, 0.2 + SILENT_S)
    assert seen.read().status.ready_to_arm


def test_the_other_clock_of_the_flight_begins_with_the_address_of_the_check():
    wire = Wire()
    assert wire.beats(now_s=5_000.0)
    wire.senders.begin(0.0)
    assert not wire.beats(peer=THERE, now_s=0.1)
    assert wire.beats(now_s=0.2)
