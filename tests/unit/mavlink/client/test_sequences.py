"""Tests the commands for each request, the requested streams, the origin, and status texts."""

import math
from itertools import pairwise

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.companion import Origin, OriginSender, StreamRequests
from bridge.mavlink.client.texts import TextAssembler
from bridge.mavlink.profiles import ARDUPILOT, CRAZYFLIE, PROFILES, PX4
from flightstack.core.types import Landed, Mode, Request
from tests.unit.mavlink.client.vehicle_link_fakes import HEIGHT, commands, params, sequencer, status

MODE, ARM, RISE, LAND, ASK = 176, 400, 22, 21, 512  # numbers of MAV_CMD
NONE, TAKEOFF, EXTERNAL, DOWN, KILL = (
    Request.NONE, Request.TAKEOFF, Request.EXTERNAL, Request.LAND, Request.MOTORS_OFF
)  # fmt: skip
READY, ARMED, FLIES = {}, {"armed": True}, {"armed": True, "landed": Landed.IN_AIR}
OURS, LANDS, OTHER, RISES = ({"mode": m} for m in (Mode.EXTERNAL, Mode.LAND, Mode.OTHER, Mode.TAKEOFF))
STREAM = "set-points at 100 Hz until then"
# profile, request, rows: time in s, vehicle status (None: no heartbeat), numbers of the commands sent then
STORIES = {
    "nothing for no request": (PX4, NONE, [(0.0, READY, [])]),
    "nothing to a vehicle that is not heard": (PX4, TAKEOFF, [(1.0, None, [])]),
    "no landing of a vehicle that is not heard": (PX4, DOWN, [(1.0, None, [])]),
    "no landing of a disarmed vehicle": (PX4, DOWN, [(0.0, READY, [])]),
    "PX4 takes off in OFFBOARD, where its fail-safe holds": (PX4, TAKEOFF, [
        (0.0, READY, []), (1.0, STREAM, None), (1.0, READY, [MODE]), (1.1, OURS, [ARM]),
        (1.2, OURS | ARMED, []),
    ]),
    "a vehicle in the air is never told to take off": (PX4, TAKEOFF, [(0.5, FLIES | OTHER, [])]),
    "before a second flight PX4 leaves OFFBOARD": (PX4, NONE, [
        (0.0, READY, []), (1.0, OURS, [MODE]), (1.5, OURS, []), (2.0, OURS, [MODE]),
    ]),
    "or the mode in which it has landed": (PX4, NONE, [(0.0, LANDS, [MODE])]),
    "but not while it is armed": (PX4, NONE, [(0.0, OURS | ARMED, [])]),
    "nor in the air": (PX4, NONE, [(0.0, OURS | {"landed": Landed.IN_AIR}, [])]),
    "a Crazyflie is armed, then takes off, then nothing is sent": (CRAZYFLIE, TAKEOFF, [
        (0.0, READY, [ARM]), (0.1, ARMED, [RISE]), (0.2, ARMED | RISES, []), (9.0, FLIES, []),
    ]),
    "ArduPilot switches to GUIDED before it is armed": (ARDUPILOT, TAKEOFF, [
        (0.0, READY, [MODE]), (0.1, OURS, [ARM]), (0.2, OURS | ARMED, [ASK]),
    ]),
    "ArduPilot is prepared on the ground until it shows GUIDED": (ARDUPILOT, NONE, [
        (0.0, OTHER, [MODE]), (0.5, OTHER, []), (1.0, OTHER, [MODE]), (2.0, OTHER, [MODE]), (3.5, RISES, []),
        (4.5, OTHER, [MODE]),  # GUIDED is lost again, as after a restart of the autopilot
    ]),
    "it is not prepared while it is armed": (ARDUPILOT, NONE, [(0.0, OTHER | ARMED, [])]),
    "OFFBOARD waits for the stream": (PX4, EXTERNAL, [
        (0.1, READY, []), (0.4, STREAM, None), (0.4, READY, [MODE]),
    ]),
    "a mode changed by somebody else is not fought": (PX4, EXTERNAL, [
        (0.2, OURS | ARMED, []), (0.5, STREAM, None), (0.5, OURS | ARMED, []), (1.0, STREAM, None),
        (1.0, OTHER | ARMED, []),
    ]),
    "motors off need no heartbeat": (PX4, KILL, [(0.0, None, [ARM]), (0.2, READY, [])]),
    "motors off need nothing on a disarmed vehicle": (PX4, KILL, [(0.0, READY, [])]),
}  # fmt: skip
ENDS = {"PX4 takes off in OFFBOARD, where its fail-safe holds", "motors off need no heartbeat"}


@pytest.mark.parametrize("name", STORIES)
def test_what_is_sent_in_each_story(name):
    profile, request, rows = STORIES[name]
    s, set_point_s = sequencer(profile), 0.0
    for now_s, shown, expected in rows:
        if shown is STREAM:
            while set_point_s <= now_s:
                s.note_setpoint(set_point_s)
                set_point_s += 0.01
            continue
        seen = None if shown is None else status(now_s, **shown)
        assert commands(s.step(request, seen, now_s)) == expected, now_s
    assert s.reached or name not in ENDS


def sent(s, request, ticks, *, note=lambda tick: None, period_s=0.01, **shown):
    """Return (time in s, message) of all messages sent in ``ticks`` ticks at a constant vehicle status."""
    found = []
    for tick in range(ticks):
        now_s = tick * period_s
        found += [(now_s, message) for message in s.step(request, status(now_s, **shown), now_s)]
        note(tick)
    return found


@pytest.mark.parametrize(
    ("profile", "request_", "shown", "expected"),
    [
        (PX4, KILL, None, [0.0, 21196.0]),
        (PX4, NONE, OURS, [1.0, 4.0, 3.0]),
        (CRAZYFLIE, TAKEOFF, READY, [1.0, 0.0]),
        (CRAZYFLIE, TAKEOFF, ARMED, [math.nan] * 6 + [488.0 + HEIGHT]),  # height above sea level, m
        (ARDUPILOT, TAKEOFF, READY, [1.0, 4.0]),
    ],
)
def test_parameters_of_the_commands(profile, request_, shown, expected):
    s = sequencer(profile)
    s.home_amsl_m = 488.0
    (message,) = s.step(request_, None if shown is None else status(0.0, **shown), 0.0)
    assert (message.target_system, message.target_component) == (1, 1)
    assert params(message)[: len(expected)] == pytest.approx(expected, nan_ok=True)
    assert any(map(math.isnan, params(message))) == (profile is not ARDUPILOT)  # ArduPilot rejects NaN


@pytest.mark.parametrize("stands_m", [0.0, 0.4, -2.5, 31.0])
def test_ardupilot_climbs_from_where_it_stands_wherever_home_is(stands_m):
    """The commanded altitude is the vehicle's height above home plus the take-off height."""
    s = sequencer(ARDUPILOT)
    s.above_home = (-1.0, 99.0)  # this height was measured before the arming
    assert commands(s.step(TAKEOFF, status(0.0, **OURS), 0.0)) == [ARM]
    (asked,) = s.step(TAKEOFF, status(0.5, **ARMED, **OURS), 0.5)
    assert (asked.command, asked.param1) == (ASK, 33.0)
    assert s.step(TAKEOFF, status(0.5, **ARMED, **OURS), 1.0) == []
    s.above_home = (1.5, stands_m)
    (takeoff,) = s.step(TAKEOFF, status(1.5, **ARMED, **OURS), 1.51)
    assert (takeoff.command, takeoff.param7) == (RISE, pytest.approx(stands_m + HEIGHT))
    s.above_home = (5.0, stands_m + 0.7)  # the vehicle climbs, but its heartbeat does not show this yet
    (again,) = s.step(TAKEOFF, status(5.5, **ARMED, **OURS), 5.6)
    assert again.param7 == takeoff.param7


@pytest.mark.parametrize(
    ("profile", "shown", "asked", "said"),
    [
        (ARDUPILOT, ARMED | OURS, 33.0, "GLOBAL_POSITION_INT in 30 tries"),
        (CRAZYFLIE, READY, 242.0, "HOME_POSITION"),
    ],
)
def test_without_the_height_that_it_counts_from_nothing_takes_off(profile, shown, asked, said):
    s = sequencer(profile)
    s.home_amsl_m = None
    found = sent(s, TAKEOFF, 3100, **shown)
    assert {(m.command, m.param1) for _, m in found} == {(ASK, asked)}
    assert len(found) == 30
    assert said in s.failed


def test_commands_are_repeated_every_half_second_and_give_up_with_all_that_was_said():
    s = sequencer()

    def note(tick):
        if tick == 3:
            s.note_ack(LAND, 0)  # ACCEPTED, but the heartbeat never shows the mode
        if tick == 5:
            s.note_ack(LAND, 1)
            s.note_ack(ARM, 4)  # a reply to another command
            s.note_text("Landing denied: no position")

    found = sent(s, DOWN, 1000, note=note, armed=True)
    assert [m.confirmation for _, m in found] == list(range(10))
    assert [b - a for (a, _), (b, _) in pairwise(found)] == pytest.approx([0.5] * 9)
    assert all(word in s.failed for word in ("10 tries in 5.0 s", "TEMPORARILY_REJECTED", "no position"))
    assert commands(s.step(KILL, status(20.0, armed=True), 20.0)) == [ARM]
    assert s.failed is None  # a new request clears the failure


@pytest.mark.parametrize("autopilot", PROFILES.values(), ids=PROFILES)
def test_a_final_refusal_is_believed_when_it_is_said_twice(autopilot):
    s = sequencer(autopilot)
    for now_s, expected in ((0.0, [LAND]), (0.6, [LAND]), (1.2, [])):
        assert commands(s.step(DOWN, status(now_s, armed=True), now_s)) == expected
        s.note_ack(LAND, dialect.MAV_RESULT_UNSUPPORTED)
    assert "UNSUPPORTED" in s.failed


def test_motors_off_is_sent_on_whatever_is_answered():
    s = sequencer()
    note = lambda tick: s.note_ack(ARM, dialect.MAV_RESULT_DENIED)  # noqa: E731
    assert len(sent(s, KILL, 20, note=note, period_s=0.5, armed=True)) == 20
    assert s.failed is None


def test_an_old_heartbeat_does_not_prove_a_new_request():
    s = sequencer()
    assert s.step(DOWN, status(0.0, armed=True, mode=Mode.LAND), 0.5) == []
    assert not s.reached
    assert commands(s.step(DOWN, status(0.6, armed=True, mode=Mode.EXTERNAL), 0.6)) == [LAND]


@pytest.mark.parametrize(
    ("wanted", "seen", "expected"),
    [
        ({32: 50.0}, lambda tick: tick % 2 == 0 and tick < 1000, [0.0, 11.0, 12.0, 13.0, 14.0, 17.0]),
        ({32: 50.0}, lambda tick: False, [*range(5), 7.0, 10.0, 13.0, 16.0, 19.0]),
        ({32: 50.0}, lambda tick: tick % 2 == 0, [0.0]),
        ({32: 50.0}, lambda tick: tick % 8 == 0, [0.0, 1.0, 2.0, 3.0, 4.0]),
    ],
    ids=["stops", "never comes", "comes", "comes too slowly"],
)
def test_a_stream_is_asked_for_while_it_does_not_come(wanted, seen, expected):
    streams, asked_s = StreamRequests(wanted, (1, 1), 0.0), []
    for tick in range(2000):
        for message in streams.step(tick * 0.01):
            assert (message.command, message.param1, message.param2) == (511, 32.0, 20_000.0)
            asked_s.append(tick * 0.01)
        if seen(tick):
            streams.seen(32)
    assert asked_s == pytest.approx(expected)


def test_the_origin_is_told_once_a_second_on_the_ground_until_it_is_known():
    sender = OriginSender(Origin(47.0, 8.5, 400.0), 1)
    assert sender.step(False, 0.0) == []
    (message,) = sender.step(True, 0.0)
    assert (message.latitude, message.longitude, message.altitude) == (470_000_000, 85_000_000, 400_000)
    for wanted, now_s, count in ((True, 0.5, 0), (True, 1.0, 1), (False, 2.0, 0)):
        assert len(sender.step(wanted, now_s)) == count
    assert sum(len(sender.step(True, 3.0 + tick)) for tick in range(200)) == 58
    assert OriginSender(None, 1).step(True, 0.0) == []


def test_long_texts_are_put_together():
    texts, text = TextAssembler(), "Preflight Fail: " + "x" * 60 + "\t"
    chunks = [
        dialect.MAVLink_statustext_message(3, text[i : i + 50].encode(), 7, n) for n, i in enumerate((0, 50))
    ]
    assert [texts.add(chunk) for chunk in chunks] == [[], [(3, text.strip())]]
    assert texts.add(dialect.MAVLink_statustext_message(6, b"short\x1b[2J", 0, 0)) == [(6, "short [2J")]
    assert texts.add(dialect.MAVLink_statustext_message(3, b"a" * 50, 7, 0)) == []  # the text is incomplete
    assert texts.add(dialect.MAVLink_statustext_message(6, b"next", 0, 0))[0] == (3, "a" * 50 + " ...")


def test_an_interrupted_stream_counts_from_its_new_start():
    s = sequencer()
    s.note_setpoint(0.0)
    s.note_setpoint(1.0)
    assert s.step(EXTERNAL, status(1.0), 1.0) == []
