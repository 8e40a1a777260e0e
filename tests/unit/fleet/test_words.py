"""Tests messages between members: delays and losses are independent; messages arrive after their tick."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import open_session
from flightstack.common.hangup import Stop
from flightstack.common.pacing import EPOCH_NS, Tick
from flightstack.core.types import Intent, MemberStatus
from flightstack.onboard import lockstep
from flightstack.onboard.lockstep import LockstepStatuses
from sim import clock
from sim.clock import NoAnswerError, TickGrid
from sim.runners.room import MemberWords, Words
from sim.scenarios.tables import ExchangeLink
from tests.processes.bounded import wait_for
from tests.processes.ports import free_endpoint
from tests.unit.fleet.fleet_helpers import FIELD, team_of


def words(number=3, seed=5, **link):
    """Return the message exchange of a team; in these tests the messages are texts."""
    return Words(replace(team_of(*[FIELD] * number), exchange=ExchangeLink(**link)), seed)


def test_a_word_is_heard_by_all_others_in_the_next_tick():
    exchange = words()
    assert exchange(0, ["a0", "b0", None]) == [["b0"], ["a0"], ["a0", "b0"]]
    assert exchange(1, [None, None, None]) == [[], [], []]


@pytest.mark.parametrize(("delay_s", "ticks"), [(0.0, 1), (0.01, 1), (0.011, 2), (0.03, 3), (0.1, 10)])
def test_words_are_late_by_whole_ticks(delay_s, ticks):
    exchange = words(2, delay_s=delay_s)
    heard = [exchange(tick, [f"a{tick}", None]) for tick in range(20)]
    assert all(own == [] for own, _ in heard)
    for tick, (_, other) in enumerate(heard):
        wanted = tick + 1 - ticks  # number of the message that arrives now
        assert other == ([f"a{wanted}"] if wanted >= 0 else [])


def lost(exchange, number, hearer, ticks=2000):
    """Return the ticks in which receiver ``hearer`` misses the message of member 1."""
    words = [["a", *[None] * (number - 1)]] * ticks
    return [tick for tick, told in enumerate(words) if not exchange(tick, told)[hearer - 1]]


def test_words_are_lost_by_the_team_s_seed_and_not_by_the_number_of_members():
    found = lost(words(3, loss=0.1), 3, 2)
    assert 140 < len(found) < 260
    assert found == lost(words(3, loss=0.1), 3, 2)
    assert found == lost(words(5, loss=0.1), 5, 2)
    assert found != lost(words(3, loss=0.1), 3, 3)
    assert found != lost(words(3, seed=6, loss=0.1), 3, 2)
    assert len(lost(words(2, loss=1.0), 2, 2)) == 2000


GRID = TickGrid(100)
NAMES = ("cf1", "cf2", "cf3")


def word(id_, now_s, claim_s=float("nan")):
    place, away = (0.1 + id_, 1.0 / 3.0, 1.0), (1e-17, -0.0, 0.25)
    return MemberStatus(
        id_, now_s, now_s, place, away, away, 0.005, 0.0, Intent.LANDING, claim_s, place, None, (1, 3)
    )


@pytest.fixture
def ends():
    """Yield both ends of the message links of three members: vehicles and onboard processes."""
    endpoint = free_endpoint()
    ours, theirs = open_session(listen=[endpoint]), open_session(connect=[endpoint])
    wait_for(lambda: zenoh_link.transports(ours) == 1)
    vehicles = [MemberWords(ours, name) for name in NAMES]
    processes = [LockstepStatuses(theirs, name) for name in NAMES]
    for vehicle in vehicles:
        vehicle.await_listener(Stop())
    yield SimpleNamespace(vehicles=vehicles, processes=processes)
    for process in processes:
        process.close()
    theirs.close()
    ours.close()


def ticks(number):
    return [Tick(n, n * GRID.period_s, EPOCH_NS + GRID.ns(n), 0.0, 0.0) for n in range(number)]


def never():
    return False


def test_an_onboard_process_goes_on_without_words_that_do_not_come(ends, monkeypatch):
    process = ends.processes[2]
    first, second, third = ticks(3)
    process.await_tick(first, never)
    assert process.texts() == []
    monkeypatch.setattr(lockstep, "WORLD_SILENT_S", 0.0)
    for tick in (second, third):
        process.await_tick(tick, never)
        assert process.statuses() == ()
    assert process.texts() == ["fleet: no messages arrived with this tick: continuing without"]


def test_vehicles_whose_onboard_processes_do_not_listen_do_not_begin(monkeypatch):
    monkeypatch.setattr(clock, "STARTUP_S", 0.0)
    session = open_session()
    try:
        with pytest.raises(NoAnswerError, match="nobody subscribed to cf1/sim/fleet/heard within 0 s"):
            MemberWords(session, "cf1").await_listener(Stop())
    finally:
        session.close()


def test_who_leaves_is_gone_with_the_tick_after_its_last_one(ends):
    vehicle, process = ends.vehicles[0], ends.processes[0]
    first, second, _ = ticks(3)
    process.await_tick(first, never)
    process.say(word(1, 0.0))
    process.close()
    wait_for(lambda: vehicle._poll() or vehicle._last == 0)
    vehicle.tick = first.number
    assert not vehicle.left  # the reply of this tick may still be in transit
    assert vehicle.take(Stop())
    vehicle.tick = second.number
    assert vehicle.left
    assert vehicle.take(Stop()) is None
    ends.processes.remove(process)
