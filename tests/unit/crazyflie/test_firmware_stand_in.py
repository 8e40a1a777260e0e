"""The stand-in for the firmware does what firmware 2026.08 was measured to do."""

from __future__ import annotations

import struct

import pytest

from tests.crazyflie_firmware.firmware import Firmware
from tests.crazyflie_firmware.plant import Point
from tests.crazyflie_firmware.supervisor import State

STEP_S = 0.01
NULL, ARM, DISARM, EMERGENCY, RECOVER = b"\xff", b"\x9d\x01\x01", b"\x9d\x01\x00", b"\x9d\x03", b"\x9d\x02"
LEVEL = (0.0, 0.0, 0.0, 1.0)


class Flown:
    """A firmware that is sent the same velocity and its own pose in every step."""

    def __init__(self, firmware: Firmware, pose: tuple[float, ...] | None = LEVEL) -> None:
        self.firmware, self.pose, self.now_s = firmware, pose, 0.0
        self.velocity: tuple[float, float, float] | None = None
        self.logs: list[bytes] = []
        firmware.params["stabilizer.estimator"].value = 2

    def run(self, seconds: float, packet: bytes = NULL) -> Flown:
        firmware = self.firmware
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            firmware.packet(packet, self.now_s)
            if self.pose is not None:
                pose = struct.pack("<7f", *firmware.plant.position, *self.pose)
                firmware.packet(b"\x6d\x08" + pose, self.now_s)
            if self.velocity is not None:
                firmware.packet(b"\x7c\x08" + struct.pack("<4f", *self.velocity, 0.0), self.now_s)
            self.logs = firmware.step(self.now_s)
        return self

    def fly(self, *velocity: float) -> Flown:
        self.velocity = (0.0, 0.0, 0.5)
        self.run(2.0).velocity = velocity
        return self

    def states(self) -> list[State]:
        return [state for _, state in self.firmware.supervisor.history]


def log(firmware: Firmware, name: str) -> float:
    return firmware._values()[name]


@pytest.mark.parametrize(("drag", "ratio"), [(0.0, 1.16), (0.46, 1.0)])
def test_its_velocity_is_too_high_by_the_drag_that_it_does_not_know(drag, ratio):
    firmware = Firmware(needs_poses=True)
    for i, name in enumerate(firmware.params):
        if name.startswith("kalman.dragB"):
            firmware.packet(b"\x2e" + struct.pack("<Hf", i, drag), 0.0)
    flown = Flown(firmware).fly(0.3, 0.0, 0.0).run(4.0)
    true_m_s = flown.firmware.plant.velocity[0]
    assert log(firmware, "stateEstimateZ.vx") / 1000.0 == pytest.approx(ratio * true_m_s, abs=0.005)
    assert true_m_s == pytest.approx(0.3 / ratio, abs=0.005)


def test_tilted_markers_make_it_drift():
    flown = Flown(Firmware(needs_poses=True), (0.0, 0.0087, 0.0, 1.0)).fly(0.0, 0.0, 0.0).run(4.0)
    assert flown.firmware.plant.velocity[0] == pytest.approx(-0.06, abs=0.015)  # 1 degree, nose down


def test_without_poses_it_drifts_and_is_not_aware_of_it_for_seconds():
    flown = Flown(Firmware(needs_poses=True)).fly(0.0, 0.0, 0.0).run(1.0)
    assert log(flown.firmware, "kalman.varPX") < 1e-4
    flown.pose = None
    before_m = flown.firmware.plant.position[0]
    flown.run(2.5)
    assert log(flown.firmware, "kalman.varPX") ** 0.5 == pytest.approx(0.095, abs=0.01)
    assert abs(flown.firmware.plant.position[0] - before_m) == pytest.approx(0.65, abs=0.1)
    assert log(flown.firmware, "kalman.varPX") < 0.01
    assert log(flown.run(0.3).firmware, "kalman.varPX") > 0.01


def test_at_rest_it_repeats_truncated_millimetres_and_shows_a_velocity():
    flown = Flown(Firmware(Point(0.0129, -0.0129), needs_poses=True))
    flown.run(3.0)
    said = [log(flown.firmware, f"stateEstimateZ.{axis}") for axis in ("x", "y", "vx", "vy")]
    assert said == [12, -12, 8, 0]


def test_log_blocks_are_deleted_after_a_second_of_silence():
    flown = Flown(Firmware())
    flown.firmware.packet(b"\x5d\x06\x01\x00\x00\x00", 0.0)
    flown.firmware.packet(b"\x5d\x03\x01\x01", 0.0)
    assert flown.run(0.5).logs
    sent_s = [i * STEP_S for i in range(200) if flown.firmware.step(flown.now_s + i * STEP_S)]
    assert sent_s[-1] == pytest.approx(1.0, abs=0.03)
    flown.now_s += 2.0
    assert not flown.run(0.5).logs
    assert flown.firmware.packet(b"\x5d\x03\x01\x01", flown.now_s) == [b"\x5d\x03\x01\x02"]


def test_it_restarts_in_the_air_and_arms_itself():
    flown = Flown(Firmware()).fly(0.0, 0.0, 0.0)
    assert flown.firmware.plant.position[2] > 0.5
    flown.firmware.restart()
    flown.velocity = None
    flown.run(2.9)
    assert flown.firmware.packet(b"\xff", flown.now_s) == []
    assert not flown.firmware.supervisor.armed
    assert flown.firmware.plant.on_surface
    assert flown.run(0.25).firmware.supervisor.state is State.READY
    assert flown.firmware.supervisor.armed


def test_it_arms_anew_every_30_seconds_for_120_ms():
    history = Flown(Firmware()).run(61.0).firmware.supervisor.history
    left = [i for i, (_, state) in enumerate(history) if state is State.CHECKS_FAILED]
    assert len(left) == 2
    for i in left:
        assert [state for _, state in history[i : i + 4]] == [
            State.CHECKS_FAILED, State.CHECKS_PASSED, State.ARMING, State.READY,
        ]  # fmt: skip
        assert history[i + 3][0] - history[i][0] == pytest.approx(0.12)
    assert history[left[1]][0] - history[left[0]][0] == pytest.approx(30.2, abs=0.1)


def test_the_supervisor_takes_the_ways_of_2026():
    disarmed = Flown(Firmware(auto_arm=False)).run(0.2)
    assert disarmed.firmware.supervisor.state is State.CHECKS_PASSED
    disarmed.run(STEP_S, ARM).run(0.2)
    assert disarmed.states()[-2:] == [State.ARMING, State.READY]
    assert disarmed.firmware.supervisor.info & 0xF == 0b1010
    disarmed.run(STEP_S, DISARM).run(0.2)
    assert disarmed.states()[-2:] == [State.CHECKS_FAILED, State.CHECKS_PASSED]
    disarmed.run(STEP_S, EMERGENCY).run(0.2)
    assert disarmed.states()[-2:] == [State.FREE_FALL, State.LOCKED]
    crashed = Flown(Firmware()).fly(0.0, 0.0, 0.0)
    supervisor = crashed.firmware.supervisor
    assert supervisor.info >> 8 == 0b0110
    supervisor.tumbled = True
    crashed.run(0.1).velocity = None
    crashed.run(2.5, b"\x7c\x00")
    assert supervisor.state is State.CRASHED
    assert crashed.firmware.packet(RECOVER, crashed.now_s) == [b"\x9d\x82\x00\x00"]
    supervisor.tumbled = False
    assert crashed.firmware.packet(RECOVER, crashed.now_s) == [b"\x9d\x82\x01\x01"]
    assert crashed.run(0.3, b"\x7d\x00").firmware.supervisor.state is State.READY


def test_the_watchdog_levels_out_and_goes_on_down():
    flown = Flown(Firmware()).fly(0.3, 0.0, 0.0).run(1.0).fly(0.3, 0.0, -0.2).run(0.5)
    flown.velocity = None
    flown.run(1.2)
    assert flown.firmware.supervisor.state is State.LEVEL_OUT
    assert flown.firmware.plant.velocity[2] == pytest.approx(-0.2, abs=0.01)


def test_a_simulator_of_2024_has_a_slow_clock_no_millivolts_and_may_stall():
    firmware = Firmware(protocol=7, clock_rate=0.97)
    assert "pm.vbatMV" not in [name for name, _ in firmware._log_toc.entries]
    flown = Flown(firmware)
    firmware.packet(b"\x5d\x06\x01\x00\x00\x00", 0.0)
    firmware.packet(b"\x5d\x03\x01\x01", 0.0)
    time_ms = lambda: int.from_bytes(flown.logs[-1][2:5], "little")  # noqa: E731
    begin_ms, _ = time_ms() if flown.run(1.03).logs else 0, flown.run(10.3)
    assert time_ms() - begin_ms == pytest.approx(9991, abs=25)
    before_ms = time_ms()
    firmware.stall(0.2)
    assert not flown.run(0.19).logs
    assert flown.run(0.12).logs
    assert time_ms() - before_ms == pytest.approx(97 + 10, abs=25)


def test_the_tables_can_be_as_long_as_the_real_ones():
    firmware = Firmware(tables=(567, 334))
    assert firmware.packet(b"\x5c\x03", 0.0)[0][2:4] == struct.pack("<H", 567)
    assert firmware.packet(b"\x2c\x03", 0.0)[0][2:4] == struct.pack("<H", 334)
