"""Tests that the log of a fleet member contains the received messages, and replays with them bit by bit."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.common.pacing import EPOCH_NS, Tick
from flightstack.core.types import Intent, MemberStatus
from logs.reader.reader import LogFile
from logs.replay.replay import ReplayError, replay
from logs.schema import schemas
from logs.schema.controller_rows import pack_neighbours, unpack_neighbours
from tests.golden.flights import path_of, write_kept

RECORDED = path_of("fleet_3_cf1")
NEIGHBOURS = "/cf1/controller/neighbours"
TICK = 60  # number of a tick whose decisions depend on the messages


def test_each_tick_has_what_was_told_in_it():
    messages = list(LogFile(RECORDED).messages({NEIGHBOURS}))
    assert {m.schema for m in messages} == {schemas.CONTROLLER_NEIGHBOURS}
    assert [m.sequence for m in messages] == list(range(len(messages)))
    told = [unpack_neighbours(m.data) for m in messages]
    assert {len(words) for words in told} >= {0, 1, 2}
    assert {word.id for words in told for word in words} == {2, 3}


def one_bit(message):
    """Change one bit of the east position in the last status message, by less than a nanometre."""
    *before, word = unpack_neighbours(message.data)
    x, y, z = word.position_enu_m
    (bits,) = struct.unpack("<Q", struct.pack("<d", x))
    (near,) = struct.unpack("<d", struct.pack("<Q", bits ^ 1 << 20))
    assert 0.0 < abs(near - x) < 1e-9
    tick = Tick(message.sequence, 0.0, message.log_time_ns, 0.0, 0.0)
    return pack_neighbours(tick, [*before, word._replace(position_enu_m=(near, y, z))])


def test_one_bit_of_a_word_counts(tmp_path):
    def change(message):
        here = (message.topic, message.sequence) == (NEIGHBOURS, TICK)
        return one_bit(message) if here else message.data

    result = replay(write_kept(RECORDED, tmp_path / "changed.mcap", wire=False, change=change))
    assert result.outputs.count
    assert result.outputs.first[0].index == TICK


def test_without_the_words_nothing_is_proved(tmp_path):
    lost = lambda m: (m.topic, m.sequence) != (NEIGHBOURS, TICK)  # noqa: E731
    with pytest.raises(ReplayError, match=f"at tick {TICK} are missing .*{NEIGHBOURS}"):
        replay(write_kept(RECORDED, tmp_path / "lost.mcap", wire=False, when=lost))


FLOATS = st.floats(allow_nan=True)
VECTORS = st.tuples(FLOATS, FLOATS, FLOATS)
IDS = st.integers(1, 250)
words = st.builds(
    MemberStatus, IDS, FLOATS, FLOATS, VECTORS, VECTORS, VECTORS, FLOATS, FLOATS, st.sampled_from(Intent),
    FLOATS, st.none() | VECTORS, st.none() | VECTORS, st.lists(IDS, max_size=8).map(tuple),
)  # fmt: skip


@given(st.lists(words, max_size=4).map(tuple), st.integers(0, 2**40))
def test_words_come_back_to_the_bit(told, number):
    tick = Tick(number, 1.0, EPOCH_NS, 0.0, 0.0)
    data = pack_neighbours(tick, told)
    back = unpack_neighbours(data)
    assert repr(back) == repr(told)
    assert pack_neighbours(tick, back) == data


def test_a_number_that_is_no_intent_is_refused():
    word = MemberStatus(2, 0.0, 0.0, *[(0.0, 0.0, 0.0)] * 3, intent=99)
    with pytest.raises(ValueError, match="99"):
        unpack_neighbours(pack_neighbours(Tick(0, 0.0, EPOCH_NS, 0.0, 0.0), [word]))
