"""A flying vehicle under 20 000 hostile datagrams: nothing raises, grows, changes or gets lost."""

import gc
import tracemalloc

import pytest

from bridge.mavlink.signing.key import SigningKey
from tests.unit.autopilot.autopilot_fakes import Rig
from tests.unit.autopilot.fuzz_helpers import Fuzz, intervals_us, state

pytestmark = pytest.mark.slow

KEY = SigningKey(bytes(range(32)))
DATAGRAMS = 20_000  # in all
BATCH = 1000


@pytest.fixture(params=[None, KEY], ids=["unsigned", "signed"])
def fuzz(request):
    made = Fuzz(seed=1, key=request.param)
    yield made
    made.close()


def test_nothing_but_the_owner_moves_the_vehicle_and_nothing_of_the_owner_is_lost(fuzz):
    fuzz.run(BATCH)
    before, rates_before = state(fuzz.rig), intervals_us(fuzz.rig)
    objects = 0
    for number in range(DATAGRAMS // 2 // BATCH):
        fuzz.run(BATCH)
        assert state(fuzz.rig) == before
        rates = intervals_us(fuzz.rig)  # a stranger may ask for more, but nobody gets less
        assert all(now <= then for now, then in zip(rates, rates_before, strict=True))
        assert fuzz.signer is None or rates == rates_before
        assert fuzz.rig.vehicle.setpoint == pytest.approx(fuzz.wanted)
        assert fuzz.lost == 0
        assert len(fuzz.endpoint.peers) <= 8
        assert fuzz.endpoint._peers.remembered <= 24
        if number == 5:
            gc.collect()
            objects = len(gc.get_objects())
    gc.collect()
    assert len(gc.get_objects()) < objects + 2000
    assert fuzz.good > DATAGRAMS // 4
    assert fuzz.accidents <= 20 * DATAGRAMS / 2**16  # a checksum of 16 bits is right by chance now and then
    counters = fuzz.endpoint.counters
    assert min(counters.bad_crc, counters.unknown_id, counters.version_1, counters.oversize) > 20
    assert counters.undecodable == 0
    if fuzz.signer is not None:
        assert not fuzz.acts
        assert fuzz.endpoint._signer.streams == 1
        assert min(counters.unsigned, counters.bad_signature, counters.replayed) > 200
    else:
        assert sum(fuzz.acts.values()) > DATAGRAMS // 4


def traced_bytes():
    gc.collect()  # empties the interpreter's own stores of small objects too
    return tracemalloc.get_traced_memory()[0]


def test_memory_does_not_grow():
    fuzz = Fuzz(seed=1, key=KEY)
    fuzz.run(1000)
    tracemalloc.start()
    fuzz.run(500)
    first = traced_bytes()
    fuzz.run(2500)
    last = traced_bytes()
    tracemalloc.stop()
    fuzz.close()
    assert last - first < 50_000  # bytes; a leak of one small object a datagram would be more


def test_the_attack_would_be_noticed():
    """The same datagrams against a vehicle that nobody owns do change it."""
    fuzz = Fuzz(seed=2, rig=Rig())
    before = state(fuzz.rig)
    fuzz.run(4000)
    assert state(fuzz.rig) != before
    fuzz.close()
