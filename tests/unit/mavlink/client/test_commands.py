"""Requests as commands, requested streams, assembled texts: pure parts of the vehicle link."""

import math
from itertools import pairwise

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.commands import CommandSequencer
from bridge.mavlink.client.streams import StreamRequests
from bridge.mavlink.client.texts import TextAssembler
from bridge.mavlink.profiles import ARDUPILOT, CRAZYFLIE, PX4
from flightstack.core.types import Landed, Mode, Request
from tests.unit.mavlink.client.vehicle_link_fakes import HEIGHT, commands, params, sequencer, status


def test_nothing_is_sent_for_none_or_to_an_unknown_vehicle():
    s = sequencer()
    assert s.step(Request.NONE, status(), 0.0) == []
    for request in (Request.TAKEOFF, Request.EXTERNAL, Request.LAND):
        assert s.step(request, None, 1.0) == []


def test_px4_takes_off_in_offboard_where_its_fail_safe_holds():
    s = sequencer()
    assert s.step(Request.TAKEOFF, status(0.0), 0.0) == []  # not before set-points stream
    for tick in range(100):
        s.note_setpoint(tick * 0.01)
    assert commands(s.step(Request.TAKEOFF, status(1.0), 1.0)) == [176]
    assert commands(s.step(Request.TAKEOFF, status(1.1, mode=Mode.EXTERNAL), 1.1)) == [400]
    assert s.step(Request.TAKEOFF, status(1.2, mode=Mode.EXTERNAL, armed=True), 1.2) == []
    assert s.reached


def test_before_a_second_flight_px4_leaves_offboard():
    s = sequencer()
    assert s.step(Request.NONE, status(0.0), 0.0) == []
    for mode in (Mode.EXTERNAL, Mode.LAND):
        (hold,) = sequencer().step(Request.NONE, status(0.0, mode=mode), 0.0)
        assert hold.command == 176
        assert params(hold)[:3] == [1.0, 4.0, 3.0]
        for flying in ({"armed": True}, {"landed": Landed.IN_AIR}):
            assert sequencer().step(Request.NONE, status(0.0, mode=mode, **flying), 0.0) == []
    (hold,) = s.step(Request.NONE, status(1.0, mode=Mode.EXTERNAL), 1.0)
    assert s.step(Request.NONE, status(1.5, mode=Mode.EXTERNAL), 1.5) == []
    assert commands(s.step(Request.NONE, status(2.0, mode=Mode.EXTERNAL), 2.0)) == [176]


def test_takeoff_arms_then_takes_off_then_is_quiet():
    s = sequencer(CRAZYFLIE)
    s.home_amsl_m = 488.0  # PX4's command heights are above sea level
    (arm,) = s.step(Request.TAKEOFF, status(0.0), 0.0)
    assert arm.command == 400
    assert params(arm)[:2] == [1.0, 0.0]
    assert (arm.target_system, arm.target_component) == (1, 1)
    (takeoff,) = s.step(Request.TAKEOFF, status(0.1, armed=True), 0.1)
    assert takeoff.command == 22
    assert params(takeoff)[6] == pytest.approx(488.0 + HEIGHT)
    assert all(math.isnan(p) for p in params(takeoff)[:6])
    assert s.step(Request.TAKEOFF, status(0.2, armed=True, mode=Mode.TAKEOFF), 0.2) == []
    assert s.reached
    # It has climbed and holds: the request remains, and no command is sent.
    assert s.step(Request.TAKEOFF, status(9.0, armed=True, landed=Landed.IN_AIR), 9.0) == []


@pytest.mark.parametrize("stands_m", [0.0, 0.4, -2.5, 31.0])
def test_ardupilot_climbs_from_where_it_stands_wherever_home_is(stands_m):
    """Arming moves the home to the vehicle, unless a client has locked the home."""
    s, guided = sequencer(ARDUPILOT), {"mode": Mode.EXTERNAL}
    s.above_home = (-1.0, 99.0)  # before arming
    assert commands(s.step(Request.TAKEOFF, status(0.0, **guided), 0.0)) == [400]
    (asked,) = s.step(Request.TAKEOFF, status(0.5, armed=True, **guided), 0.5)
    assert (asked.command, asked.param1) == (512, 33.0)
    assert s.step(Request.TAKEOFF, status(0.5, armed=True, **guided), 1.0) == []
    s.above_home = (1.5, stands_m)
    (takeoff,) = s.step(Request.TAKEOFF, status(1.5, armed=True, **guided), 1.51)
    assert (takeoff.command, takeoff.param7) == (22, pytest.approx(stands_m + HEIGHT))
    s.above_home = (5.0, stands_m + 0.7)  # it climbs, but its heartbeat does not show it yet
    (again,) = s.step(Request.TAKEOFF, status(5.5, armed=True, **guided), 5.6)
    assert again.param7 == takeoff.param7


def test_without_a_height_above_home_ardupilot_is_not_told_to_take_off():
    s = sequencer(ARDUPILOT)
    ready = {"armed": True, "mode": Mode.EXTERNAL}
    asked = [m for t in range(310) for m in s.step(Request.TAKEOFF, status(t * 0.1, **ready), t * 0.1)]
    assert {(m.command, m.param1) for m in asked} == {(512, 33.0)}
    assert s.failed == "the vehicle did not send GLOBAL_POSITION_INT in 30 tries"


def test_home_is_asked_for_before_arming_where_heights_count_from_the_sea():
    s = sequencer(CRAZYFLIE)
    s.home_amsl_m = None
    asked = [m for tick in range(3100) for m in s.step(Request.TAKEOFF, status(tick * 0.01), tick * 0.01)]
    assert {(m.command, m.param1) for m in asked} == {(512, 242.0)}
    assert len(asked) == 30
    assert "HOME_POSITION" in s.failed
    for autopilot, home_amsl_m in ((CRAZYFLIE, 488.0), (ARDUPILOT, None)):
        told = sequencer(autopilot)
        told.home_amsl_m = home_amsl_m
        ready = status(0.0, mode=Mode.TAKEOFF if autopilot is ARDUPILOT else Mode.HOLD)
        assert commands(told.step(Request.TAKEOFF, ready, 0.0)) == [400]


def test_a_vehicle_in_the_air_is_never_told_to_take_off():
    s = sequencer()
    assert s.step(Request.TAKEOFF, status(1.0, armed=True, mode=Mode.OTHER, landed=Landed.IN_AIR), 0.5) == []


def test_commands_are_repeated_every_half_second_and_give_up():
    s = sequencer()
    sent = []
    for tick in range(1000):
        now = tick * 0.01
        sent += [(now, m.confirmation) for m in s.step(Request.LAND, status(now, armed=True), now)]
        if tick == 3:
            s.note_ack(21, 0)  # ACCEPTED, but the heartbeat never shows it
        if tick == 5:
            s.note_ack(21, 1)
            s.note_ack(400, 4)  # another command's answer
            s.note_text("Landing denied: no position")
    assert [confirmation for _, confirmation in sent] == list(range(10))
    gaps = [b - a for (a, _), (b, _) in pairwise(sent)]
    assert gaps == pytest.approx([0.5] * 9)
    assert "10 tries in 5.0 s" in s.failed
    assert "TEMPORARILY_REJECTED" in s.failed
    assert "no position" in s.failed


def test_a_new_request_clears_the_failure_and_starts_over():
    s = sequencer()
    for tick in range(60):
        s.step(Request.LAND, status(tick * 0.1, armed=True), tick * 0.1)
    assert s.failed is not None
    assert commands(s.step(Request.MOTORS_OFF, status(6.0, armed=True), 6.0)) == [400]
    assert s.failed is None


def test_external_waits_for_the_stream_and_never_arms():
    s = sequencer()
    first = None
    for tick in range(100):
        now = tick * 0.01
        messages = s.step(Request.EXTERNAL, status(now), now)
        if messages and first is None:
            first = (now, messages)
        if tick >= 20:
            s.note_setpoint(now)
    now, (message,) = first
    assert 0.5 <= now <= 0.52  # 0.3 s after the first set-point
    assert message.command == 176
    assert params(message)[:3] == [1.0, 6.0, 0.0]


def test_an_interrupted_stream_counts_from_its_new_start():
    s = sequencer()
    s.note_setpoint(0.0)
    s.note_setpoint(1.0)
    assert s.step(Request.EXTERNAL, status(1.0), 1.0) == []


def test_mode_changed_by_somebody_else_is_not_fought():
    s = sequencer()
    s.note_setpoint(0.0)
    s.step(Request.EXTERNAL, status(0.5, armed=True, mode=Mode.EXTERNAL), 0.4)
    assert s.reached
    for tick in range(200):
        now = 1.0 + tick * 0.01
        s.note_setpoint(now)
        assert s.step(Request.EXTERNAL, status(now, armed=True, mode=Mode.OTHER), now) == []


def test_an_old_heartbeat_does_not_prove_a_new_request():
    s = sequencer()
    old = status(0.0, armed=True, mode=Mode.LAND)
    assert s.step(Request.LAND, old, 0.5) == []
    assert not s.reached
    assert commands(s.step(Request.LAND, status(0.6, armed=True, mode=Mode.EXTERNAL), 0.6)) == [21]


def test_motors_off_is_forced_and_sent_even_blind():
    s = sequencer()
    (kill,) = s.step(Request.MOTORS_OFF, None, 0.0)
    assert kill.command == 400
    assert params(kill)[:2] == [0.0, 21196.0]
    assert s.step(Request.MOTORS_OFF, status(0.2), 0.2) == []
    assert s.reached


def test_land_and_motors_off_need_nothing_on_a_disarmed_vehicle():
    for request in (Request.LAND, Request.MOTORS_OFF):
        assert sequencer().step(request, status(), 0.0) == []


def test_ardupilot_switches_to_guided_before_it_arms_and_sends_no_nan():
    s = sequencer(ARDUPILOT)
    sent = s.step(Request.TAKEOFF, status(0.0), 0.0)
    sent += s.step(Request.TAKEOFF, status(0.1, mode=Mode.EXTERNAL), 0.1)
    sent += s.step(Request.TAKEOFF, status(0.2, mode=Mode.EXTERNAL, armed=True), 0.2)
    s.above_home = (0.3, 0.0)
    sent += s.step(Request.TAKEOFF, status(0.2, mode=Mode.EXTERNAL, armed=True), 0.3)
    assert commands(sent) == [176, 400, 512, 22]
    assert params(sent[0])[:2] == [1.0, 4.0]
    assert not any(math.isnan(p) for m in sent for p in params(m))


@pytest.mark.parametrize("height", [0.0, -1.0, math.nan, math.inf])
def test_senseless_takeoff_height_is_refused(height):
    with pytest.raises(ValueError, match="take-off height"):
        CommandSequencer(PX4, 1, 1, height)


def test_a_stream_that_stops_is_asked_for_again():
    streams = StreamRequests({32: 50.0}, 1, 1, 0.0)
    asked = []
    for tick in range(1000):
        asked += [tick * 0.02 for _ in streams.step(tick * 0.02)]
        if tick < 500:
            streams.seen(32)
    assert asked == pytest.approx(
        [0.0, 11.0, 12.0, 13.0, 14.0, 17.0]
    )  # every second, then every 3 s without end


def test_long_texts_are_put_together():
    texts = TextAssembler()
    text = "Preflight Fail: " + "x" * 60 + "\t"
    add = [
        texts.add(dialect.MAVLink_statustext_message(3, text[i : i + 50].encode(), 7, n))
        for n, i in enumerate((0, 50))
    ]
    assert add == [[], [(3, text.strip())]]
    assert texts.add(dialect.MAVLink_statustext_message(6, b"short\x1b[2J", 0, 0)) == [(6, "short [2J")]
