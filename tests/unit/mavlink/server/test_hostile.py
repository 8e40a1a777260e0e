"""Nothing from the network can break the server or its users, flood it, or make it fly on broken numbers."""

from __future__ import annotations

import math
import random
import subprocess
import sys

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.crazyflie.types import Order
from bridge.mavlink.server.texts import Texts
from tests.crazyflie_firmware.bench import CLIENT, GROUND, OTHER, Bench
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


IDS = (11, 75, 76, 84, 0, 111, 4)


def wild_message(chance, bench):
    id_ = chance.choice(IDS if chance.random() < 0.5 else tuple(mav.mavlink_map))
    return hostile(chance, id_, list(bench.node.commands.table))


@pytest.mark.parametrize("seed", range(4))
def test_no_message_stops_it(seed):
    chance = random.Random(seed)
    bench = Bench().offboard()
    for i in range(1500):
        sender = chance.choice((CLIENT, OTHER, GROUND, (0, 0), (255, 255)))
        bench.node.handle(wild_message(chance, bench), sender, bench.now_s)
        if i % 5 == 0:
            bench.step()
    bench.stream = None
    bench.run(5.0)
    for _, velocity in bench.velocities():
        assert math.hypot(*velocity.velocity_enu_m_s) <= 1.0 + 1e-9
        assert abs(velocity.yaw_rate_rad_s) <= 6.0
    assert len(bench.texts) < 2000


def test_disarmed_nothing_but_an_arming_lets_a_packet_out():
    chance = random.Random(7)
    bench = Bench().ready()
    bench.sent.clear()
    for _ in range(1500):
        wild = wild_message(chance, bench)
        if getattr(wild, "command", 0) in (400, 185):
            continue
        bench.node.handle(wild, CLIENT, bench.now_s)
        bench.step()
    assert bench.sent == []


def test_a_stranger_can_neither_fly_it_nor_switch_its_motors_off():
    chance = random.Random(8)
    bench = Bench().offboard((0.1, 0.0, 0.0))
    for _ in range(1000):
        wild = wild_message(chance, bench)
        if getattr(wild, "command", 0) == 21 or wild.get_type() == "SET_MODE":
            continue  # landing is for everybody
        if getattr(wild, "command", 0) == 176 and getattr(wild, "param2", 0.0) == 4.0:
            continue
        bench.node.handle(wild, OTHER, bench.now_s)
        bench.step()
    assert bench.vehicle.armed
    assert not {Order.STOP, Order.EMERGENCY_STOP, Order.DISARM} & {p for _, p in bench.sent}
    for _, velocity in bench.velocities()[-500:]:
        assert velocity.velocity_enu_m_s == pytest.approx((0.0, 0.1, 0.0))


def test_without_cflib_it_says_what_to_install():
    code = (
        "import sys; sys.modules['cflib'] = None; from flightstack.cli.main import main; "
        "main(['bridge', 'crazyflie', '--uri', 'usb://0'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0, check=False
    )
    assert done.returncode == 2
    assert "cflib is not installed: pip install 'crazyflie-flightstack[crazyflie]'" in done.stderr


def test_nothing_else_imports_cflib():
    code = (
        "import sys, flightstack.onboard.process, bridge.crazyflie, bridge.mocap; "
        "from flightstack.cli.main import VERBS, main; "
        "verbs = [main.get_command(None, name) for name in VERBS]; "
        "assert all(verbs); assert 'cflib' not in sys.modules"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0
