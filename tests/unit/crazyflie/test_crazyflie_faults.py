"""Tests the bridge's reactions to faults of clock and motion capture, and its firmware settings."""

from __future__ import annotations

import math
import re
import struct
from itertools import pairwise

import pytest

from bridge.crazyflie.packets import LATE_MAX_S, BootClock, SetParam
from bridge.crazyflie.pilot import UNPLACED_M_S
from bridge.crazyflie.rules import DRAG, ECHO_MAX_S, UNKNOWN_DRAG, Rules
from flightstack.cli.real import _drag_1_s
from flightstack.common.strict_toml import ConfigError
from tests.crazyflie_firmware.bench import Bench
from tests.crazyflie_firmware.firmware import Firmware
from tests.crazyflie_firmware.plant import Point
from tests.crazyflie_firmware.supervisor import State

# Faults of the clock


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


# Faults of motion capture


class Posed(Bench):
    """Vehicle whose poses arrive through the bridge, or from another program."""

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


# Faults that the supervisor reports


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


RULES = Rules(drag_1_s=(0.46, 0.46, 0.4), restore=True)
FOUND = {"stabilizer.estimator": 1.0, **dict.fromkeys(DRAG, 0.0)}


def test_the_drag_is_written_again_where_a_restart_has_lost_it():
    bench = Bench(rules=RULES).run(0.1)
    params = bench.firmware.params
    assert [params[name].value for name in DRAG] == [0.46, 0.46, 0.4]
    assert "kalman.dragB_z is 0.4" in bench.texts
    params[DRAG[0]].value = 0.0
    bench.lose()
    bench.connect()
    assert params[DRAG[0]].value == 0.46
    written = [packet.name for _, packet in bench.sent if isinstance(packet, SetParam)]
    assert [written.count(name) for name in DRAG] == [2, 1, 1]


def test_what_it_found_is_restored_once_and_waited_for_within_a_bound():
    bench = Bench(rules=RULES).run(0.1)
    settings, now_s = bench.vehicle.settings, bench.now_s
    assert dict(settings.leave(now_s)) == FOUND
    assert settings.leave(now_s) == []
    assert settings.busy(now_s + 0.9 * ECHO_MAX_S)
    assert not settings.busy(now_s + 1.1 * ECHO_MAX_S)
    for name in FOUND:
        assert settings.busy(now_s)
        settings.echoed(name)
    assert not settings.busy(now_s)


def test_a_firmware_that_cannot_be_told_its_drag_is_named():
    firmware = Firmware()
    for name in DRAG:
        del firmware.params[name]
    assert UNKNOWN_DRAG in Bench(firmware, RULES).run(0.1).texts
    assert UNKNOWN_DRAG not in Bench(firmware).run(0.1).texts


def test_the_drag_is_that_of_the_vehicle_file():
    assert _drag_1_s("crazyflie20") == pytest.approx((0.461, 0.461, 0.401), abs=0.001)
    assert _drag_1_s("none") is None
    with pytest.raises(ConfigError, match="crazyflie20"):
        _drag_1_s("crazyflie99")
