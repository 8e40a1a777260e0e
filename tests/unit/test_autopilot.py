"""The autopilot without sockets or clocks: modes, refusals, fail-safes in simulated time, validation."""

from __future__ import annotations

import math
import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.decoding import decode
from bridge.framing import split_frames
from sim.autopilot import Autopilot
from sim.autopilot_modes import CODES, FlightMode
from sim.autopilot_packing import Attitude, LocalPositionNed
from tests.unit.autopilot_fakes import FEET_M, NAN, FakeVehicle

RATE_HZ = 100
COMPANION = (1, 191)
GROUND_STATION = (255, 190)
OFFBOARD = (1.0, 6.0, 0.0)
HOLD = (1.0, 4.0, 3.0)


class Rig:
    """An autopilot on a fake vehicle, with time."""

    def __init__(self, **vehicle: object) -> None:
        self.vehicle = FakeVehicle(**vehicle)  # type: ignore[arg-type]
        self.autopilot = Autopilot(self.vehicle, RATE_HZ)
        self.tick = 0
        self.telemetry: list = []

    @property
    def now_s(self) -> float:
        return self.tick / RATE_HZ

    @property
    def mode(self) -> FlightMode:
        return self.autopilot.flight.mode

    def handle(self, message, sender=COMPANION) -> list:
        return self.autopilot.handle(message, sender, self.now_s)

    def run(self, duration_s: float, velocity_ned=None, sender=COMPANION) -> None:
        for _ in range(round(duration_s * RATE_HZ)):
            self.telemetry += self.autopilot.telemetry(self.now_s)
            if velocity_ned is not None:
                self.handle(setpoint(*velocity_ned), sender)
            self.autopilot.control(self.now_s)
            self.vehicle.advance(1.0 / RATE_HZ)
            self.tick += 1

    def command(self, number: int, *params: float, sender=COMPANION, target=(1, 1)) -> int | None:
        values = [*params, *[NAN] * (7 - len(params))]
        replies = self.handle(mav.MAVLink_command_long_message(*target, number, 0, *values), sender)
        acks = [r for r in replies if r.get_msgId() == mav.MAVLINK_MSG_ID_COMMAND_ACK]
        assert all((a.target_system, a.target_component, a.command) == (*sender, number) for a in acks)
        return acks[0].result if acks else None

    def texts(self) -> list[str]:
        self.telemetry += self.autopilot.telemetry(self.now_s)
        return [t.text for t in self.autopilot.take_texts()]

    def fly(self, height_m: float = 0.5) -> Rig:
        assert self.command(400, 1.0) == mav.MAV_RESULT_ACCEPTED
        assert self.command(22, *[NAN] * 6, height_m) == mav.MAV_RESULT_ACCEPTED
        self.run(6.0)
        assert self.mode is FlightMode.HOLD
        assert abs(self.vehicle.state.position_enu_m[2] - height_m) < 0.05
        return self

    def offboard(self) -> Rig:
        self.fly()
        self.run(0.1, (0.0, 0.0, 0.0))
        assert self.command(176, *OFFBOARD) == mav.MAV_RESULT_ACCEPTED
        return self

    def seen(self, message_id: int) -> list:
        return [m for m in self.telemetry if m.get_msgId() == message_id]


def setpoint(n=0.0, e=0.0, d=0.0, *, frame=1, mask=2503, yaw=0.0, rate=0.0, target=(1, 1)):
    zeros = (0.0, 0.0, 0.0)
    return mav.MAVLink_set_position_target_local_ned_message(
        0, *target, frame, mask, *zeros, n, e, d, *zeros, yaw, rate
    )


def test_heartbeat_comes_once_a_second_and_at_once_on_a_change() -> None:
    rig = Rig()
    rig.run(3.0)
    beats = rig.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)
    assert len(beats) == 3
    assert (beats[0].autopilot, beats[0].base_mode, beats[0].custom_mode) == (12, 29, 0x03040000)
    assert beats[0].system_status == mav.MAV_STATE_STANDBY
    rig.run(0.33)
    rig.telemetry.clear()
    rig.command(400, 1.0)
    rig.run(0.01)
    (beat,) = rig.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)
    assert beat.base_mode == 157
    assert beat.system_status == mav.MAV_STATE_ACTIVE


def test_mode_codes_are_those_of_px4() -> None:
    assert {m: c.custom_mode for m, c in CODES.items()} == {
        FlightMode.HOLD: 0x03040000,
        FlightMode.TAKEOFF: 0x02040000,
        FlightMode.LAND: 0x06040000,
        FlightMode.OFFBOARD: 0x00060000,
    }


def test_position_and_attitude_come_at_every_tick_in_ned() -> None:
    rig = Rig()
    rig.vehicle.state.position_enu_m = (1.0, 2.0, FEET_M)
    rig.run(0.5)
    positions = rig.seen(mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
    assert len(positions) == len(rig.seen(mav.MAVLINK_MSG_ID_ATTITUDE)) == 50
    assert (positions[0].x, positions[0].y, positions[0].z) == (2.0, 1.0, pytest.approx(-FEET_M))
    attitude = rig.seen(mav.MAVLINK_MSG_ID_ATTITUDE)[0]
    assert attitude.yaw == pytest.approx(math.pi / 2)  # nose to the east
    assert attitude.roll == pytest.approx(0.0)
    assert [m.time_boot_ms for m in positions[:3]] == [0, 10, 20]


def test_what_clients_wait_for_is_there_in_the_first_two_seconds() -> None:
    rig = Rig()
    rig.run(2.0)
    status = rig.seen(mav.MAVLINK_MSG_ID_SYS_STATUS)[-1]
    wanted = 1 | 2 | 4 | 32  # gyro, accelerometer, magnetometer, GPS
    assert status.onboard_control_sensors_health & wanted == wanted
    assert status.onboard_control_sensors_health & mav.MAV_SYS_STATUS_PREARM_CHECK
    home = rig.seen(mav.MAVLINK_MSG_ID_HOME_POSITION)[0]
    assert home.altitude == 0
    for name in ("GLOBAL_POSITION_INT", "BATTERY_STATUS", "EXTENDED_SYS_STATE", "ATTITUDE_QUATERNION"):
        assert rig.seen(getattr(mav, f"MAVLINK_MSG_ID_{name}")), name


def test_no_estimate_clears_health_and_refuses_arming_and_take_off() -> None:
    rig = Rig()
    rig.vehicle.state.valid = False
    rig.run(0.3)
    status = rig.seen(mav.MAVLINK_MSG_ID_SYS_STATUS)[-1]
    assert not status.onboard_control_sensors_health & (32 | mav.MAV_SYS_STATUS_PREARM_CHECK)
    assert rig.command(400, 1.0) == mav.MAV_RESULT_TEMPORARILY_REJECTED
    assert rig.command(22) == mav.MAV_RESULT_TEMPORARILY_REJECTED
    assert rig.texts() == ["Arming refused: no position estimate", "Take-off refused: no position estimate"]
    assert not rig.vehicle.armed


def test_firmware_refusal_is_passed_on_with_its_reason() -> None:
    rig = Rig(arm_refusal="battery low")
    assert rig.command(400, 1.0) == mav.MAV_RESULT_TEMPORARILY_REJECTED
    assert rig.texts() == ["Arming refused: battery low"]
    assert len(rig.seen(mav.MAVLINK_MSG_ID_STATUSTEXT)) == 1


def test_take_off_climbs_at_half_a_metre_a_second_at_most_and_holds() -> None:
    rig = Rig()
    rig.command(400, 1.0)
    rig.command(22, *[NAN] * 6, 1.0)
    fastest = 0.0
    for _ in range(800):
        rig.run(0.01)
        fastest = max(fastest, rig.vehicle.state.velocity_enu_m_s[2])
    assert 0.4 < fastest <= 0.5 + 1e-9
    assert rig.mode is FlightMode.HOLD
    assert rig.vehicle.state.position_enu_m[2] == pytest.approx(1.0, abs=0.03)


def test_take_off_without_a_height_takes_the_parameter_and_order_does_not_matter() -> None:
    rig = Rig()
    assert rig.command(22) == mav.MAV_RESULT_ACCEPTED  # QGroundControl arms after this
    assert rig.mode is FlightMode.TAKEOFF
    assert rig.vehicle.setpoints == 0
    assert rig.command(400, 1.0) == mav.MAV_RESULT_ACCEPTED
    rig.run(6.0)
    assert rig.vehicle.state.position_enu_m[2] == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("height_m", [0.0, -1.0, 0.05, 20.5])
def test_take_off_heights_out_of_range_are_refused(height_m: float) -> None:
    rig = Rig()
    rig.command(400, 1.0)
    assert rig.command(22, *[NAN] * 6, height_m) == mav.MAV_RESULT_TEMPORARILY_REJECTED
    assert "Take-off refused" in rig.texts()[-1]


def test_infinite_parameters_and_nan_disguised_as_an_integer_are_denied() -> None:
    rig = Rig()
    assert rig.command(22, *[NAN] * 6, math.inf) == mav.MAV_RESULT_DENIED
    nan_int = mav.MAVLink_command_int_message(
        1, 1, 0, 22, 0, 0, NAN, NAN, NAN, NAN, 0x7FF80000, 0x7FF80000, 1.0
    )
    assert rig.handle(nan_int)[0].result == mav.MAV_RESULT_DENIED
    assert rig.mode is FlightMode.HOLD


def test_command_int_does_the_same_as_command_long() -> None:
    rig = Rig()
    arm = mav.MAVLink_command_int_message(1, 1, 0, 400, 0, 0, 1.0, 0.0, NAN, NAN, 0, 0, NAN)
    assert rig.handle(arm)[0].result == mav.MAV_RESULT_ACCEPTED
    assert rig.vehicle.armed


def test_repeated_commands_are_accepted_and_change_nothing() -> None:
    rig = Rig()
    assert rig.command(400, 0.0) == mav.MAV_RESULT_ACCEPTED  # disarmed already
    for _ in range(3):
        assert rig.command(400, 1.0) == mav.MAV_RESULT_ACCEPTED
    for _ in range(3):
        assert rig.command(22, *[NAN] * 6, 0.5) == mav.MAV_RESULT_ACCEPTED
        rig.run(0.2)
    assert rig.texts() == ["Armed", "Mode take-off"]
    rig.run(5.0)
    rig.run(0.1, (0.0, 0.0, 0.0))
    for _ in range(3):
        assert rig.command(176, *OFFBOARD) == mav.MAV_RESULT_ACCEPTED
    for _ in range(3):
        assert rig.command(21) == mav.MAV_RESULT_ACCEPTED
    assert rig.texts() == ["Mode hold", "Mode offboard", "Mode land"]


@pytest.mark.parametrize(("number", "result"), [(31000, 3), (20, 3), (241, 3)])
def test_unknown_commands_are_unsupported(number: int, result: int) -> None:
    rig = Rig()
    assert rig.command(number) == result
    assert rig.texts() == [f"Command {number} is not supported"]


@pytest.mark.parametrize("param", [NAN, 2.0, -1.0])
def test_arm_command_that_says_neither_is_unsupported(param: float) -> None:
    rig = Rig()
    assert rig.command(400, param) == mav.MAV_RESULT_UNSUPPORTED
    assert not rig.vehicle.armed


@pytest.mark.parametrize("target", [(2, 1), (1, 50), (0, 1), (0, 0)])
def test_commands_for_others_are_not_even_answered(target: tuple[int, int]) -> None:
    rig = Rig()
    assert rig.command(400, 1.0, target=target) is None
    assert not rig.vehicle.armed


def test_component_zero_means_us_and_system_zero_may_ask_who_is_there() -> None:
    rig = Rig()
    assert rig.command(400, 1.0, target=(1, 0)) == mav.MAV_RESULT_ACCEPTED
    assert rig.command(512, 148.0, target=(0, 0)) == mav.MAV_RESULT_ACCEPTED


def test_disarming_in_the_air_needs_force() -> None:
    rig = Rig().fly()
    assert rig.command(400, 0.0) == mav.MAV_RESULT_TEMPORARILY_REJECTED
    assert rig.texts()[-1] == "Disarming refused: not landed"
    assert rig.vehicle.armed
    assert rig.command(400, 0.0, 21196.0) == mav.MAV_RESULT_ACCEPTED
    assert not rig.vehicle.armed


def test_forced_arming_does_not_skip_the_checks() -> None:
    rig = Rig()
    rig.vehicle.state.valid = False
    assert rig.command(400, 1.0, 21196.0) == mav.MAV_RESULT_TEMPORARILY_REJECTED


def test_termination_only_when_armed() -> None:
    rig = Rig()
    assert rig.command(185, 1.0) == mav.MAV_RESULT_DENIED
    rig.fly()
    assert rig.command(185, 1.0) == mav.MAV_RESULT_ACCEPTED
    assert not rig.vehicle.armed


def test_offboard_needs_a_living_stream() -> None:
    rig = Rig().fly()
    assert rig.command(176, *OFFBOARD) == mav.MAV_RESULT_TEMPORARILY_REJECTED
    assert rig.texts()[-1] == "Mode offboard refused: no set-points"
    rig.run(0.1, (1.0, 0.0, 0.0))
    assert rig.vehicle.setpoint is not None
    assert math.hypot(*rig.vehicle.setpoint[:2]) < 0.05  # streaming alone moves nothing
    rig.run(0.6)
    assert rig.command(176, *OFFBOARD) == mav.MAV_RESULT_TEMPORARILY_REJECTED
    rig.run(0.1, (0.0, 0.0, 0.0))
    assert rig.command(176, *OFFBOARD) == mav.MAV_RESULT_ACCEPTED
    rig.run(0.02)
    beat = rig.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)[-1]
    assert (beat.base_mode, beat.custom_mode) == (145, 393216)


def test_offboard_hands_on_each_set_point_once_in_enu() -> None:
    rig = Rig().offboard()
    rig.run(0.01)
    before = rig.vehicle.setpoints
    rig.handle(setpoint(0.1, 0.2, -0.3, yaw=0.0))
    rig.run(0.05)
    assert rig.vehicle.setpoints == before + 1
    assert rig.vehicle.setpoint == pytest.approx((0.2, 0.1, 0.3))
    assert rig.vehicle.yaw_rad == pytest.approx(math.pi / 2)  # nose to the north


def test_body_frame_is_turned_by_the_heading_only() -> None:
    rig = Rig().offboard()
    rig.vehicle.state.quaternion = (math.cos(math.pi / 4), 0.0, 0.0, math.sin(math.pi / 4))  # nose north
    rig.handle(setpoint(1.0, 0.5, 0.25, frame=8))
    rig.run(0.01)
    assert rig.vehicle.setpoint == pytest.approx((0.5, 1.0, -0.25))


def test_yaw_rate_is_integrated_and_no_yaw_holds_the_heading() -> None:
    rig = Rig().offboard()
    rig.handle(setpoint(mask=3527))
    rig.run(0.02)
    assert rig.vehicle.yaw_rad == pytest.approx(0.0)
    for _ in range(100):
        rig.handle(setpoint(mask=1479, rate=0.5))
        rig.run(0.01)
    assert rig.vehicle.yaw_rad == pytest.approx(-0.5, abs=0.01)  # clockwise in NED


@pytest.mark.parametrize(
    "bad",
    [
        setpoint(NAN),
        setpoint(0.0, math.inf),
        setpoint(0.0, 0.0, 5.01),
        setpoint(4.0, 4.0),
        setpoint(mask=0),
        setpoint(mask=2552),  # position
        setpoint(mask=2503 | 8),  # only two of three axes
        setpoint(mask=2503 & ~64),  # with acceleration
        setpoint(frame=7),
        setpoint(frame=9),
        setpoint(frame=12),
        setpoint(yaw=NAN),
        setpoint(mask=1479, rate=NAN),
        setpoint(mask=1479, rate=100.0),
    ],
)
def test_bad_set_points_are_dropped_with_one_text_and_keep_no_stream_alive(bad) -> None:
    rig = Rig().offboard()
    rig.handle(setpoint(0.1))
    rig.run(0.01)
    rig.texts()
    good = rig.vehicle.setpoint
    for _ in range(45):
        rig.handle(bad)
        rig.run(0.01)
        assert rig.vehicle.setpoint == good
    assert len([t for t in rig.texts() if t.startswith("Set-point dropped")]) == 1
    rig.handle(bad)
    rig.run(0.1)
    assert rig.mode is FlightMode.LAND


@pytest.mark.parametrize("mask", [2503, 1479, 3527, 4039])
def test_masks_that_clients_use_are_taken(mask: int) -> None:
    rig = Rig().offboard()
    rig.handle(setpoint(0.1, mask=mask))
    rig.run(0.01)
    assert rig.vehicle.setpoint == pytest.approx((0.0, 0.1, 0.0))


def test_set_points_for_another_vehicle_are_ignored() -> None:
    rig = Rig().offboard()
    rig.run(0.01)
    rig.handle(setpoint(1.0, target=(2, 1)))
    rig.run(0.01)
    assert rig.vehicle.setpoint == pytest.approx((0.0, 0.0, 0.0))


def test_one_sender_has_control_until_it_falls_silent() -> None:
    rig = Rig().offboard()
    rig.texts()
    for _ in range(20):
        rig.handle(setpoint(0.1))
        rig.handle(setpoint(0.0, 1.0), GROUND_STATION)
        rig.run(0.01)
        assert rig.vehicle.setpoint == pytest.approx((0.0, 0.1, 0.0))
    assert rig.texts() == ["Set-point dropped: 1/191 has control"]
    rig.run(0.45)
    assert rig.mode is FlightMode.OFFBOARD  # not lost yet, but the intruder is still refused
    rig.handle(setpoint(0.0, 1.0), GROUND_STATION)
    rig.run(0.2)
    assert rig.mode is FlightMode.LAND
    rig.run(0.1, (0.0, 0.2, 0.0), GROUND_STATION)
    assert rig.command(176, *OFFBOARD, sender=GROUND_STATION) == mav.MAV_RESULT_ACCEPTED
    rig.run(0.1, (0.0, 0.2, 0.0), GROUND_STATION)
    assert rig.vehicle.setpoint == pytest.approx((0.2, 0.0, 0.0))


def test_anyone_may_land_the_vehicle() -> None:
    rig = Rig().offboard()
    assert rig.command(21, sender=GROUND_STATION) == mav.MAV_RESULT_ACCEPTED
    assert rig.mode is FlightMode.LAND


@pytest.mark.parametrize("limit_s", [0.5, 0.3])
def test_loss_of_set_points_lands_and_disarms_in_simulated_time(limit_s: float) -> None:
    rig = Rig()
    set_real(rig, "COM_OF_LOSS_T", limit_s)
    rig.offboard()
    rig.run(1.0, (0.2, 0.0, 0.0))
    lost_s = rig.now_s - 0.01
    while rig.mode is FlightMode.OFFBOARD:
        rig.run(0.01)
    assert rig.now_s - 0.01 - lost_s == pytest.approx(limit_s + 0.01, abs=0.005)
    assert f"No set-points for {limit_s:g} s: landing" in rig.texts()
    assert rig.autopilot.flight.failsafe
    slowest = 0.0
    while rig.vehicle.armed:
        rig.run(0.01)
        slowest = min(slowest, rig.vehicle.state.velocity_enu_m_s[2])
        assert rig.now_s < lost_s + 6.0
    assert slowest == pytest.approx(-0.3, abs=0.02)
    assert rig.vehicle.state.position_enu_m[2] == pytest.approx(FEET_M)
    assert rig.texts()[-2:] == ["Landed, disarmed", "Mode hold"]
    beats = [b.system_status for b in rig.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)]
    assert mav.MAV_STATE_CRITICAL in beats
    assert beats[-1] == mav.MAV_STATE_STANDBY


def test_stream_that_comes_back_does_not_take_over_by_itself() -> None:
    rig = Rig().offboard()
    rig.run(0.6)
    assert rig.mode is FlightMode.LAND
    rig.run(0.3, (0.0, 0.0, -1.0))
    assert rig.mode is FlightMode.LAND
    assert rig.vehicle.setpoint[2] < 0.0


def test_landing_waits_for_lasting_contact_and_works_on_the_pad() -> None:
    rig = Rig().fly()
    rig.command(21)
    rig.run(0.5)
    rig.vehicle.on_pad = True  # a bounce
    rig.run(0.2)
    rig.vehicle.on_pad = False
    rig.run(0.05)
    assert rig.vehicle.armed
    rig.vehicle.on_pad = True
    rig.run(0.29)
    assert rig.vehicle.armed
    rig.run(0.03)
    assert not rig.vehicle.armed


def test_landed_state_follows_mode_and_contact() -> None:
    rig = Rig()
    rig.run(0.1)
    states = [rig.autopilot.flight.landed_state]
    rig.command(400, 1.0)
    rig.command(22)
    rig.run(1.0)
    states.append(rig.autopilot.flight.landed_state)
    rig.run(5.0)
    states.append(rig.autopilot.flight.landed_state)
    rig.command(21)
    rig.run(0.5)
    states.append(rig.autopilot.flight.landed_state)
    rig.run(4.0)
    states.append(rig.autopilot.flight.landed_state)
    assert states == [1, 3, 2, 4, 1]
    shown = [m.landed_state for m in rig.seen(mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)]
    assert [s for i, s in enumerate(shown) if i == 0 or shown[i - 1] != s] == states


def test_lost_estimate_in_flight_lands_without_a_position() -> None:
    rig = Rig().fly()
    rig.vehicle.state.valid = False
    rig.run(0.45)
    assert rig.mode is FlightMode.HOLD
    rig.run(1.0)
    assert rig.mode is FlightMode.LAND
    assert rig.vehicle.setpoint == pytest.approx((0.0, 0.0, -0.3), abs=0.02)
    assert "No position estimate: landing" in rig.texts()


def test_disarms_itself_when_nothing_happens_and_after_landing_in_offboard() -> None:
    rig = Rig()
    rig.command(400, 1.0)
    rig.run(9.9)
    assert rig.vehicle.armed
    rig.run(0.2)
    assert not rig.vehicle.armed
    assert "Disarmed: no take-off" in rig.texts()
    rig.offboard()
    rig.run(3.5, (0.0, 0.0, 0.3))
    assert rig.vehicle.armed
    rig.run(1.5, (0.0, 0.0, 0.3))
    assert not rig.vehicle.armed
    assert rig.mode is FlightMode.OFFBOARD  # until its stream ends
    rig.run(0.6)
    assert rig.mode is FlightMode.HOLD


def test_firmware_that_disarms_is_noticed() -> None:
    rig = Rig().fly()
    rig.vehicle.armed = False
    rig.run(0.02)
    assert "Disarmed by the firmware" in rig.texts()
    assert not rig.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)[-1].base_mode & 128


def test_vehicle_that_starts_in_the_air_is_held_there() -> None:
    vehicle = FakeVehicle(armed=True, on_ground=False)
    vehicle.state.position_enu_m = (1.0, 2.0, 1.5)
    rig = Rig()
    rig.vehicle, rig.autopilot = vehicle, Autopilot(vehicle, RATE_HZ)
    rig.run(3.0)
    assert vehicle.state.position_enu_m == pytest.approx((1.0, 2.0, 1.5), abs=0.02)
    assert rig.seen(mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)[0].landed_state == 2
    assert rig.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)[0].base_mode == 157


def test_hold_takes_over_a_moving_vehicle_without_a_step() -> None:
    rig = Rig().offboard()
    rig.run(2.0, (0.4, 0.0, 0.0))
    assert rig.command(176, *HOLD) == mav.MAV_RESULT_ACCEPTED
    rig.run(0.01)
    assert rig.vehicle.setpoint == pytest.approx((0.0, 0.4, 0.0), abs=0.02)
    rig.run(8.0)
    assert math.hypot(*rig.vehicle.state.velocity_enu_m_s) < 0.02


def test_set_mode_message_and_modes_that_do_not_exist() -> None:
    rig = Rig().fly()
    assert rig.handle(mav.MAVLink_set_mode_message(1, 1, 0x06040000)) == []
    assert rig.mode is FlightMode.LAND
    assert rig.command(176, 1.0, 3.0, 0.0) == mav.MAV_RESULT_DENIED
    assert rig.command(176, 0.0, 4.0, 3.0) == mav.MAV_RESULT_DENIED
    assert rig.mode is FlightMode.LAND


def test_message_intervals_are_bounded_by_the_loop_and_can_be_switched_off() -> None:
    rig = Rig()
    assert rig.command(511, 331.0, 1.0) == mav.MAV_RESULT_ACCEPTED  # asks for 1 MHz
    assert rig.command(511, 32.0, 50_000.0) == mav.MAV_RESULT_ACCEPTED
    assert rig.command(511, 30.0, -1.0) == mav.MAV_RESULT_ACCEPTED
    rig.run(1.0)
    assert len(rig.seen(331)) == 100
    assert len(rig.seen(32)) == 20
    assert not rig.seen(30)
    assert rig.command(511, 30.0, 0.0) == mav.MAV_RESULT_ACCEPTED
    rig.run(0.1)
    assert len(rig.seen(30)) == 10
    assert rig.command(511, 0.0, 1000.0) == mav.MAV_RESULT_FAILED  # heartbeat
    assert rig.command(511, 12345.0, 1000.0) == mav.MAV_RESULT_FAILED
    assert rig.command(511, NAN, 1000.0) == mav.MAV_RESULT_FAILED


def test_messages_on_request() -> None:
    rig = Rig()
    ask = [*[NAN] * 6]
    replies = rig.handle(mav.MAVLink_command_long_message(1, 1, 512, 0, 242.0, *ask))
    assert [r.get_msgId() for r in replies] == [mav.MAVLINK_MSG_ID_COMMAND_ACK, 242]
    assert rig.command(512, 435.0) == mav.MAV_RESULT_DENIED  # AVAILABLE_MODES: a promise would hang QGC
    assert rig.command(512, NAN) == mav.MAV_RESULT_DENIED
    assert rig.command(520, 1.0) == mav.MAV_RESULT_ACCEPTED
    assert rig.command(410) == mav.MAV_RESULT_ACCEPTED


def set_real(rig: Rig, name: str, value: float) -> float:
    message = mav.MAVLink_param_set_message(1, 1, name.encode(), value, mav.MAV_PARAM_TYPE_REAL32)
    return rig.handle(message)[0].param_value


def test_parameters_can_be_listed_read_and_set() -> None:
    rig = Rig()
    listed = rig.handle(mav.MAVLink_param_request_list_message(1, 1))
    assert [p.param_index for p in listed] == list(range(listed[0].param_count))
    assert all(len(p.param_id) <= 16 for p in listed)
    by_name = rig.handle(mav.MAVLink_param_request_read_message(1, 1, b"COM_OBL_RC_ACT", -1))[0]
    assert by_name.param_type == mav.MAV_PARAM_TYPE_INT32
    assert struct.unpack("<i", struct.pack("<f", by_name.param_value)) == (4,)  # bytewise
    by_index = rig.handle(mav.MAVLink_param_request_read_message(1, 1, b"", by_name.param_index))[0]
    assert by_index.param_id == by_name.param_id
    assert rig.handle(mav.MAVLink_param_request_read_message(1, 1, b"NO_SUCH_THING", -1)) == []
    assert rig.handle(mav.MAVLink_param_request_read_message(1, 1, b"", 9999)) == []
    assert set_real(rig, "MIS_TAKEOFF_ALT", 0.8) == pytest.approx(0.8)
    assert rig.autopilot.parameters["MIS_TAKEOFF_ALT"] == pytest.approx(0.8)


@pytest.mark.parametrize("value", [NAN, math.inf, 0.0, 60.0])
def test_parameters_out_of_range_keep_their_value_and_say_so(value: float) -> None:
    rig = Rig()
    assert set_real(rig, "COM_OF_LOSS_T", value) == 0.5
    assert "COM_OF_LOSS_T" in rig.texts()[0]


def test_safety_parameters_are_fixed_while_armed_and_types_must_fit() -> None:
    rig = Rig()
    wrong_type = mav.MAVLink_param_set_message(1, 1, b"COM_OF_LOSS_T", 1.0, mav.MAV_PARAM_TYPE_INT32)
    assert rig.handle(wrong_type)[0].param_value == 0.5
    rig.command(400, 1.0)
    assert set_real(rig, "COM_OF_LOSS_T", 1.0) == 0.5
    assert set_real(rig, "MPC_LAND_SPEED", 0.2) == pytest.approx(0.2)


def test_small_protocols_answer() -> None:
    rig = Rig()
    rig.run(1.0)
    (sync,) = rig.handle(mav.MAVLink_timesync_message(0, 77))
    assert (sync.tc1, sync.ts1) == (1_000_000_000, 77)
    assert rig.handle(mav.MAVLink_timesync_message(5, 77)) == []
    (ping,) = rig.handle(mav.MAVLink_ping_message(1, 2, 0, 0))
    assert (ping.target_system, ping.target_component, ping.seq) == (*COMPANION, 2)
    (count,) = rig.handle(mav.MAVLink_mission_request_list_message(1, 1, 1))
    assert (count.count, count.mission_type) == (0, 1)
    (ack,) = rig.handle(mav.MAVLink_mission_count_message(1, 1, 3, 0))
    assert ack.type == mav.MAV_MISSION_UNSUPPORTED
    request = [7, 0, 3, 4, 0, *[0] * 246]
    (nak,) = rig.handle(mav.MAVLink_file_transfer_protocol_message(0, 1, 1, request))
    assert list(nak.payload[:6]) == [8, 0, 3, 129, 1, 4]
    assert nak.payload[12] == 1


def test_long_texts_travel_in_chunks() -> None:
    rig = Rig()
    text = "x" * 50 + "y" * 50
    rig.autopilot.flight.say(mav.MAV_SEVERITY_INFO, text)
    assert rig.texts() == [text]
    chunks = rig.seen(mav.MAVLINK_MSG_ID_STATUSTEXT)
    assert [c.chunk_seq for c in chunks] == [0, 1, 2]
    assert (
        b"".join(bytes(c.text, "ascii") if isinstance(c.text, str) else c.text for c in chunks)
        == text.encode()
    )


def test_everything_it_says_can_be_serialised() -> None:
    rig = Rig().offboard()
    rig.run(2.5, (0.1, -0.1, 0.0))
    link = mav.MAVLink(None, 1, 1)
    for id_ in (331, 49, 148):
        rig.telemetry += rig.handle(mav.MAVLink_command_long_message(1, 1, 512, 0, float(id_), *[NAN] * 6))
    for message in [*rig.telemetry, *rig.handle(mav.MAVLink_param_request_list_message(1, 1))]:
        (frame,) = split_frames(message.pack(link))
        assert decode(frame).get_msgId() == message.get_msgId()


@pytest.mark.parametrize(
    "make",
    [
        lambda cls: cls(1234, 1.0, -2.0, 3.0, 0.5, 0.0, 0.0),
        lambda cls: cls(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        lambda cls: cls(1, NAN, 1e30, -0.0, 1.0, 2.0, 3.0),
    ],
)
def test_fast_packing_gives_the_bytes_of_pymavlink(make) -> None:
    for fast, slow in (
        (LocalPositionNed, mav.MAVLink_local_position_ned_message),
        (Attitude, mav.MAVLink_attitude_message),
    ):
        link = mav.MAVLink(None, 1, 1)
        link.seq = 201
        assert make(fast).pack(link) == make(slow).pack(link)


def test_messages_from_itself_and_of_no_interest_do_nothing() -> None:
    rig = Rig()
    arm = mav.MAVLink_command_long_message(1, 1, 400, 0, 1.0, *[NAN] * 6)
    assert rig.handle(arm, (1, 1)) == []
    assert rig.handle(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)) == []
    for number in range(300):  # its field is named like the message's number in pymavlink
        assert rig.handle(mav.MAVLink_statustext_message(6, b"hello", number)) == []
    assert not rig.vehicle.armed
