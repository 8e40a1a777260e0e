"""Profiles of the autopilots, and the page about them."""

from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.companion import Origin, OriginSender
from bridge.mavlink.client.streams import StreamRequests
from bridge.mavlink.client.vehicle_state import VehicleState
from bridge.mavlink.profiles import (
    ARDUPILOT,
    AUTO,
    CHOICES,
    PROFILES,
    PX4,
    refusal,
)
from bridge.target.ros2_target import TargetType
from flightstack.compiled.core import Core
from flightstack.config.options import AUTOPILOTS, CORES, TARGET_TYPES
from flightstack.core.types import Landed, Mode, Request
from tests.unit.mavlink.client.autopilots_page import PAGE, split, tables
from tests.unit.mavlink.client.vehicle_link_fakes import (
    HEIGHT,
    commands,
    heartbeat,
    sequencer,
    status,
)

GUIDED, LOITER, STABILIZE = 4, 5, 0


def test_every_profile_is_whole():
    for name, each in PROFILES.items():
        assert each.name == name
        assert set(each.sequences) == set(Request)
        assert set(each.answers) <= set(dialect.enums["MAV_RESULT"])
        assert Mode.EXTERNAL in each.modes.values()
        assert Mode.LAND in each.modes.values()
        assert not any(
            step.blind for r in Request if r is not Request.MOTORS_OFF for step in each.sequences[r]
        )
    assert (AUTO, *PROFILES) == CHOICES


def test_the_command_knows_cores_and_autopilots():
    assert AUTOPILOTS == CHOICES
    assert tuple(each.value for each in Core) == CORES
    assert tuple(each.value for each in TargetType) == TARGET_TYPES


@pytest.mark.parametrize(
    ("autopilot", "type_", "chosen", "words"),
    [
        (0, 2, None, ["unsupported", "GENERIC (0)", "PX4", "ArduCopter"]),
        (99, 2, None, ["99"]),
        (12, 1, None, ["FIXED_WING (1)", "QUADROTOR (2)"]),
        (3, 10, ARDUPILOT, ["GROUND_ROVER (10)"]),
        (3, 2, PX4, ["autopilot 3", "'px4'", "auto"]),
    ],
)
def test_who_is_not_known_is_refused_with_what_is(autopilot, type_, chosen, words):
    text = refusal(autopilot, type_, chosen)
    assert text is not None
    for word in words:
        assert word in text


@pytest.mark.parametrize("type_", [2, 13, 14, 15])
def test_multirotors_of_both_are_flown(type_):
    assert refusal(12, type_, None) is None
    assert refusal(3, type_, ARDUPILOT) is None


def test_arming_that_is_worked_on_is_left_alone_for_three_seconds():
    s = sequencer(ARDUPILOT)
    guided = status(0.0, mode=Mode.TAKEOFF)
    sent = []
    for tick in range(400):
        now = tick * 0.01
        sent += [now for _ in s.step(Request.TAKEOFF, guided, now)]
        if tick == 10:
            s.note_ack(400, dialect.MAV_RESULT_IN_PROGRESS)
    assert sent == pytest.approx([0.0, 3.0, 3.5])


@pytest.mark.parametrize("autopilot", PROFILES.values(), ids=PROFILES)
def test_a_final_refusal_is_believed_when_it_is_said_twice(autopilot):
    s = sequencer(autopilot)
    s.step(Request.LAND, status(0.0, armed=True), 0.0)
    s.note_ack(21, dialect.MAV_RESULT_UNSUPPORTED)
    assert len(s.step(Request.LAND, status(0.6, armed=True), 0.6)) == 1
    s.note_ack(21, dialect.MAV_RESULT_UNSUPPORTED)
    assert s.step(Request.LAND, status(1.2, armed=True), 1.2) == []
    assert "UNSUPPORTED" in s.failed


def test_motors_off_is_sent_on_whatever_is_answered():
    s = sequencer()
    sent = 0
    for tick in range(20):
        sent += len(s.step(Request.MOTORS_OFF, status(tick * 0.5, armed=True), tick * 0.5))
        s.note_ack(400, dialect.MAV_RESULT_DENIED)
    assert sent == 20
    assert s.failed is None


def test_ardupilot_is_prepared_on_the_ground_until_it_shows_guided():
    s = sequencer(ARDUPILOT)
    sent = []
    for tick in range(350):
        now = tick * 0.01
        sent += [(now, m) for m in s.step(Request.NONE, status(now, mode=Mode.OTHER), now)]
    assert [now for now, _ in sent] == pytest.approx([0.0, 1.0, 2.0, 3.0])
    assert {(m.command, m.param1, m.param2) for _, m in sent} == {(176, 1.0, 4.0)}
    assert s.step(Request.NONE, status(3.5, mode=Mode.TAKEOFF), 3.5) == []
    assert len(s.step(Request.NONE, status(4.5, mode=Mode.OTHER), 4.5)) == 1  # lost again, as after a reboot


def test_a_vehicle_that_is_armed_or_that_was_flown_is_not_prepared():
    s = sequencer(ARDUPILOT)
    assert s.step(Request.NONE, status(0.0, armed=True, mode=Mode.OTHER), 0.0) == []
    s.step(Request.LAND, status(1.0, armed=True), 1.0)
    assert s.step(Request.NONE, status(2.0, mode=Mode.OTHER), 2.0) == []
    assert sequencer(PX4).step(Request.NONE, status(0.0, mode=Mode.OTHER), 0.0) == []


def test_guided_is_a_take_off_until_it_follows_us():
    state = VehicleState(ARDUPILOT)
    state.update(heartbeat(GUIDED, armed=True, autopilot=3), 1.0)
    assert state.status.mode is Mode.TAKEOFF
    state.follow(True)
    assert state.status.mode is Mode.EXTERNAL
    assert state.status.arrival_s == 1.0  # the heartbeat is not newer
    state.update(heartbeat(LOITER, armed=True, autopilot=3), 2.0)
    assert state.status.mode is Mode.HOLD
    state.update(heartbeat(GUIDED, armed=False, autopilot=3), 3.0)
    assert state.status.mode is Mode.TAKEOFF  # disarmed: a new flight starts
    state.update(heartbeat(STABILIZE, autopilot=3), 4.0)
    assert state.status.mode is Mode.OTHER


def test_ardupilots_take_off_is_over_for_the_sequencer_only_in_the_air():
    s = sequencer(ARDUPILOT)
    s.above_home = (0.01, 0.0)
    armed = status(0.0, armed=True, mode=Mode.TAKEOFF)
    (takeoff,) = s.step(Request.TAKEOFF, armed, 0.0)
    assert (takeoff.command, takeoff.param7) == (22, pytest.approx(HEIGHT))
    assert s.step(Request.TAKEOFF, armed, 3.9) == []
    assert commands(s.step(Request.TAKEOFF, armed, 4.1)) == [22]
    assert s.step(Request.TAKEOFF, replace(armed, arrival_s=4.5, landed=Landed.TAKEOFF), 4.5) == []
    assert s.reached


def asked_s(streams, from_s, until_s):
    """Return the times of requests."""
    ticks = range(round(from_s * 100), round(until_s * 100))
    return [tick * 0.01 for tick in ticks for _ in streams.step(tick * 0.01)]


def test_what_never_comes_is_asked_for_every_three_seconds_in_both_ways():
    streams = StreamRequests({32: 50.0}, 1, 1, 0.0, {32: 6})
    assert asked_s(streams, 0.0, 9.5) == pytest.approx([float(s) for s in range(10)])
    assert asked_s(streams, 9.5, 60.0) == pytest.approx([12.0 + 3.0 * n for n in range(16)])
    later = [m.get_type() for tick in range(6000, 12000) for m in streams.step(tick * 0.01)]
    assert set(later) == {"COMMAND_LONG", "REQUEST_DATA_STREAM"}
    assert len(later) == 20


def test_the_origin_is_told_once_a_second_on_the_ground_until_it_is_known():
    sender = OriginSender(Origin(47.0, 8.5, 400.0), 1)
    assert sender.step(None, False, 0.0) == []
    (message,) = sender.step(status(), False, 0.0)
    assert (message.latitude, message.longitude, message.altitude) == (470_000_000, 85_000_000, 400_000)
    assert sender.step(status(), False, 0.5) == []
    assert len(sender.step(status(), False, 1.0)) == 1
    assert sender.step(status(), True, 2.0) == []
    assert sender.step(status(armed=True), False, 2.0) == []
    assert sum(len(sender.step(status(), False, 3.0 + tick)) for tick in range(200)) == 58
    assert OriginSender(None, 1).step(status(), False, 0.0) == []


TEXT = PAGE.read_text()


@pytest.mark.parametrize("name", tables())
def test_the_tables_are_the_codes(name):
    _, within, _ = split(TEXT, name)
    assert within == tables()[name], "run: python -m tests.unit.mavlink.client.autopilots_page"
