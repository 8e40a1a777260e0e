"""Reading parameters: bounded, matched by name, and never guessed."""

import math
import struct

import pytest

from bridge.mavlink.client.parameters import ParameterReader
from bridge.mavlink.endpoint import dialect
from bridge.mavlink.profiles.profile import Encoding

REAL, INT32, INT8 = dialect.MAV_PARAM_TYPE_REAL32, dialect.MAV_PARAM_TYPE_INT32, dialect.MAV_PARAM_TYPE_INT8


def reader(*names, encoding=Encoding.BYTEWISE):
    return ParameterReader(names, 1, 1, encoding)


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


def test_where_answers_are_lost_a_parameter_is_asked_for_fifteen_times():
    r = reader("LOST_ONCE", "LOST_LONG")
    r.step(0.0)
    r.step(0.4)
    r.take(value("LOST_ONCE", 1.0))  # to the second request
    sent = [now for tick in range(41, 1000) for now in [tick * 0.01] if r.step(now)]
    assert len(sent) == 13
    assert r.done
    assert "no answer to 15 requests in 6 s" in r.missing["LOST_LONG"]


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


def test_answers_to_others_are_ignored_and_the_first_of_ours_counts():
    r = reader("MINE")
    r.step(0.0)
    r.take(value("THEIRS", 3.0))
    r.take(value("MINE_TOO", 3.0))
    assert r.values == {}
    r.take(value("MINE", 4.0))
    r.take(value("MINE", 5.0))
    assert r.values == {"MINE": 4.0}


@pytest.mark.parametrize(
    ("encoding", "wire", "type_", "expected"),
    [
        (Encoding.BYTEWISE, bits(4), INT32, 4.0),
        (Encoding.BYTEWISE, bits(-7), INT32, -7.0),
        (Encoding.BYTEWISE, struct.unpack("<f", b"\xfe\0\0\0")[0], INT8, -2.0),
        (Encoding.BYTEWISE, 0.5, REAL, 0.5),
        (Encoding.C_CAST, 4.0, INT32, 4.0),
        (Encoding.C_CAST, -2.0, INT8, -2.0),
        (Encoding.C_CAST, 0.5, REAL, 0.5),
    ],
)
def test_integers_are_decoded_as_the_autopilot_sends_them(encoding, wire, type_, expected):
    r = reader("P", encoding=encoding)
    r.step(0.0)
    r.take(value("P", wire, type_))
    assert r.values == {"P": expected}


@pytest.mark.parametrize(("wire", "type_"), [(math.nan, REAL), (math.inf, REAL), (1.0, 10), (1.0, 200)])
def test_what_is_no_number_is_missing(wire, type_):
    r = reader("P")
    r.step(0.0)
    r.take(value("P", wire, type_))
    assert r.values == {}
    assert "not a number" in r.missing["P"]


def test_names_of_sixteen_characters_and_repeated_names():
    r = reader("ABCDEFGHIJKLMNOP", "ABCDEFGHIJKLMNOP")
    assert asked(r.step(0.0)) == ["ABCDEFGHIJKLMNOP"]
    r.take(value("ABCDEFGHIJKLMNOP", 1.0))
    assert r.done
