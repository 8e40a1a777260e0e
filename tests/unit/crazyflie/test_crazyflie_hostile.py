"""Whatever a client or the radio sends, the Crazyflie bridge goes on, and nothing moves that should not."""

import math
import random
import subprocess
import sys

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.crazyflie.types import Order
from tests.crazyflie_firmware.bench import CLIENT, GROUND, OTHER, Bench
from tests.unit.mavlink.server.hostile import hostile

IDS = (11, 75, 76, 84, 0, 111, 4)


def message(chance, bench):
    id_ = chance.choice(IDS if chance.random() < 0.5 else tuple(mav.mavlink_map))
    return hostile(chance, id_, list(bench.node.commands.table))


@pytest.mark.parametrize("seed", range(4))
def test_no_message_stops_it(seed):
    chance = random.Random(seed)
    bench = Bench().offboard()
    for i in range(1500):
        sender = chance.choice((CLIENT, OTHER, GROUND, (0, 0), (255, 255)))
        bench.node.handle(message(chance, bench), sender, bench.now_s)
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
        wild = message(chance, bench)
        if getattr(wild, "command", 0) in (400, 185):
            continue
        bench.node.handle(wild, CLIENT, bench.now_s)
        bench.step()
    assert bench.sent == []


def test_a_stranger_can_neither_fly_it_nor_switch_its_motors_off():
    chance = random.Random(8)
    bench = Bench().offboard((0.1, 0.0, 0.0))
    for _ in range(1000):
        wild = message(chance, bench)
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
