"""The log of a vehicle in a fleet holds what it was told, and replays by that, bit by bit."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.common.pacing import EPOCH_NS, Tick
from flightstack.common.strict_toml import dumps
from flightstack.core.controller import state_class
from flightstack.core.types import Intent, Neighbour, Phase
from flightstack.onboard.log import OnboardLog
from flightstack.onboard.runner import Taken
from logs.reader.reader import LogFile
from logs.replay.replay import ReplayError, replay
from logs.schema import schemas
from logs.schema.controller_rows import pack_neighbours, unpack_neighbours
from tests.golden.flights import write_kept
from tests.unit.core.fleet.fleet_helpers import RATE_HZ, Flyer, Sky, all_landed, parked, settings_of
from tests.unit.logs.replay.replay_helpers import FileFeed, NoSession

NEIGHBOURS = "/cf1/controller/neighbours"
TICK = 40  # one at which a single word comes, which decides


class Recorded:
    """A controller whose ticks are recorded by the code that records real ones."""

    def __init__(self, controller, config, path):
        self.controller, self.feed, self.number = controller, FileFeed(path), 0
        self.feed.file.attachment("onboard.toml", "application/toml", 0, dumps(config).encode())
        self.feed.file.metadata("onboard", {"namespace": "cf1"})
        self.log = OnboardLog(
            self.feed, NoSession(), "cf1", RATE_HZ, lockstep=True, state=state_class(config)
        )

    def step(self, inputs, now_s):
        out = self.controller.step(inputs, now_s)
        tick = Tick(self.number, now_s, EPOCH_NS + round(now_s * 1e9), 0.0, 0.0)
        self.number += 1
        self.log.step(tick, Taken(inputs, False), out, self.controller.state)
        return out

    def __getattr__(self, name):
        return getattr(self.controller, name)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Two meet on their ways to each other's side; the log is that of the first."""
    path = tmp_path_factory.mktemp("fleet") / "flight.mcap"
    starts, pads = [(-1.0, 0.0, 1.0), (1.0, 0.0, 1.0)], [parked(0.8, 0.0), parked(-0.8, 0.0)]
    flyers = [Flyer(settings_of(n, (1, 2)), starts[n - 1], pads[n - 1]) for n in (1, 2)]
    flyers[0].controller = Recorded(flyers[0].controller, flyers[0].config, path)
    sky = Sky(flyers).run(25.0, all_landed)
    flyers[0].controller.feed.file.close()
    assert flyers[0].phase is Phase.LANDED
    assert sky.least_h_m >= 0.0
    return path


def test_a_flight_in_a_fleet_replays_bit_by_bit(recorded, tmp_path):
    result = replay(recorded)
    assert result.equal, result.outputs.first + result.states.first
    assert (result.start, result.compared) == ("tick 0", result.last_tick + 1)
    late = lambda m: m.topic == "/rosout" or m.sequence >= 37  # noqa: E731
    result = replay(write_kept(recorded, tmp_path / "late.mcap", wire=False, when=late))
    assert result.equal, result.outputs.first + result.states.first
    assert (result.start, result.first_tick) == (f"the state after tick {RATE_HZ}", RATE_HZ + 1)


def test_each_tick_has_what_was_told_in_it(recorded):
    messages = list(LogFile(recorded).messages({NEIGHBOURS}))
    assert {m.schema for m in messages} == {schemas.CONTROLLER_NEIGHBOURS}
    assert [m.sequence for m in messages] == list(range(len(messages)))
    told = [unpack_neighbours(m.data) for m in messages]
    assert {len(words) for words in told} >= {0, 1, 2}
    assert {word.id for words in told for word in words} == {2}


def one_bit(message):
    """Change a bit of the eastern position of the vehicle that spoke last, by less than a nanometre."""
    *before, word = unpack_neighbours(message.data)
    x, y, z = word.position_enu_m
    (bits,) = struct.unpack("<Q", struct.pack("<d", x))
    (near,) = struct.unpack("<d", struct.pack("<Q", bits ^ 1 << 20))
    assert 0.0 < abs(near - x) < 1e-9
    tick = Tick(message.sequence, 0.0, message.log_time_ns, 0.0, 0.0)
    return pack_neighbours(tick, [*before, word._replace(position_enu_m=(near, y, z))])


def test_one_bit_of_a_word_counts(recorded, tmp_path):
    def change(message):
        here = (message.topic, message.sequence) == (NEIGHBOURS, TICK)
        return one_bit(message) if here else message.data

    result = replay(write_kept(recorded, tmp_path / "changed.mcap", wire=False, change=change))
    assert result.outputs.count
    assert result.outputs.first[0].tick == TICK


def test_without_the_words_nothing_is_proved(recorded, tmp_path):
    lost = lambda m: (m.topic, m.sequence) != (NEIGHBOURS, TICK)  # noqa: E731
    with pytest.raises(ReplayError, match=f"at tick {TICK} is missing .*{NEIGHBOURS}"):
        replay(write_kept(recorded, tmp_path / "lost.mcap", wire=False, when=lost))


FLOATS = st.floats(allow_nan=True)
VECTORS = st.tuples(FLOATS, FLOATS, FLOATS)
IDS = st.integers(1, 250)
words = st.builds(
    Neighbour, IDS, FLOATS, FLOATS, VECTORS, VECTORS, VECTORS, FLOATS, FLOATS, st.sampled_from(Intent),
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
    word = Neighbour(2, 0.0, 0.0, *[(0.0, 0.0, 0.0)] * 3, intent=99)
    with pytest.raises(ValueError, match="99"):
        unpack_neighbours(pack_neighbours(Tick(0, 0.0, EPOCH_NS, 0.0, 0.0), [word]))
