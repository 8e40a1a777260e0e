"""Words between the members of a team: late, lost by chance of their own, never in the same tick."""

from dataclasses import replace
from types import SimpleNamespace
from typing import NamedTuple

import pytest

from flightstack.core.parameters.fleet import Fleet
from logs.verdict.types import Outcome
from sim.runners.landing import land_team
from sim.runners.room import Words
from sim.scenarios.team import ExchangeLink
from tests.unit.fleet.fleet_helpers import FIELD, at, same, team_of


class Said(NamedTuple):
    """Stands in for a word: all that an exchange knows of it is when it arrives."""

    text: str
    arrival_s: float = 0.0


def words(number=3, seed=5, **link):
    """An exchange of words that are plain texts; a text arrives with its time."""
    exchange = Words(replace(team_of(*[FIELD] * number), exchange=ExchangeLink(**link)), seed)

    def told(tick, texts):
        outputs = [each and SimpleNamespace(own_word=Said(each)) for each in texts]
        return [tuple(tuple(word) for word in heard) for heard in exchange(tick, outputs)]

    return told


def test_a_word_is_heard_by_all_others_in_the_next_tick():
    exchange = words()
    assert exchange(0, ["a0", "b0", None]) == [
        (("b0", 0.01),), (("a0", 0.01),), (("a0", 0.01), ("b0", 0.01)),
    ]  # fmt: skip
    assert exchange(1, [None, None, None]) == [(), (), ()]


@pytest.mark.parametrize(("delay_s", "ticks"), [(0.0, 1), (0.01, 1), (0.011, 2), (0.03, 3), (0.1, 10)])
def test_words_are_late_by_whole_ticks(delay_s, ticks):
    exchange = words(2, delay_s=delay_s)
    heard = [exchange(tick, [f"a{tick}", None]) for tick in range(20)]
    assert all(own == () for own, _ in heard)
    for tick, (_, other) in enumerate(heard):
        wanted = tick + 1 - ticks  # what is heard with the next tick
        assert other == (((f"a{wanted}", (tick + 1) / 100.0),) if wanted >= 0 else ())


def lost(exchange, number, hearer, ticks=2000):
    """Ticks in which a hearer misses the word of the first member."""
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


def test_a_word_that_is_not_told_does_not_move_the_losses():
    exchange, found = words(2, loss=0.3), lost(words(2, loss=0.3), 2, 2, 100)
    heard = [exchange(tick, ["a" if tick % 2 else None, None])[1] for tick in range(100)]
    assert [tick for tick in range(1, 100, 2) if not heard[tick]] == [tick for tick in found if tick % 2]


@pytest.mark.slow
def test_the_members_of_a_team_hear_each_other():
    fleet = [Fleet(id=n, members=(1, 2)) for n in (1, 2)]
    members = [at(0.0, 0.0), at(9.0, 0.0)]
    members = [replace(m, onboard=replace(m.onboard, fleet=f)) for m, f in zip(members, fleet, strict=True)]
    team = replace(team_of(*members), exchange=ExchangeLink(0.02, 0.1))
    heard, exchange = [], Words(team, 1)

    def listening(tick, outputs):
        heard.append(exchange(tick, outputs))
        return heard[-1]

    flown = land_team(team, 1, exchange=listening)
    assert [landing.verdict.outcome for landing in flown.landings] == [Outcome.LANDED] * 2
    assert {word.id for one, _ in heard for word in one} == {2}
    assert {word.id for _, other in heard for word in other} == {1}
    again = land_team(team, 1)
    assert all(same(a, b) for a, b in zip(flown.landings, again.landings, strict=True))


@pytest.mark.slow
def test_without_each_other_s_words_nobody_of_a_fleet_lands():
    members = [at(0.0, 0.0), at(9.0, 0.0)]
    members = [
        replace(m, duration_max_s=12.0, onboard=replace(m.onboard, fleet=Fleet(id=n, members=(1, 2))))
        for n, m in enumerate(members, 1)
    ]
    flown = land_team(replace(team_of(*members), exchange=ExchangeLink(0.0, 1.0)), 1)
    assert all(landing.verdict.outcome is not Outcome.LANDED for landing in flown.landings)
