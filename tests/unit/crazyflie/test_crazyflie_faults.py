"""Tests the bridge's reactions to faults of a Crazyflie's radio, clock, supervisor and motion capture."""

import math
import re
import struct
from itertools import pairwise

import pytest

from bridge.crazyflie.packets import Order
from bridge.crazyflie.pilot import UNPLACED_M_S
from bridge.crazyflie.rules import Rules
from bridge.crazyflie.state import LATE_MAX_S, BootClock
from bridge.mavlink.server.profile import FlightMode
from tests.crazyflie_firmware.bench import Bench
from tests.crazyflie_firmware.firmware import Firmware
from tests.crazyflie_firmware.plant import Point
from tests.crazyflie_firmware.supervisor import State

# The clock


@pytest.mark.parametrize("rate", [0.9, 0.97, 1.03])
def test_a_clock_of_any_rate_is_followed(rate):
    bench = Bench(Firmware(clock_rate=rate)).hover()
    begin_s = bench.now_s
    bench.run(20.0)
    since = [t for t in bench.times("LOCAL_POSITION_NED") if t > begin_s]
    assert bench.node.late == 0
    assert max(b - a for a, b in pairwise(since)) < 0.1
    assert bench.vehicle.mode is FlightMode.HOLD
    assert bench.now_s - bench.vehicle.state.at_s < 0.08


@pytest.mark.parametrize("stall_s", [0.2, 0.5, 0.9])
def test_a_clock_that_stalls_is_followed_within_half_a_second(stall_s):
    bench = Bench().offboard()
    for _ in range(3):
        stalled_s = bench.now_s
        bench.firmware.stall(stall_s)
        bench.run(stall_s + 0.6)
        assert bench.now_s - bench.vehicle.state.at_s < 0.03
        assert bench.times("LOCAL_POSITION_NED")[-1] > bench.now_s - 0.03
        assert bench.vehicle.armed, (stalled_s, bench.texts)


@pytest.mark.parametrize(("last_ms", "time_ms", "elapsed_s"), [
    (500_000, 200, 1.0), (9_000_000, 200, 4.0), (16_777_000, 900, 5.0), (3_000, 3_100, 60.0),
])  # fmt: skip
def test_a_restart_is_known_by_the_time_since_the_last_packet(last_ms, time_ms, elapsed_s):
    clock = BootClock()
    clock.take(last_ms, 1000.0)
    assert clock.take(time_ms, 1000.0 + elapsed_s) == (time_ms, 0.0)
    assert clock.restarts == 1


@pytest.mark.parametrize(("last_ms", "time_ms", "elapsed_s"), [
    (16_777_000, 4_784, 5.0), (500_000, 500_010, 5.0), (500_000, 504_850, 5.0), (500_000, 500_800, 0.01),
])  # fmt: skip
def test_a_wrap_a_pause_and_a_slow_clock_are_no_restart(last_ms, time_ms, elapsed_s):
    clock = BootClock()
    clock.take(last_ms, 1000.0)
    assert clock.take(time_ms, 1000.0 + elapsed_s) is not None
    assert clock.restarts == 0


@pytest.mark.parametrize("wrong_ms", [100, 300, 950, 5_000, -500, -5_000])
@pytest.mark.parametrize("stays", [False, True])
def test_a_known_clock_is_moved_by_no_single_packet_and_follows_those_that_agree(wrong_ms, stays):
    clock, usable_s = BootClock(), []
    for k in range(1_000):
        wrong = k == 500 or (stays and k > 500)
        timed = clock.take(60_000 + 10 * k + wrong_ms * wrong, 60.0 + 0.01 * k)
        if timed is not None and timed[1] <= LATE_MAX_S:
            usable_s.append(60.0 + 0.01 * k)
    gap_s = max(b - a for a, b in pairwise(usable_s))
    assert gap_s < (0.03 if wrong_ms > 0 or not stays or wrong_ms < -1_000 else 1.2)
    assert usable_s[-1] == 60.0 + 0.01 * 999


# The radio


@pytest.mark.parametrize("height_m", [0.3, 0.5, 1.5])
def test_a_blind_landing_ends_after_the_time_that_its_height_takes(height_m):
    bench = Bench().armed()
    bench.command(22, *[math.nan] * 6, height_m)
    bench.until(lambda: bench.vehicle.mode is FlightMode.HOLD).run(1.0)
    bench.mute, silent_s = True, bench.now_s
    bench.until(lambda: not bench.vehicle.armed)
    assert bench.now_s - silent_s < 1.0 + 1.2 * height_m / 0.25 + 1.2
    assert "Blind landing over: motors off" in bench.texts
    assert bench.firmware.plant.on_surface
    bench.run(0.1)
    assert not bench.firmware.plant.motors


def test_log_blocks_that_the_firmware_has_deleted_do_not_make_a_landing_blind():
    bench = Bench().hover()
    bench.firmware._blocks.clear()
    bench.mute = True
    bench.run(1.2)
    bench.mute = False
    bench.run(0.1)
    assert bench.vehicle.alive(bench.now_s)
    bench.until(lambda: not bench.vehicle.armed)
    assert "Landed, disarmed" in bench.texts
    assert not bench.orders(Order.RECONNECT)


@pytest.mark.parametrize("mode", [FlightMode.HOLD, FlightMode.LAND])
@pytest.mark.parametrize("away_s", [1.2, 2.5, None])
def test_a_landing_continues_while_the_link_is_opened_anew(mode, away_s):
    bench = Bench(Firmware(Point(0.0, 0.0))).hover()
    if mode is FlightMode.LAND:
        bench.command(21)
    bench.mute = True
    bench.lose()
    lost_s = bench.now_s
    if away_s is not None:
        bench.run(away_s)
        assert bench.velocities()[-1][0] > bench.now_s - 0.05
        bench.mute = False
        bench.connect()
    bench.until(lambda: not bench.vehicle.armed, 12.0).run(0.2)
    assert bench.firmware.plant.on_surface
    assert not bench.firmware.plant.motors
    assert State.LOCKED not in [s for _, s in bench.firmware.supervisor.history]
    assert ("Landed, disarmed" in bench.texts) is (away_s is not None), lost_s
    assert len(bench.times("HEARTBEAT")) > 0


def test_a_silent_radio_in_a_blind_landing_is_opened_anew_without_a_stop():
    bench = Bench(Firmware(Point(0.0, 0.0))).armed()
    bench.command(22, *[math.nan] * 6, 1.5)
    bench.until(lambda: bench.vehicle.mode is FlightMode.HOLD).run(1.0)
    bench.mute = True
    bench.run(3.2)
    assert bench.orders(Order.RECONNECT)
    assert not bench.orders(Order.STOP)
    assert bench.vehicle.armed


def test_a_kill_in_a_blind_landing_without_a_link_ends_it():
    bench = Bench().hover()
    bench.lose()
    bench.run(0.3)
    assert bench.result(400, 0.0, 21196.0) == 1
    assert not bench.vehicle.armed
    bench.run(0.2)
    assert bench.velocities()[-1][0] < bench.now_s - 0.15
    bench.connect()
    bench.run(0.2)
    assert bench.firmware.supervisor.state is State.LOCKED


@pytest.mark.parametrize("flown", ["hover", "offboard"])
@pytest.mark.parametrize("uptime_s", [0.0, 9_000.0])
def test_a_firmware_that_restarts_in_the_air_is_noticed(flown, uptime_s):
    firmware = Firmware()
    firmware._boot_s = -uptime_s
    bench = getattr(Bench(firmware), flown)()
    bench.firmware.restart()
    bench.until(lambda: bench.orders(Order.RECONNECT), 4.0).run(0.3)
    bench.connect()
    bench.run(0.2)
    assert any("it restarted" in text or "radio lost" in text for text in bench.texts)
    assert not bench.vehicle.armed
    assert not bench.firmware.plant.motors
    bench.stream = None
    bench.run(2.0)
    assert bench.hover().firmware.plant.position[2] == pytest.approx(0.5, abs=0.05)


def test_one_that_restarts_within_a_blind_landing_is_flown_no_more():
    bench = Bench().hover()
    bench.lose()
    bench.firmware._start()  # the firmware restarts immediately
    bench.run(0.5)
    assert bench.vehicle.armed
    bench.connect()
    bench.run(0.1)
    assert any("Disarmed: it restarted" in text for text in bench.texts)
    assert not bench.vehicle.armed


# Motion capture


class Posed(Bench):
    """Poses arrive through the bridge, or from another program."""

    def __init__(self, own: bool, tilt_deg: float = 0.0) -> None:
        self.own, self.poses = own, True
        half = math.radians(tilt_deg) / 2.0
        self.quaternion = (math.cos(half), 0.0, math.sin(half), 0.0)
        super().__init__(Firmware(Point(0.2, 0.1), needs_poses=True), Rules(mocap=own))

    def step(self) -> None:
        if self.poses:
            w, x, y, z = self.quaternion
            pose = struct.pack("<7f", *self.firmware.plant.position, x, y, z, w)
            self.firmware.packet(b"\x6d\x08" + pose, self.now_s)
        if self.own:
            self._posed()
        super().step()

    def _posed(self) -> None:
        from bridge.mocap.checks import Passed
        from bridge.ros2.cdr import Pose

        if not self.poses:
            self.vehicle.mocap("mocap: no pose for 0.3 s", None, self.now_s)
            return
        pose = Pose(0, "map", tuple(self.firmware.plant.position), self.quaternion)
        self.vehicle.mocap(None, Passed(pose, self.now_s, 0), self.now_s)


@pytest.mark.parametrize("own", [True, False])
def test_half_a_second_after_the_last_pose_the_position_is_not_known(own):
    bench = Posed(own).offboard()
    bench.poses, lost_s = False, bench.now_s
    bench.run(1.5)
    assert max(bench.vehicle.health.variance_m2) < 0.01
    assert bench.times("LOCAL_POSITION_NED")[-1] - lost_s == pytest.approx(0.5, abs=0.15)
    assert not bench.vehicle.sensors_healthy(bench.now_s)
    assert bench.result(176, 1.0, 4.0, 3.0) == 0
    bench.stream = None
    bench.until(lambda: not bench.vehicle.armed)
    assert "No position estimate: landing" in bench.texts
    assert ("mocap: no pose for 0.3 s" in bench.texts) is own
    assert bench.times("ATTITUDE")[-1] > bench.now_s - 0.1
    descent = {p.velocity_enu_m_s for t, p in bench.velocities() if t > lost_s + 1.6}
    assert descent == {(0.0, 0.0, -UNPLACED_M_S)}
    assert bench.firmware.plant.on_surface
    bench.poses = True
    bench.hover()


@pytest.mark.parametrize("own", [True, False])
@pytest.mark.parametrize(("tilt_deg", "refused"), [(0.0, False), (1.5, False), (3.0, True), (-20.0, True)])
def test_markers_tilted_against_the_body_are_refused_with_the_angle(own, tilt_deg, refused):
    bench = Posed(own, tilt_deg).run(3.0)
    found = bench.vehicle.problems(bench.now_s)
    if not refused:
        assert not found
        return
    said = re.match(r"markers are tilted by ([\d.]+) degrees against the body, 2 allowed: ", found[0])
    assert float(said[1]) == pytest.approx(abs(tilt_deg), abs=0.11)
    assert bench.result(400, 1.0) == 1
    bench.quaternion = (1.0, 0.0, 0.0, 0.0)
    bench.run(6.0).hover()


# The supervisor


@pytest.mark.slow
def test_firmware_that_arms_itself_anew_every_30_seconds_is_no_one_who_disarms():
    bench = Bench().ready()
    for offset_s in (-0.1, 0.05):
        left = [s for _, s in bench.firmware.supervisor.history].count(State.CHECKS_FAILED)
        ready_s = bench.firmware.supervisor.history[-1][0]
        bench.until(lambda due_s=ready_s + 30.04 + offset_s: bench.now_s >= due_s, 40.0)
        bench.hover().command(21)
        bench.until(lambda: not bench.vehicle.armed, 12.0).run(6.0)
        assert [s for _, s in bench.firmware.supervisor.history].count(State.CHECKS_FAILED) > left
    said = [text for text in bench.texts if "Disarmed: by" in text or "refused" in text or "failed" in text]
    assert not said
    assert bench.texts.count("Ready to arm") == 1


def test_after_a_crash_arming_it_once_recovers_it():
    bench = Bench().offboard()
    supervisor = bench.firmware.supervisor
    supervisor.tumbled = True
    bench.run(0.3)
    assert supervisor.state is State.CRASHED
    bench.stream = None
    assert bench.result(400, 1.0) == 1
    assert not bench.orders(Order.RECOVER), "on its back it is not recovered"
    supervisor.tumbled = False
    bench.run(0.5)
    assert bench.vehicle.problems(bench.now_s)[0].startswith("supervisor saw a crash")
    assert bench.result(400, 1.0) == 1
    bench.run(1.0)
    assert "Arming refused: crash recovery begun: look for damage, then arm again" in bench.texts
    assert not bench.vehicle.armed
    bench.until(lambda: bench.firmware.plant.on_surface).run(6.0).hover()
