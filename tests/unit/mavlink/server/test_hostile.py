"""Nothing from the network can break the server, make it talk without end, or fly on broken numbers."""

from __future__ import annotations

import math
import random

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.texts import Texts
from tests.unit.mavlink.server.hostile import hostile
from tests.unit.mavlink.server.served import GROUND_STATION


@pytest.mark.parametrize("seed", range(4))
def test_nothing_from_the_network_raises_and_every_answer_can_be_sent(flown, seed: int) -> None:
    rng = random.Random(seed)
    link = mav.MAVLink(None, 1, 1)
    commands, sent = list(flown.server.commands.table), len(flown.telemetry)
    for id_ in [*mav.mavlink_map, *sorted(flown.server.handled) * 20]:
        for _ in range(5):
            sender = rng.choice(((1, 191), (255, 190), (rng.randrange(256), rng.randrange(256))))
            replies = flown.handle(hostile(rng, id_, commands), sender)
            assert len(replies) <= 2
            for reply in replies:
                reply.pack(link)
        flown.run(0.01)
        said, sent = flown.telemetry[sent:], len(flown.telemetry)
        for message in said:
            message.pack(link)
        assert len(said) < 150
        assert flown.velocity_enu_m_s is None or all(map(math.isfinite, flown.velocity_enu_m_s))


def test_a_flood_of_different_refusals_says_little(served) -> None:
    for tick in range(500):
        for number in range(20):
            served.command(10_000 + 20 * tick + number, sender=GROUND_STATION)
        served.run(0.01)
    texts = served.texts()
    assert 20 <= len([t for t in texts if t.endswith("not supported")]) <= 20 + 5 * 5 + 1
    assert any(t.endswith("refusals not shown") for t in texts)


def test_texts_waiting_are_bounded_and_the_same_refusal_comes_once_a_second() -> None:
    texts = Texts()
    for i in range(1000):
        texts.say(6, f"event {i}")
    assert len(texts.take()) == 64
    for tick in range(250):
        texts.refuse("no", 0.01 * tick)
    assert [t.text for t in texts.take()] == ["no"] * 3
    for i in range(1000):
        texts.refuse(f"no {i}", 100.0 + i)
    assert len(texts._said_s) <= 64


def test_texts_nobody_logs_do_not_pile_up(served) -> None:
    for i in range(1500):
        served.server.vehicle.texts.say(6, f"event {i}")
        served.tick()
    texts = served.server.take_texts()
    assert len(texts) == 1024
    assert texts[-1].text == "event 1499"


def test_asking_for_everything_at_the_highest_rate_is_bounded_by_the_loop(served) -> None:
    for id_ in mav.mavlink_map:
        served.command(511, float(id_), 1.0)
    served.run(0.05)
    before = len(served.telemetry)
    served.run(1.0)
    counts: dict[int, int] = {}
    for message in served.telemetry[before:]:
        counts[message.get_msgId()] = counts.get(message.get_msgId(), 0) + 1
    assert max(counts.values()) <= 100
    for _ in range(1000):
        served.handle(mav.MAVLink_param_request_list_message(1, 1))
    before = len(served.telemetry)
    served.run(0.01)
    assert len(served.telemetry) - before <= 20 + 30  # PARAM_VALUE is paced
