"""Tests vehicle state and parameters that the client reads, and the stated reasons of missing messages."""

import math
import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client import texts
from bridge.mavlink.client.senders import why_silent
from bridge.mavlink.client.texts import EVENT, event_text
from bridge.mavlink.client.vehicle_state import VehicleState
from bridge.mavlink.codec.messages import MESSAGES
from bridge.mavlink.preflight.examine import ParameterReader
from bridge.mavlink.profiles import PX4
from flightstack.core.types import Landed, Mode, VehicleStatus
from tests import tables
from tests.px4_place import px4_or_skip
from tests.unit.mavlink.client.vehicle_link_fakes import OFFBOARD, attitude, heartbeat, position


@pytest.fixture
def state():
    return VehicleState(PX4)


def test_position_and_attitude_become_own_state_in_enu(state):
    state.update(attitude(990, yaw=math.pi / 2), 4.9)
    state.update(position(1000), 5.0)
    own = state.own
    assert own.position_enu_m == pytest.approx((2.0, 1.0, 3.0))
    assert own.velocity_enu_m_s == pytest.approx((0.2, 0.1, 0.3))
    assert own.yaw_rad == pytest.approx(0.0)
    assert (own.arrival_s, own.source_time_s) == (5.0, pytest.approx(1.0))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e30])
@pytest.mark.parametrize("field", ["x", "y", "z", "vx", "vy", "vz"])
def test_position_with_a_bad_number_is_never_used(state, field, value):
    state.update(attitude(1000), 1.0)
    state.update(position(1000), 1.0)
    state.update(position(1010, **{field: value}), 1.01)
    assert state.own.arrival_s == 1.0
    assert state.counters["not_finite"] == 1


@pytest.mark.parametrize("field", ["yaw", "roll"])
def test_attitude_with_a_bad_number_is_never_used(state, field):
    state.update(attitude(1000, yaw=0.5), 1.0)
    state.update(attitude(1010, **{field: math.nan}), 1.01)
    state.update(position(1010), 1.01)
    assert state.own.yaw_rad == pytest.approx(math.pi / 2 - 0.5)
    assert state.counters["not_finite"] == 1


@pytest.mark.parametrize("late_ms", [1000, 990, 100])
def test_repeated_and_late_positions_do_not_refresh_the_state(state, late_ms):
    state.update(attitude(1000), 1.0)
    state.update(position(1000), 1.0)
    state.update(position(late_ms, x=9.0), 1.1)
    assert state.own.arrival_s == 1.0
    assert state.counters["out_of_order"] == 1


def fly(state, since_s, until_s, ahead_s=0.0):
    """Feed positions at 50 Hz from a clock that is 60 s ahead; return the times of accepted positions, s."""
    taken = []
    for k in range(round((until_s - since_s) / 0.02)):
        at_s = since_s + 0.02 * k
        stamp_ms = round((60.0 + at_s + ahead_s) * 1e3)
        state.update(attitude(stamp_ms), at_s)
        state.update(position(stamp_ms), at_s)
        if state.own is not None and state.own.arrival_s == at_s:
            taken.append(at_s)
    return taken


@pytest.mark.parametrize("by_s", [-60.0, -2.0, -0.3, 0.2, 3600.0])
def test_a_boot_clock_that_steps_is_followed_after_some_messages_that_agree(state, by_s):
    fly(state, 0.0, 2.0)
    taken = fly(state, 2.0, 4.0, by_s)
    assert taken[0] == pytest.approx(2.3, abs=0.03)
    assert len(taken) >= 83
    assert state.restarted_s == taken[0]


def test_status_is_put_together_from_three_messages(state):
    state.update(dialect.MAVLink_extended_sys_state_message(0, 2), 0.5)
    assert state.status is None  # without a heartbeat the status is unknown
    state.update(heartbeat(OFFBOARD, armed=True), 1.0)
    assert state.status == VehicleStatus(1.0, True, Mode.EXTERNAL, Landed.IN_AIR, False)
    health = dialect.MAV_SYS_STATUS_PREARM_CHECK
    state.update(dialect.MAVLink_sys_status_message(0, 0, health, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0), 1.5)
    state.update(dialect.MAVLink_extended_sys_state_message(0, 1), 1.6)
    assert state.status == VehicleStatus(1.0, True, Mode.EXTERNAL, Landed.ON_GROUND, True)
    state.update(dialect.MAVLink_extended_sys_state_message(0, 77), 1.7)
    assert state.status.landed is Landed.UNKNOWN


REAL, INT32, INT8 = dialect.MAV_PARAM_TYPE_REAL32, dialect.MAV_PARAM_TYPE_INT32, dialect.MAV_PARAM_TYPE_INT8


def reader(*names, bytewise=True):
    return ParameterReader(names, (1, 1), bytewise=bytewise)


def value(name, wire, type_=REAL):
    return dialect.MAVLink_param_value_message(name.encode(), wire, type_, 1, 0)


def bits(number):
    return struct.unpack("<f", struct.pack("<i", number))[0]


def asked(messages):
    assert all(m.get_type() == "PARAM_REQUEST_READ" and m.param_index == -1 for m in messages)
    return [m.param_id.decode() if isinstance(m.param_id, bytes) else m.param_id for m in messages]


def test_a_few_are_asked_for_at_once_and_the_next_as_they_come():
    names = [f"P{i}" for i in range(8)]
    r = reader(*names)
    assert asked(r.step(0.0)) == names[:5]
    assert r.step(0.1) == []
    r.take(value("P3", 1.5))
    assert asked(r.step(0.1)) == ["P5"]
    assert r.values == {"P3": 1.5}
    assert not r.done


def test_what_does_not_come_is_asked_for_five_times_and_is_missing():
    r = reader("COM_OF_LOSS_T")
    sent = [now for tick in range(1000) for now in [tick * 0.01] if r.step(now)]
    assert sent == pytest.approx([0.0, 0.4, 0.8, 1.2, 1.6], abs=0.02)
    assert r.done
    assert r.values == {}
    assert "no answer to 5 requests" in r.missing["COM_OF_LOSS_T"]


@pytest.mark.parametrize(
    ("error", "word"), [(1, "DOES_NOT_EXIST"), (3, "PERMISSION_DENIED"), (77, "error 77")]
)
def test_an_error_is_missing_at_once(error, word):
    r = reader("NOT_HERE", "HERE")
    r.step(0.0)
    r.take(dialect.MAVLink_param_error_message(1, 191, b"NOT_HERE", -1, error))
    r.take(dialect.MAVLink_param_error_message(1, 191, b"OTHER", -1, error))
    assert word in r.missing["NOT_HERE"]
    r.take(value("HERE", 2.0))
    assert r.done
    assert r.values == {"HERE": 2.0}


@pytest.mark.parametrize(
    ("bytewise", "wire", "type_", "expected"),
    [
        (True, bits(4), INT32, 4.0),
        (True, bits(-7), INT32, -7.0),
        (True, struct.unpack("<f", b"\xfe\0\0\0")[0], INT8, -2.0),
        (True, 0.5, REAL, 0.5),
        (False, 4.0, INT32, 4.0),
        (False, -2.0, INT8, -2.0),
        (False, 0.5, REAL, 0.5),
    ],
)
def test_integers_are_decoded_as_the_autopilot_sends_them(bytewise, wire, type_, expected):
    r = reader("P", bytewise=bytewise)
    r.step(0.0)
    r.take(value("P", wire, type_))
    assert r.values == {"P": expected}


@pytest.mark.parametrize(
    ("grown", "words"),
    [
        ({}, "component 1: no data arrives; check that the vehicle is on"),
        ({"sent": 10}, "no data arrives"),
        ({"bad_signature": 3, "unsigned": 1}, "3 frames are signed with another key than --signing-key"),
        ({"unsigned": 4, "received": 2}, "4 frames have no signature"),
        ({"stale": 1, "ahead": 2}, "3 signed frames are rejected by their time stamps"),
        ({"reflected": 5}, "5 frames have our own ids"),
        ({"version_1": 5, "garbage_bytes": 9}, "5 frames are MAVLink 1"),
        ({"bad_crc": 1, "unknown_id": 1}, "2 frames are damaged or of unknown messages"),
        ({"garbage_bytes": 9}, "9 bytes are no MAVLink 2 frames"),
        ({"received": 9}, "only its other messages arrive"),
    ],
)
def test_the_cause_is_named_with_its_count(grown, words):
    assert words in why_silent(1, grown, {})


def test_who_speaks_instead_is_named():
    senders = {(255, 190): 3, (2, 1): 4}
    text = why_silent(1, {"received": 7, "unknown_id": 5, "garbage_bytes": 150}, senders)  # typical of PX4
    assert text == (
        "no heartbeat of system 1, component 1: frames come from system/component 2/1, 255/190; --system-id "
        "names the vehicle's"
    )
    many = {(system, 1): 1 for system in range(10, 20)}
    assert "10/1, 11/1, 12/1, 13/1, ...;" in why_silent(1, {"received": 7}, many)
    assert "for 12 s: no data" in why_silent(1, {}, senders, time=" for 12 s")  # nothing arrives


def event(number, log_levels=0x66, arguments=b""):
    return MESSAGES[EVENT](0, 0, number, 0, 0, log_levels, list(arguments.ljust(40, b"\x00")))


@pytest.mark.parametrize(
    ("number", "levels", "arguments", "wanted"),
    [
        (0x0190CAF3, 0x66, "04", (6, "Armed by external command")),
        (0x01F46777, 0x66, "07", (6, "Disarmed by auto preflight disarming")),
        (0x012F1DC7, 0x33, "0040000014", (3, "No offboard signal")),
        (0x01A9B99D, 0x22, "", (2, "Connection to mission computer lost")),
        (0x01125BEF, 0x66, "ea070b16101b34", (6, "logging: opening log file 2026-11-22/16_27_52.ulg")),
    ],
)
def test_event_is_told_in_px4s_words(number, levels, arguments, wanted):
    assert event_text(event(number, levels, bytes.fromhex(arguments))) == wanted


def test_every_event_of_the_table_is_told_whatever_its_arguments():
    table = texts._table()
    assert len(table.events) > 300
    for number in table.events:
        for fill in (0x00, 0x01, 0x7F, 0xFF):
            severity, text = event_text(event(number, 0x04, bytes([fill]) * 40))
            assert severity == 4
            assert text
            assert text.isprintable()
            assert "{" not in text


def test_table_is_what_its_command_makes():
    metadata = px4_or_skip().parent / "etc/extras/all_events.json.xz"
    assert tables.EVENTS.read_text() == tables.events_table(metadata)


@pytest.mark.parametrize(("wire", "type_"), [(math.nan, REAL), (math.inf, REAL), (1.0, 10), (1.0, 200)])
def test_what_is_no_number_is_missing(wire, type_):
    r = reader("P")
    r.step(0.0)
    r.take(value("P", wire, type_))
    assert r.values == {}
    assert "not a number" in r.missing["P"]


def test_answers_to_others_are_ignored_and_the_first_of_ours_counts():
    r = reader("MINE")
    r.step(0.0)
    r.take(value("THEIRS", 3.0))
    r.take(value("MINE_TOO", 3.0))
    assert r.values == {}
    r.take(value("MINE", 4.0))
    r.take(value("MINE", 5.0))
    assert r.values == {"MINE": 4.0}


def test_where_answers_are_lost_a_parameter_is_asked_for_fifteen_times():
    r = reader("LOST_ONCE", "LOST_LONG")
    r.step(0.0)
    r.step(0.4)
    r.take(value("LOST_ONCE", 1.0))  # the reply to the second request
    sent = [now for tick in range(41, 1000) for now in [tick * 0.01] if r.step(now)]
    assert len(sent) == 13
    assert r.done
    assert "no answer to 15 requests in 6 s" in r.missing["LOST_LONG"]
