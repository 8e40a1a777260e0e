"""A vehicle whose signing clock is behind: it is answered, its clock moves forward, and it is heard."""

import select
import socket
import time

import pytest

from bridge.mavlink.client.link import VehicleLink
from bridge.mavlink.endpoint import dialect
from bridge.mavlink.signing.signing import ANSWER_S, ANSWERED, Refusal, Signer, StaleAnswers
from tests.unit.mavlink.client.vehicle_link_fakes import HEIGHT, heartbeat
from tests.unit.mavlink.signing.signing_helpers import KEY, S, forged, signed, theirs

TWO_HOURS = 2 * 3600 * S


class Vehicle:
    """A vehicle that calls the companion, signed by pymavlink: a frame it accepts moves its clock on."""

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
    opened = VehicleLink("udpin:127.0.0.1:0", takeoff_height_m=HEIGHT, signing_key=KEY)
    yield opened
    opened.close()


def turn(link):
    link.endpoint.wait(0.2)
    link.poll(0.0)


def now():
    return Signer(KEY, 1, 1).now()


def joined(link, stamp):
    """A vehicle with its clock at ``stamp``; it has said its first word."""
    vehicle = Vehicle(link.endpoint.local_port, stamp)
    link.poll(0.0)
    vehicle.send()
    turn(link)
    return vehicle


def test_vehicle_with_its_clock_behind_is_heard_after_one_answer(link):
    vehicle = joined(link, now() - TWO_HOURS)
    assert not link.heard
    assert link.endpoint.counters.stale == 1
    vehicle.take(5.0)
    (answer,) = vehicle.answers
    assert (answer.get_type(), answer.get_srcComponent()) == ("HEARTBEAT", 191)
    vehicle.send()
    turn(link)
    assert link.heard
    vehicle.socket.close()


def test_vehicle_whose_clock_went_back_is_heard_again(link):
    """It was switched off and on: its stream is known, and its frames are older than the last one."""
    first = joined(link, now())
    assert link.heard
    first.socket.close()
    second = joined(link, now() - TWO_HOURS)
    assert link.endpoint.counters.replayed == 1
    second.take(5.0)
    assert len(second.answers) == 1
    second.send()
    turn(link)
    assert link.endpoint.counters.received == 2
    second.socket.close()


def test_many_stale_frames_get_one_answer_a_second(link):
    vehicle = joined(link, now() - TWO_HOURS)
    began_s = time.monotonic()
    for _ in range(50):
        vehicle.send(signed((1, 1), stamp=now() - TWO_HOURS))
        turn(link)
    took_s = time.monotonic() - began_s
    assert link.endpoint.counters.stale == 51
    assert 1 <= link.endpoint.counters.stale_answered <= 1 + took_s / ANSWER_S
    vehicle.socket.close()


def test_who_has_not_the_key_gets_no_answer(link):
    vehicle = Vehicle(link.endpoint.local_port, now())
    link.poll(0.0)
    plain = dialect.MAVLink(None, 1, 1)
    vehicle.send(forged(stamp=now() - TWO_HOURS), heartbeat().pack(plain), signed((1, 191), stamp=now()))
    while link.endpoint.counters.reflected == 0:
        turn(link)
    vehicle.take(0.1)
    assert vehicle.answers == []
    assert link.endpoint.counters.stale_answered == 0
    vehicle.socket.close()


def test_answered_are_frames_with_the_right_signature_and_the_wrong_time():
    assert {Refusal.STALE, Refusal.REPLAYED} == ANSWERED


def test_few_addresses_are_answered_at_a_time_and_nobody_before_there_is_a_heartbeat():
    clock = [0.0]
    answers = StaleAnswers(lambda: clock[0])
    assert answers.due(("a", 1)) is None
    beat = heartbeat()
    answers.note([dialect.MAVLink_timesync_message(0, 1), beat])
    assert [answers.due((name, 1)) for name in "abcdef"] == [beat] * 4 + [None] * 2
    clock[0] = 0.9
    assert answers.due(("a", 1)) is None
    clock[0] = 1.0
    assert [answers.due((name, 1)) for name in "efa"] == [beat] * 3
