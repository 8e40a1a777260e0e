"""Frames of our packer equal those of pymavlink, byte for byte; what one refuses, the other does too."""

import math
import random
import struct

import pytest

from bridge.mavlink.codec.decoding import decode
from bridge.mavlink.codec.framing import intact
from bridge.mavlink.codec.packing import pack
from bridge.mavlink.endpoint import dialect

CLASSES = [dialect.mavlink_map[id_] for id_ in sorted(dialect.mavlink_map)]
ROWS = 25  # messages a class
FLOATS = (0.0, -0.0, math.nan, math.inf, -math.inf, 1.0, 5e-324, 3.4e38, -3.4e38, 1e-45, 3, True)
HOSTILE = (None, "", "text", b"", b"ab", -1, 2**70, -(2**70), 1.5, 1e39, math.nan, [], [1, 2], (), object())


def number(rng, kind):
    """A value that fits the field's type; zero and the bounds often."""
    if kind in ("float", "double"):
        return rng.choice((*FLOATS, rng.gauss(0.0, 1e3), rng.uniform(-1.0, 1.0)))
    bits = int("".join(filter(str.isdigit, kind.removesuffix("_t"))))
    low, high = (0, 2**bits - 1) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return rng.choice((0, 0, low, high, rng.randint(low, high)))


def fields(cls):
    """(type, length of an array or 0) of each argument of the constructor."""
    wire = dict(zip(cls.ordered_fieldnames, cls.array_lengths, strict=True))
    return [(kind, wire[name]) for name, kind in zip(cls.fieldnames, cls.fieldtypes, strict=True)]


def arguments(rng, cls):
    """Good arguments; strings and arrays also longer than there is room for."""
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
    """The frame, or what kind of error there was."""
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


def test_nothing_but_zeros_leaves_one_byte():
    for cls in CLASSES:
        zeros = [b"" if kind == "char" else [0] * length if length else 0 for kind, length in fields(cls)]
        frame = pack(cls(*zeros), 0, 1, 1)
        assert (frame[1], len(frame)) == (1, 13)
        assert frame == by_pymavlink(cls(*zeros), 0, 1, 1)


def test_the_message_keeps_its_frame():
    message = dialect.MAVLink_timesync_message(3, 4)
    assert pack(message, 9, 1, 191) == message.get_msgbuf()


@pytest.mark.parametrize("ids", [(256, 1, 1), (0, 256, 1), (0, 1, -1)])
def test_ids_have_a_byte(ids):
    with pytest.raises(struct.error):
        pack(dialect.MAVLink_timesync_message(3, 4), *ids)
