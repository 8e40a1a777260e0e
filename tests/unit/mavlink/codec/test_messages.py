"""Tests that messages are packed and decoded as by pymavlink, also those that its dialect lacks."""

import math
import random
import struct

import pytest
from pymavlink.dialects.v20 import all as everything
from pymavlink.dialects.v20 import ardupilotmega, common, development, standard
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.framing import intact
from bridge.mavlink.codec.messages import MESSAGES, decode, definitions, make_class, pack
from tests import tables

CLASSES = [dialect.mavlink_map[id_] for id_ in sorted(dialect.mavlink_map)]
ROWS = 25  # number of tested messages per class
FLOATS = (0.0, -0.0, math.nan, math.inf, -math.inf, 1.0, 5e-324, 3.4e38, -3.4e38, 1e-45, 3, True)
HOSTILE = (None, "", "text", b"", b"ab", -1, 2**70, -(2**70), 1.5, 1e39, math.nan, [], [1, 2], (), object())


def number(rng, kind):
    """Return a random value of the field's type, often zero or a limit."""
    if kind in ("float", "double"):
        return rng.choice((*FLOATS, rng.gauss(0.0, 1e3), rng.uniform(-1.0, 1.0)))
    bits = int("".join(filter(str.isdigit, kind.removesuffix("_t"))))
    low, high = (0, 2**bits - 1) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return rng.choice((0, 0, low, high, rng.randint(low, high)))


def fields(cls):
    """Return the type and the array length (0: no array) of each constructor argument."""
    wire = dict(zip(cls.ordered_fieldnames, cls.array_lengths, strict=True))
    return [(kind, wire[name]) for name, kind in zip(cls.fieldnames, cls.fieldtypes, strict=True)]


def arguments(rng, cls):
    """Return valid arguments; strings and arrays may exceed the field's length."""
    values = []
    for kind, length in fields(cls):
        if kind == "char":
            values.append(rng.randbytes(rng.randint(0, length + 3)))
        elif length:
            count = length + rng.randint(0, 2)
            values.append([0] * count if rng.random() < 0.3 else [number(rng, kind) for _ in range(count)])
        else:
            values.append(number(rng, kind))
    return values


def by_pymavlink(message, sequence, system, component):
    mav = dialect.MAVLink(None, system, component)
    mav.seq = sequence
    return message.pack(mav)


def outcome(packer, cls, values):
    """Return the packed frame, or the kind of the error."""
    try:
        return packer(cls(*values), 7, 1, 1)
    except Exception as error:
        return type(error)


def test_every_message_of_the_dialect_is_packed_as_pymavlink_does():
    for cls in CLASSES:
        rng = random.Random(cls.id)
        for _ in range(ROWS):
            values, ids = arguments(rng, cls), tuple(rng.randbytes(3))
            frame = pack(cls(*values), *ids)
            assert frame == by_pymavlink(cls(*values), *ids), (cls.msgname, values)
            assert intact(frame)
            assert pack(decode(frame), *ids) == frame, (cls.msgname, values)


def test_what_does_not_fit_is_refused_as_pymavlink_does():
    seen = set()
    for cls in CLASSES:
        rng = random.Random(cls.id)
        for _ in range(ROWS):
            values = arguments(rng, cls)
            for place in rng.sample(range(len(values)), rng.randint(1, min(2, len(values)))):
                values[place] = rng.choice((*HOSTILE, values[place]))
            ours, theirs = (outcome(packer, cls, values) for packer in (pack, by_pymavlink))
            assert ours == theirs, (cls.msgname, values)
            seen.add(ours if isinstance(ours, type) else bytes)
    assert {struct.error, IndexError, TypeError, AttributeError, OverflowError, bytes} <= seen


WIDE = {d.id: d for d in definitions()}
ATTRIBUTES = ("id", "msgname", "fieldnames", "ordered_fieldnames", "fieldtypes", "native_format", "orders",
              "lengths", "array_lengths", "crc_extra")  # fmt: skip


def test_table_is_what_its_command_makes_of_the_installed_pymavlink():
    assert tables.MESSAGES.read_text() == tables.messages_table()


@pytest.mark.parametrize("other", [everything, common, development, standard, ardupilotmega])
def test_every_message_of_pymavlinks_dialects_is_known(other):
    for id_, cls in other.mavlink_map.items():
        assert (MESSAGES[id_].msgname, MESSAGES[id_].crc_extra) == (cls.msgname, cls.crc_extra)


def test_class_equals_pymavlinks():
    for number in sorted(set(WIDE) & set(everything.mavlink_map)):
        made, theirs = make_class(WIDE[number]), everything.mavlink_map[number]
        for name in ATTRIBUTES:
            assert getattr(made, name) == getattr(theirs, name), name
        # pymavlink writes an array of one element as one element
        assert made.unpacker.size == theirs.unpacker.size


def test_a_payload_of_any_length_is_decoded_as_pymavlink_does():
    theirs = dialect.MAVLink(None)
    for cls in CLASSES:
        rng, size = random.Random(cls.id), cls.unpacker.size
        for length in (size, rng.randint(1, size), min(255, size + 3)):
            payload = bytes(rng.choice((0, rng.randrange(256))) for _ in range(length))
            body = bytes((length, 0, 0, 7, 3, 4)) + cls.id.to_bytes(3, "little") + payload
            crc = dialect.x25crc(body + bytes((cls.crc_extra,))).crc
            frame = b"\xfd" + body + crc.to_bytes(2, "little")
            ours, other = vars(decode(frame)), vars(theirs.decode(bytearray(frame)))
            for name in set(other) - {"_header", "_payload", "_msgbuf"}:
                assert repr(ours[name]) == repr(other[name]), (cls.msgname, name)
            assert vars(ours["_header"]) == vars(other["_header"])
