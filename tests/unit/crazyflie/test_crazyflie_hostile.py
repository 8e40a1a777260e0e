"""Whatever a client or the radio sends, the Crazyflie bridge goes on, and nothing moves that should not."""

import math
import random
import subprocess
import sys

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.crazyflie.types import Order
from tests.crazyflie_firmware.bench import CLIENT, GROUND, OTHER, Bench

SPECIAL = (0.0, 1.0, -1.0, math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 21196.0, 4.0, 6.0, 0.5)
SIZES = {
    "uint8_t": 8, "uint16_t": 16, "uint32_t": 32, "uint64_t": 64, "int8_t": 7, "int16_t": 15, "int32_t": 31,
    "int64_t": 63, "char": 8,
}  # fmt: skip


def value(kind, length, chance):
    if kind == "char":
        return bytes(chance.randrange(256) for _ in range(max(1, length)))
    one = (
        (lambda: chance.choice(SPECIAL) if chance.random() < 0.7 else chance.uniform(-1e3, 1e3))
        if kind in ("float", "double")
        else (lambda: chance.choice((0, 1, 1, 2, 191, 255, chance.getrandbits(SIZES[kind]))))
    )
    limit = None if kind in ("float", "double") else (1 << SIZES[kind]) - 1
    draw = one if limit is None else (lambda: min(one(), limit))
    return [draw() for _ in range(length)] if length > 1 else draw()


def message(chance):
    ids = [11, 75, 76, 84, 0, 111, 4, *mav.mavlink_map]
    cls = mav.mavlink_map[chance.choice(ids[: chance.choice((7, len(ids)))])]
    kinds = dict(zip(cls.fieldnames, cls.fieldtypes, strict=True))
    lengths = dict(zip(cls.ordered_fieldnames, cls.lengths, strict=True))
    made = cls(*[value(kinds[name], lengths[name], chance) for name in cls.fieldnames])
    for name, own in (("target_system", 1), ("target_component", 1)):
        if hasattr(made, name) and chance.random() < 0.8:
            setattr(made, name, own)
    if hasattr(made, "command") and chance.random() < 0.9:
        made.command = chance.choice((400, 22, 21, 176, 185, 512, 511, 510, 410, 401))
    return made


@pytest.mark.parametrize("seed", range(4))
def test_no_message_stops_it(seed):
    chance = random.Random(seed)
    bench = Bench().offboard()
    for i in range(1500):
        sender = chance.choice((CLIENT, OTHER, GROUND, (0, 0), (255, 255)))
        bench.node.handle(message(chance), sender, bench.now_s)
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
        wild = message(chance)
        if getattr(wild, "command", 0) in (400, 185):
            continue
        bench.node.handle(wild, CLIENT, bench.now_s)
        bench.step()
    assert bench.sent == []


def test_a_stranger_can_neither_fly_it_nor_switch_its_motors_off():
    chance = random.Random(8)
    bench = Bench().offboard((0.1, 0.0, 0.0))
    for _ in range(1000):
        wild = message(chance)
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
