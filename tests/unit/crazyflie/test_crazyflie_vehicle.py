"""The Crazyflie as a vehicle, tested with the firmware model on a simulated clock."""

import random

import pytest

from bridge.crazyflie.packets import Order
from bridge.crazyflie.rules import LOST_S, RECONNECT_S, Rules
from bridge.mavlink.server.profile import FlightMode
from tests.crazyflie_firmware.bench import CLIENT, GROUND, OTHER, Bench
from tests.crazyflie_firmware.firmware import Firmware
from tests.crazyflie_firmware.plant import Point
from tests.crazyflie_firmware.supervisor import State

pytestmark = pytest.mark.slow

ARMED = 128


@pytest.mark.parametrize("auto_arm", [True, False])
def test_arms_climbs_holds_lands_and_can_fly_again_without_a_restart(auto_arm):
    bench = Bench(Firmware(Point(0.5, -0.2), auto_arm=auto_arm)).hover()
    assert bench.firmware.plant.position == pytest.approx([0.5, -0.2, 0.5], abs=0.03)
    assert bench.last("HEARTBEAT").base_mode & ARMED
    assert bench.result(21) == 0
    assert bench.last("EXTENDED_SYS_STATE").landed_state == 2
    bench.until(lambda: not bench.vehicle.armed).step()
    assert bench.firmware.plant.on_surface
    assert not bench.firmware.plant.motors
    assert bench.orders(Order.STOP)
    assert bench.orders(Order.NOTIFY_STOP)
    bench.run(7.0)
    assert State.LOCKED not in [s for _, s in bench.firmware.supervisor.history]
    assert bench.last("EXTENDED_SYS_STATE").landed_state == 1
    bench.hover()
    assert bench.firmware.plant.position[2] == pytest.approx(0.5, abs=0.03)


def test_a_set_point_goes_out_once_and_never_again():
    bench = Bench().offboard((0.2, 0.0, 0.0))
    bench.run(0.5)
    before = len(bench.velocities())
    bench.run(1.0)
    assert len(bench.velocities()) - before == 100
    assert bench.velocities()[-1][1].velocity_enu_m_s == pytest.approx((0.0, 0.2, 0.0))
    stopped_s, bench.stream = bench.now_s, None
    bench.run(3.0)
    assert bench.velocities()[-1][0] <= stopped_s + 0.01
    history = {state: t - stopped_s for t, state in bench.firmware.supervisor.history}
    assert history[State.LEVEL_OUT] == pytest.approx(0.5, abs=0.06)
    assert history[State.LOCKED] == pytest.approx(2.0, abs=0.12)
    assert any("Set-points stopped" in text for text in bench.texts)
    assert any("supervisor has locked: restart" in text for text in bench.texts)
    assert not bench.vehicle.armed
    bench.command(400, 1.0)
    bench.run(0.1)
    assert any("Arming refused: supervisor has locked: restart" in text for text in bench.texts)


def test_lands_on_silence_when_told_to():
    bench = Bench(rules=Rules(land_on_silence=True)).offboard()
    bench.stream = None
    bench.until(lambda: not bench.vehicle.armed)
    assert any("No set-points: landing" in text for text in bench.texts)
    assert bench.firmware.plant.on_surface
    assert State.LOCKED not in [s for _, s in bench.firmware.supervisor.history]


def test_a_forced_disarm_that_is_not_seen_becomes_an_emergency_stop():
    bench = Bench().offboard()
    bench.stream, bench.disarm_lost, killed_s = None, True, bench.now_s
    bench.command(400, 0.0, 21196.0)
    bench.run(0.5)
    assert bench.orders(Order.EMERGENCY_STOP)[0] - killed_s == pytest.approx(0.2, abs=0.03)
    assert bench.firmware.supervisor.state is State.LOCKED
    assert any("emergency stop, restart needed" in text for text in bench.texts)


def test_flight_termination_is_an_emergency_stop_also_for_a_ground_station_and_while_deaf():
    bench = Bench().offboard()
    assert bench.result(185, 1.0, sender=OTHER) == 1
    bench.mute = True
    assert bench.result(185, 1.0, sender=GROUND) == 0
    bench.run(0.1)
    assert bench.firmware.supervisor.state is State.LOCKED
    assert not bench.firmware.plant.motors


def test_lands_when_no_client_is_left():
    bench = Bench().hover()
    bench.client_gone = True
    bench.until(lambda: not bench.vehicle.armed)
    assert any("No client for 3 s: landing" in text for text in bench.texts)
    assert bench.firmware.plant.on_surface


def test_a_silent_radio_is_said_and_nothing_is_said_in_its_name():
    bench = Bench().offboard()
    bench.mute, silent_s = True, bench.now_s
    bench.run(2.5)
    assert any("Radio silent for 0.5 s" in text for text in bench.texts)
    assert bench.times("LOCAL_POSITION_NED")[-1] <= silent_s + 0.01
    for kind in ("HEARTBEAT", "SYS_STATUS", "EXTENDED_SYS_STATE"):
        assert bench.times(kind)[-1] <= silent_s + LOST_S + 0.01
    bench.stream = None
    bench.run(1.0)
    assert bench.orders(Order.RECONNECT)[0] - silent_s == pytest.approx(RECONNECT_S, abs=0.05)
    assert not bench.vehicle.armed
    assert bench.vehicle.problems(bench.now_s)[0].startswith("no link to the Crazyflie: no packet")
    bench.mute = False
    bench.connect()
    bench.run(0.2)
    assert bench.times("HEARTBEAT")[-1] > bench.now_s - 0.2


def test_fast_set_points_are_cut_in_their_direction():
    bench = Bench(rules=Rules(speed_max_m_s=0.5)).offboard()
    bench.stream = (3.0, 4.0, 0.0)
    bench.run(0.05)
    assert bench.velocities()[-1][1].velocity_enu_m_s == pytest.approx((0.4, 0.3, 0.0))
    assert any("Set-point cut to 0.5 m/s" in text for text in bench.texts)


def test_the_supervisor_may_refuse_or_not_answer():
    bench = Bench(Firmware(auto_arm=False)).ready()
    bench.firmware.refuse_arming = True
    assert bench.command(400, 1.0) == []
    bench.run(0.1)
    assert [(r.command, r.result) for r in bench.replies] == [(400, 1)]
    assert any("Arming refused: the supervisor refused" in text for text in bench.texts)
    bench.firmware.packet = lambda raw, now_s: []
    bench.run(1.1)
    bench.command(400, 1.0, sender=CLIENT)
    bench.run(1.0)
    assert len(bench.orders(Order.ARM)) >= 5
    assert any("Arming failed: the supervisor did not answer" in text for text in bench.texts)
    assert [r.result for r in bench.replies] == [1, 1]


def test_a_take_off_that_something_holds_ends_in_a_landing():
    bench = Bench().armed()
    bench.firmware.plant.advance = lambda dt_s: None
    bench.command(22)
    bench.run(14.0)
    assert bench.vehicle.armed
    bench.run(4.0)
    assert not bench.vehicle.armed
    assert any("Take-off height not reached: landing" in text for text in bench.texts)
    assert "Landed, disarmed" in bench.texts


def test_nothing_takes_it_out_of_the_landing_of_a_bridge_that_ends():
    bench = Bench()
    bench.hover()
    bench.stream = (0.0, 0.0, 0.0)
    bench.vehicle.end(bench.now_s)
    bench.run(0.5)
    assert bench.result(176, 1.0, 6.0) == 1
    assert bench.result(22) == 1
    assert bench.vehicle.mode is FlightMode.LAND
    bench.until(lambda: not bench.vehicle.busy)
    assert bench.firmware.plant.on_surface
    bench.ready()
    assert bench.result(400, 1.0) == 1
    bench.run(0.5)
    assert "Mode offboard refused: the bridge ends" in bench.texts
    assert "Arming refused: the bridge ends" in bench.texts


def test_armed_and_left_alone_it_disarms():
    bench = Bench().armed()
    bench.run(9.5)
    assert bench.vehicle.armed
    bench.run(1.0)
    assert not bench.vehicle.armed
    assert "Disarmed: it does not fly" in bench.texts


@pytest.mark.parametrize("kill", [(400, 0.0, 21196.0), (185, 1.0)])
def test_a_kill_without_a_radio_is_done_when_it_is_back(kill):
    bench = Bench().offboard()
    bench.lose()
    bench.stream, bench.deaf = None, True
    bench.command(*kill)
    bench.run(0.3)
    assert any("motors off if it is back" in t or "waits for the radio" in t for t in bench.texts)
    assert bench.firmware.plant.motors
    bench.deaf = False
    bench.connect()
    bench.run(0.1)
    assert not bench.firmware.plant.motors
    assert bench.firmware.supervisor.state is State.LOCKED


def test_an_old_kill_does_not_stop_the_next_flight():
    bench = Bench()
    bench.lose()
    assert bench.result(400, 0.0, 21196.0) == 1
    bench.run(11.0)
    bench.connect()
    bench.hover()
    assert not bench.orders(Order.EMERGENCY_STOP)


@pytest.mark.parametrize("seed", range(2))
def test_a_radio_that_loses_every_fifth_packet_does_not_lock_it_at_the_end(seed):
    chance = random.Random(seed)
    bench = Bench().offboard()
    deliver = bench.firmware.packet
    bench.firmware.packet = lambda raw, now_s: [] if chance.random() < 0.2 else deliver(raw, now_s)
    bench.stream = None
    bench.command(400, 0.0, 21196.0)
    bench.run(0.3)
    assert not bench.firmware.plant.motors
    bench.run(6.0)
    assert State.LOCKED not in [s for _, s in bench.firmware.supervisor.history]


def test_hanging_in_an_updraught_is_not_standing():
    bench = Bench().offboard((0.0, 0.0, 0.08))
    advance = bench.firmware.plant.advance

    def held_up(dt_s):
        advance(dt_s)
        bench.firmware.plant.position[2], bench.firmware.plant.velocity[2] = 0.5, 0.0

    bench.firmware.plant.advance = held_up
    bench.run(15.0)
    assert bench.vehicle.armed
    assert not bench.vehicle.standing
    bench.stream = (0.0, 0.0, 0.25)
    bench.run(0.9)
    assert not bench.vehicle.standing


def test_a_take_off_that_ends_on_the_ground_says_why():
    bench = Bench().armed()
    bench.firmware.needs_poses = True  # no poses arrive, so there is no position
    bench.run(3.0)
    bench.command(22)
    bench.run(0.5)
    assert bench.vehicle.mode is FlightMode.HOLD
    assert bench.vehicle.standing
    assert "No position estimate: stays on the ground" in bench.texts
