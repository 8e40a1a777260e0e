"""Set-points on their way: order, delay, and what happens when there are too many."""

from sim.compiled.records import new
from sim.firmware.setpoint import ROOM, STOP, Inbox, InboxRecord, Setpoint, SetpointRecord, receive


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


def test_of_several_that_arrive_at_once_the_newest_counts():
    radio = Radio()
    for k in range(1, 4):
        radio.inbox.send(Setpoint(float(k)), 10 * k)
    assert radio.at(25) == (2.0, 20)
    assert radio.at(25) == (2.0, 20)
    assert radio.at(100) == (3.0, 30)


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
