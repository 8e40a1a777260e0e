"""What is on its way to the vehicle: set-points in their ring, motion capture drawn ahead."""

import math

import pytest

from flightstack.compiled.records import new
from sim.firmware.setpoint import ROOM, STOP, Inbox, InboxRecord, Setpoint, SetpointRecord, receive
from sim.plant.sensors import NS_PER_MS, MeasurementChannel
from sim.scenarios.scenario import OdometryLink
from sim.vehicle.mocap import MocapRecord, MocapTape
from sim.world.bodies import BodyRecord


class Radio:
    """Both ends."""

    def __init__(self):
        self.record, self.present = new(InboxRecord), new(SetpointRecord)
        self.inbox = Inbox(self.record, self.present)
        self.inbox.set(STOP, 0)

    def at(self, now_ms):
        """Speed of the set-point that holds at this time, and since when."""
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
    """Some motion; zeros of both signs at the beginning."""
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
