"""Tests signing endpoints on real sockets: accepted frames, counters, log, and replies."""

import select
import socket

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.framing import split_frames
from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.signing import AHEAD_TICKS, STALE_TICKS, Signer
from bridge.mavlink.transport.transport import dropped
from tests.unit.mavlink.client.vehicle_link_fakes import linked
from tests.unit.mavlink.codec.frames_of_messages import Caller
from tests.unit.mavlink.signing.signing_helpers import COMPANION, KEY, S, forged, heartbeat, signed, theirs


class Wire(Caller):
    """An endpoint with a signing key, and a socket that sends frames to it."""

    def __init__(self, key=KEY):
        self.endpoint = Endpoint("udpin:127.0.0.1:0", 1, 1, signing_key=key)
        super().__init__(self.endpoint)

    def close(self):
        self.endpoint.close()
        self.socket.close()


@pytest.fixture
def wire():
    made = Wire()
    yield made
    made.close()


def now():
    return Signer(KEY, 1, 1).now()


def test_only_signed_frames_pass_and_each_refusal_has_its_count(wire):
    plain = dialect.MAVLink(None, *COMPANION)
    peer = theirs(stamp=now())
    good = heartbeat().pack(peer)
    later = heartbeat().pack(peer)
    body = b"\x01\x00\x00\x01\x01\xff\xff\xff\x00"
    received = wire.put(
        heartbeat().pack(plain),
        heartbeat().pack(plain, force_mavlink1=True),
        forged(),
        b"\xfd" + body + b"\x12\x34",
        good,
        good,
        signed((1, 200), stamp=now() - STALE_TICKS - S),
        signed((1, 200), stamp=now() + AHEAD_TICKS + S),
        signed((1, 1), stamp=now()),
        later,
    )
    assert [r.message.get_srcComponent() for r in received] == [191, 191]
    counters = wire.endpoint.counters
    names = (
        "unsigned",
        "version_1",
        "bad_signature",
        "unknown_id",
        "replayed",
        "stale",
        "ahead",
        "reflected",
    )
    assert {name: counters[name] for name in names} == dict.fromkeys(names, 1)
    assert all(f"{name} 1" in dropped(counters) for name in names)
    assert wire.endpoint.peers == (wire.address,)


def test_strangers_become_no_peers(wire):
    plain = dialect.MAVLink(None, *COMPANION)
    for frame in (heartbeat().pack(plain), forged(stamp=now())):
        assert wire.put(frame) == []
    wire.endpoint.send([heartbeat()])
    assert wire.endpoint.peers == ()
    assert wire.endpoint.counters["sent"] == 0


def test_logs_see_valid_unsigned_frames_both_ways_equal_to_those_without_a_key(wire):
    seen = []
    wire.endpoint.tap = lambda direction, frame, peer: seen.append(frame)
    wire.put(signed(stamp=now()))
    wire.endpoint.send([heartbeat(), heartbeat()])
    sent, _ = wire.socket.recvfrom(2048)
    frames = split_frames(sent)
    assert [f[2] for f in frames] == [1, 1]
    expected = [heartbeat().pack(dialect.MAVLink(None, *COMPANION))]
    mav = dialect.MAVLink(None, 1, 1)
    for number in range(2):
        mav.seq = number
        expected.append(heartbeat().pack(mav))
    assert seen == expected
    for frame in seen:
        assert dialect.MAVLink(None).decode(bytearray(frame)).get_type() == "HEARTBEAT"


@pytest.mark.parametrize("key", [KEY, None])
def test_keys_from_the_network_are_never_taken_nor_logged(key):
    wire = Wire(key)
    seen = []
    wire.endpoint.tap = lambda direction, frame, peer: seen.append(frame)
    mav = theirs(stamp=now()) if key else dialect.MAVLink(None, *COMPANION)
    setup = dialect.MAVLink_setup_signing_message(1, 1, list(range(100, 132)), 2**47)
    assert wire.put(setup.pack(mav)) == []
    assert wire.endpoint.counters["setup_signing"] == 1
    assert seen == []
    other = theirs(secret=bytes(range(100, 132)), stamp=now())
    accepted = wire.put(heartbeat().pack(other), heartbeat().pack(mav))
    assert len(accepted) == (1 if key else 2)  # without a key all frames are accepted, signed or not
    assert wire.endpoint.counters["bad_signature"] == (1 if key else 0)
    wire.endpoint.send([heartbeat()])
    assert (wire.socket.recv(2048)[2] == 1) is (key is not None)
    wire.close()


TWO_HOURS = 2 * 3600 * S


class Vehicle:
    """A vehicle that signs with pymavlink; an accepted frame advances the vehicle's signing clock."""

    def __init__(self, port, stamp):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.mav = theirs((1, 1), stamp=stamp)
        self.answers = []

    def send(self, *frames):
        for frame in frames or (heartbeat().pack(self.mav),):
            self.socket.send(frame)

    def take(self, timeout_s=0.0):
        while select.select((self.socket,), (), (), timeout_s)[0]:
            data, timeout_s = self.socket.recv(4096), 0.0
            self.answers += self.mav.parse_buffer(data)


@pytest.fixture
def link():
    opened = linked(signing_key=KEY)
    yield opened
    opened.close()


def turn(link):
    link.endpoint.wait(0.2)
    link.poll(0.0)


def joined(link, stamp):
    """Return a vehicle whose clock is at ``stamp``, and which has sent its first message."""
    vehicle = Vehicle(link.endpoint.local_port, stamp)
    link.poll(0.0)
    vehicle.send()
    turn(link)
    return vehicle


def test_vehicle_with_its_clock_behind_is_heard_after_one_answer(link):
    vehicle = joined(link, now() - TWO_HOURS)
    assert not link.heard
    vehicle.send()
    turn(link)
    assert (link.endpoint.counters["stale"], link.endpoint.counters["stale_answered"]) == (2, 1)
    vehicle.take(5.0)
    (answer,) = vehicle.answers
    assert (answer.get_type(), answer.get_srcComponent()) == ("HEARTBEAT", 191)
    vehicle.send()
    turn(link)
    assert link.heard
    vehicle.socket.close()


def test_a_repeat_is_no_replay_and_a_damaged_one_stays_damaged():
    vehicle = Endpoint("udpin:127.0.0.1:0", 1, 1, signing_key=KEY)
    companion = Endpoint(f"udpout:127.0.0.1:{vehicle.local_port}", 1, 191, signing_key=KEY)
    hello = heartbeat()
    companion.send([hello])
    companion.repeat(bytes(hello.get_msgbuf()))
    frames = []
    while len(frames) < 2:
        assert vehicle.wait(5.0)
        frames += [bytes(r.message.get_msgbuf()) for r in vehicle.receive()]
    assert frames[0] == frames[1]
    damaged = bytearray(hello.get_msgbuf())
    damaged[12] ^= 0xFF
    companion.repeat(bytes(damaged))
    assert vehicle.wait(5.0)
    assert vehicle.receive() == []
    assert vehicle.counters["bad_crc"] == 1
    vehicle.close()
    companion.close()
