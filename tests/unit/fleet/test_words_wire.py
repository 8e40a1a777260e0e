"""Fleet messages in lockstep on Zenoh: sent in a tick, received with the next; leaving, silent members."""

import struct
from types import SimpleNamespace

import pytest

from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import open_session
from flightstack.common.hangup import Stop
from flightstack.common.pacing import LockstepClock, Silence
from flightstack.core.types import Intent, Neighbour
from flightstack.onboard import lockstep
from flightstack.onboard.lockstep import LockstepWords, joined, split
from logs.schema.rows import FleetWordRow
from sim.clock import NoAnswerError, TickGrid
from sim.runners import member_words as words_wire
from sim.runners.member_words import MemberWords
from sim.runners.room import Words
from sim.scenarios import team
from tests.processes.ports import free_endpoint
from tests.unit.target.ros2_helpers import until

GRID = TickGrid(100)
NAMES = ("cf1", "cf2", "cf3")


def word(id_, now_s, claim_s=float("nan")):
    place, away = (0.1 + id_, 1.0 / 3.0, 1.0), (1e-17, -0.0, 0.25)
    return Neighbour(
        id_, now_s, now_s, place, away, away, 0.005, 0.0, Intent.LANDING, claim_s, place, None, (1, 3)
    )


@pytest.fixture
def ends():
    """Both ends of the message links of three members: at the vehicles and at the onboard processes."""
    endpoint = free_endpoint()
    ours, theirs = open_session(listen=[endpoint]), open_session(connect=[endpoint])
    until(lambda: zenoh_link.transports(ours) == 1)
    vehicles = [MemberWords(ours, name) for name in NAMES]
    processes = [LockstepWords(theirs, name) for name in NAMES]
    for vehicle in vehicles:
        vehicle.await_listener(Stop())
    yield SimpleNamespace(vehicles=vehicles, processes=processes)
    for process in processes:
        process.close()
    theirs.close()
    ours.close()


def ticks(number):
    clock = LockstepClock(100)
    return [clock.tick(GRID.ns(tick)) for tick in range(number)]


def never():
    return False


def test_what_is_told_at_a_tick_is_heard_with_the_next_to_the_bit(ends):
    passed, before = Words(team.load("fleet_3"), 1), [None] * len(NAMES)
    for tick in ticks(5):
        heard = []
        for process in ends.processes:
            process.await_tick(tick, never)
            heard.append(process.words())
        said = [word(n, tick.now_s, tick.now_s / 3.0) for n in (1, 2, 3)]
        if tick.number == 2:
            said[1] = None  # it has nothing to say, and nobody waits for more
        for process, own in zip(ends.processes, said, strict=True):
            logged = process.say(own)
            assert (FleetWordRow.unpack(logged).id if logged else None) == (own.id if own else None)
        wanted = [tuple(w for w in before if w and w.id != n) for n in (1, 2, 3)]
        arrived = [tuple(w._replace(arrival_s=tick.now_s) for w in words) for words in wanted]
        assert [repr(words) for words in heard] == [repr(words) for words in arrived]
        before = said
        for vehicle in ends.vehicles:
            vehicle.tick = tick.number
        told = [vehicle.take(Silence(), Stop()) for vehicle in ends.vehicles]
        for vehicle, words in zip(ends.vehicles, passed.pass_on(tick.number, told), strict=True):
            vehicle.hear(words)


def test_who_leaves_is_gone_with_the_tick_after_its_last_one(ends):
    vehicle, process = ends.vehicles[0], ends.processes[0]
    first, second, _ = ticks(3)
    process.await_tick(first, never)
    process.say(word(1, 0.0))
    process.close()
    until(lambda: vehicle._poll() or vehicle._last == 0)
    vehicle.tick = first.number
    assert not vehicle.left  # its answer of this tick may still be on the other wire
    assert vehicle.take(Silence(), Stop())
    vehicle.tick = second.number
    assert vehicle.left
    assert vehicle.take(Silence(), Stop()) is None
    ends.processes.remove(process)


def test_who_dies_without_a_word_is_waited_for_once(ends):
    vehicle, process = ends.vehicles[1], ends.processes[1]
    looked = []

    class Impatient(Silence):
        def look(self):
            looked.append(super().look())
            return 2.0 * words_wire.COMPANION_SILENT_S

    vehicle.tick = 3
    assert vehicle.take(Impatient(), Stop()) is None
    assert len(looked) == 1
    vehicle.tick = 4
    assert vehicle.take(Impatient(), Stop()) is None
    assert len(looked) == 1
    process.await_tick(ticks(6)[5], never)
    process.say(word(2, 0.05))  # it was only slow
    until(lambda: vehicle._poll() or not vehicle._silent)
    vehicle.tick = 5
    assert vehicle.take(Silence(), Stop())


def test_an_onboard_process_goes_on_without_words_that_do_not_come(ends, monkeypatch):
    process = ends.processes[2]
    monkeypatch.setattr(lockstep, "LOST_RUN_MAX_S", 0.0)
    first, second, third = ticks(3)
    process.await_tick(first, never)
    assert process.texts() == []
    for tick in (second, third):
        process.await_tick(tick, never)
        assert process.words() == ()
    assert process.texts() == ["fleet: no words came with this tick: going on without"]


def test_vehicles_whose_onboard_processes_do_not_listen_do_not_begin(monkeypatch):
    monkeypatch.setattr(words_wire, "STARTUP_S", 0.0)
    session = open_session()
    try:
        with pytest.raises(NoAnswerError, match="nobody subscribed to cf1/sim/fleet/heard within 0 s"):
            MemberWords(session, "cf1").await_listener(Stop())
    finally:
        session.close()


def test_payloads_are_joined_and_split():
    payloads = [b"", b"a", bytes(300), b"\x00\x01"]
    assert list(split(joined(payloads))) == payloads
    assert joined([]) == b""
    with pytest.raises(struct.error):
        list(split(b"\x01"))
