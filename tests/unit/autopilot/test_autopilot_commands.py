"""Tests the effects of commands on the simulated vehicle, and the fail-safes of the vehicle."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.parameters import INT32, Parameters
from bridge.mavlink.server.profile import FlightMode
from flightstack.compiled.records import new
from sim.autopilot.autopilot import px4_parameters
from sim.autopilot.flight import Watches
from sim.autopilot.telemetry import degrees_e7
from sim.plant.params import load
from sim.plant.rotors import BatteryRecord, drain, set_up_battery, speed_limit
from tests.unit.autopilot.autopilot_fakes import RATE_HZ, FakeVehicle, Rig, set_int, set_real
from tests.unit.mavlink.server.served import NAN, OFFBOARD, as_int

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
NEAR = tuple(v / 1e7 for v in degrees_e7(1.0, 2.0))  # latitude, longitude, degrees
NAN7 = (NAN,) * 7


def test_heights_above_home_and_above_the_sea() -> None:
    rig = Rig().homed()
    rig.command(400, 1.0)
    assert rig.handle(as_int(22, (*NAN7[:6], 0.5), frame=3))[0].result == ACCEPTED
    rig.run(6.0)
    assert rig.vehicle.state.position_enu_m[2] == pytest.approx(0.75, abs=0.03)
    home = rig.seen(mav.MAVLINK_MSG_ID_HOME_POSITION)[-1]
    assert (home.x, home.y, home.z) == pytest.approx((2.0, 1.0, -0.25), abs=0.01)
    assert home.altitude == pytest.approx(250, abs=1)
    position = rig.seen(mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)[-1]
    assert position.alt - position.relative_alt == 250


def test_a_pause_stops_and_a_place_to_fly_to_is_refused() -> None:
    rig = Rig().offboard()
    rig.run(2.0, (0.3, 0.0, 0.0))
    rig.run(0.6)
    rig.command(176, *OFFBOARD)
    assert rig.handle(as_int(192, (-1.0, 1.0, 0.0, NAN, *NEAR, 0.8)))[0].result == UNSUPPORTED
    assert rig.command(192, -1.0, 1.0, 0.0) == ACCEPTED  # QGroundControl sends this command to pause
    rig.run(3.0)
    assert math.hypot(*rig.vehicle.state.velocity_enu_m_s[:2]) < 0.02
    assert rig.mode is FlightMode.HOLD


def test_reboot_unlocks_disarmed_and_is_denied_armed() -> None:
    rig = Rig(locked=True)
    rig.command(511, 32.0, 100_000.0)
    assert rig.command(400, 1.0) == REJECTED
    assert rig.command(246, 1.0) == ACCEPTED
    assert rig.vehicle.reboots == 1
    assert rig.autopilot.streams.interval_us(32) == round(1e6 / RATE_HZ)
    assert rig.command(400, 1.0) == ACCEPTED
    assert rig.command(246, 1.0) == DENIED
    assert rig.texts()[-1] == "Reboot refused: armed"
    assert rig.vehicle.armed


def rig_with(**parameters: float) -> Rig:
    rig = Rig()
    for name, value in parameters.items():
        if Parameters(px4_parameters(1)).table[name].type == INT32:
            assert set_int(rig, name, int(value)) == value
        else:
            assert set_real(rig, name, value) == pytest.approx(value)
    return rig


@pytest.mark.parametrize(
    ("act", "mode", "doing"),
    [(0, FlightMode.LAND, "landing"), (4, FlightMode.LAND, "landing"), (5, FlightMode.HOLD, "holding")],
)
def test_loss_of_set_points_does_what_the_parameter_says(act: int, mode: FlightMode, doing: str) -> None:
    rig = rig_with(COM_OBL_RC_ACT=act).offboard()
    rig.run(0.5, (0.3, 0.0, 0.0))
    rig.run(0.6)
    assert rig.mode is mode
    assert f"No set-points for 0.5 s: {doing}" in rig.texts()
    assert rig.autopilot.flight.failsafe
    rig.run(3.0)
    beats = [beat.system_status for beat in rig.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)]
    assert mav.MAV_STATE_CRITICAL in beats
    if mode is FlightMode.HOLD:
        assert math.hypot(*rig.vehicle.state.velocity_enu_m_s) < 0.02
        rig.run(0.1, (0.0, 0.0, 0.0))
        assert rig.command(176, *OFFBOARD) == mav.MAV_RESULT_ACCEPTED  # the sender in control may continue
        assert not rig.autopilot.flight.failsafe


def test_set_points_are_clipped_only_where_a_limit_was_lowered_and_never_silently() -> None:
    free = Rig().offboard()
    free.run(0.01, (3.0, 4.0, 0.0))
    assert free.vehicle.setpoint == pytest.approx((4.0, 3.0, 0.0))
    rig = rig_with(MPC_XY_VEL_MAX=1.0, MPC_Z_VEL_MAX_UP=0.4, MPC_Z_VEL_MAX_DN=0.3).offboard()
    rig.run(0.01, (3.0, 3.9, -0.5))
    assert rig.vehicle.setpoint == pytest.approx(
        (3.9 / math.hypot(3.0, 3.9), 3.0 / math.hypot(3.0, 3.9), 0.4)
    )
    assert rig.texts()[-1].startswith("Set-point clipped")
    rig.run(0.01, (0.0, 0.5, 2.0))
    assert rig.vehicle.setpoint == pytest.approx((0.5, 0.0, -0.3))
    rig.telemetry.clear()
    rig.run(0.6, (0.0, 0.5, 2.0))
    shown = rig.seen(mav.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED)[-1]
    assert (shown.vy, shown.vz) == pytest.approx((0.5, 0.3))


def charge(voltage_v: float, throttle: float) -> float:
    vehicle = FakeVehicle(battery_v=voltage_v, motor_commands=(throttle,) * 4)
    return Watches(Parameters(px4_parameters(1)), vehicle).charge


def test_charge_of_the_simulated_cell_is_read_right_in_hover() -> None:
    params = load().battery
    hover_rpm, used = 18_700.0, 0.3
    cell = new(BatteryRecord)
    set_up_battery(cell, params, hover_rpm, 1.0 - used)
    drain(cell, np.full(4, hover_rpm), 0.01)
    assert charge(cell.voltage_v, hover_rpm / speed_limit(cell)) == pytest.approx(1.0 - used, abs=0.03)
