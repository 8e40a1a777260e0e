"""Messages beyond pymavlink's dialect ``ardupilotmega``: the table, and classes of the same make."""

import inspect
import random

import pytest
from pymavlink.dialects.v20 import all as everything
from pymavlink.dialects.v20 import ardupilotmega, common, development, standard

from bridge.mavlink.codec.decoding import decode
from bridge.mavlink.codec.framing import split_frames
from bridge.mavlink.codec.packing import pack
from bridge.mavlink.codec.wide_messages import MESSAGES, Definition, definitions, make_class
from tests import tables

WIDE = {d.id: d for d in definitions()}
ATTRIBUTES = ("id", "msgname", "fieldnames", "ordered_fieldnames", "fieldtypes", "native_format", "orders",
              "lengths", "array_lengths", "crc_extra")  # fmt: skip


def test_table_is_what_its_command_makes_of_the_installed_pymavlink():
    assert tables.MESSAGES.read_text() == tables.messages_table()


@pytest.mark.parametrize("other", [everything, common, development, standard, ardupilotmega])
def test_every_message_of_pymavlinks_dialects_is_known(other):
    for id_, cls in other.mavlink_map.items():
        assert (MESSAGES[id_].msgname, MESSAGES[id_].crc_extra) == (cls.msgname, cls.crc_extra)


@pytest.mark.parametrize("number", [8, 290, 291, 380, 410, 411, 436])
def test_messages_that_px4_sends_are_known(number):
    assert number in MESSAGES


def test_known_messages_stay_pymavlinks_own():
    assert all(MESSAGES[id_] is cls for id_, cls in ardupilotmega.mavlink_map.items())


@pytest.mark.parametrize("definition", WIDE.values(), ids=lambda d: d.name)
def test_crc_extra_is_that_of_names_and_types(definition):
    assert definition.computed_crc_extra() == definition.crc_extra
    assert Definition.parse(definition.line) == definition


@pytest.mark.parametrize("number", sorted(set(WIDE) & set(everything.mavlink_map)))
def test_class_equals_pymavlinks(number):
    made, theirs = make_class(WIDE[number]), everything.mavlink_map[number]
    for name in ATTRIBUTES:
        assert getattr(made, name) == getattr(theirs, name), name
    # pymavlink writes an array of one element as one element
    assert made.unpacker.size == theirs.unpacker.size


@pytest.mark.parametrize("number", sorted(WIDE))
def test_message_passes_the_wire_unchanged(number):
    rng, cls = random.Random(number), MESSAGES[number]
    for _ in range(20):
        payload = rng.randbytes(cls.unpacker.size - 1) + b"\x01"
        head = bytes([len(payload), 0, 0, 7, 3, 4]) + number.to_bytes(3, "little") + payload
        crc = ardupilotmega.x25crc(head + bytes([cls.crc_extra])).crc
        frame = b"\xfd" + head + crc.to_bytes(2, "little")
        assert list(split_frames(frame)) == [frame]
        message = decode(frame)
        assert message.get_type() == WIDE[number].name
        if not any("float" in kind or "double" in kind for kind in cls.fieldtypes):  # a NaN has many bits
            assert pack(message, 7, 3, 4) == frame


def test_wrong_fields_are_refused():
    cls = MESSAGES[411]
    assert cls(sequence=3, flags=0).sequence == 3
    for values in ((1,), (1, 2, 3)):
        with pytest.raises(TypeError, match="sequence, flags"):
            cls(*values)
    assert not inspect.signature(cls).parameters.keys() & {"sequence"}


@pytest.mark.parametrize("line", ["1;A;2;int9_t x", "1;A;2;uint8_t", "one;A;2;uint8_t x"])
def test_line_of_another_form_is_refused(line):
    with pytest.raises(ValueError, match=r"allowed|invalid"):
        Definition.parse(line)
