"""Messages in and out of the Crazyflie bridge: telemetry by another decoder, commands, refusals."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.frames import enu_from_ned, yaw_ned_from_enu
from bridge.mavlink.client.vehicle_state import VehicleState
from bridge.mavlink.codec.packing import pack
from bridge.mavlink.profiles.autopilots import profile
from flightstack.core.types import Landed, Mode
from tests.crazyflie_firmware.bench import CLIENT, GROUND, NAN, Bench
from tests.crazyflie_firmware.firmware import Firmware
from tests.crazyflie_firmware.plant import Point


def through_the_wire(message):
    """As another implementation decodes it."""
    parser = mav.MAVLink(None)
    return parser.decode(bytearray(pack(message, 0, 1, 1)))


def read(bench: Bench) -> VehicleState:
    """What the flight stack makes of the telemetry."""
    state = VehicleState(profile("px4"))
    for at_s, message in bench.out:
        state.update(through_the_wire(message), at_s)
    return state


def test_the_flight_stack_reads_its_state():
    plant = Point(1.0, 2.0)
    plant.yaw = 0.7
    bench = Bench(Firmware(plant)).ready()
    state = read(bench)
    assert state.own.position_enu_m == pytest.approx((1.0, 2.0, 0.0), abs=1e-3)
    assert state.own.yaw_rad == pytest.approx(0.7, abs=3e-3)
    assert (state.status.armed, state.status.mode, state.status.landed) == (
        False,
        Mode.HOLD,
        Landed.ON_GROUND,
    )
    bench.run(0.3)
    assert read(bench).status.ready_to_arm
    bench.offboard((0.3, 0.0, -0.1))
    bench.run(1.0)
    state = read(bench)
    assert (state.status.armed, state.status.mode, state.status.landed) == (
        True,
        Mode.EXTERNAL,
        Landed.IN_AIR,
    )
    assert state.own.velocity_enu_m_s == pytest.approx((0.0, 0.3, 0.1), abs=0.01)
    assert state.own.position_enu_m == pytest.approx(bench.firmware.plant.position, abs=5e-3)
    assert state.counters.not_finite == state.counters.out_of_order == state.counters.without_yaw == 0
    assert state.battery.voltage_v == pytest.approx(4.1)


def test_messages_it_does_not_have_and_messages_of_a_crazyflie_not_heard_are_refused():
    bench = Bench().ready()
    assert bench.result(512, 435.0) == 2
    bench.mute = True
    bench.run(1.5)
    assert bench.result(512, 32.0) == 1


COMMANDS = {
    "a mode of PX4 that it does not have": ((176, 1.0, 4.0, 5.0), 2),
    "offboard without a stream": ((176, 1.0, 6.0), 1),
    "hold": ((176, 1.0, 4.0, 3.0), 0),
    "take-off too high": ((22, NAN, NAN, NAN, NAN, NAN, NAN, 50.0), 1),
    "land on the ground": ((21,), 0),
    "disarm disarmed": ((400, 0.0), 0),
    "force disarm disarmed": ((400, 0.0, 21196.0), 0),
    "termination unsure": ((185, 0.0), 2),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_are_answered_and_refusals_explained(name):
    (number, *params), result = COMMANDS[name]
    bench = Bench().ready()
    answers = bench.command(number, *params)
    assert [(a.command, a.result, a.target_system, a.target_component) for a in answers] == [
        (number, result, *CLIENT)
    ]
    bench.step()
    assert any(re.search("refused|denied|not supported|must be", t) for t in bench.texts) == bool(result)


def test_arming_is_acknowledged_when_it_shows_and_repeats_do_no_harm():
    bench = Bench(Firmware(auto_arm=False)).ready()
    assert bench.command(400, 1.0) == []
    assert bench.command(400, 1.0, sender=GROUND) == []
    bench.until(lambda: bench.vehicle.armed).step()
    assert sorted((r.result, r.target_system) for r in bench.replies) == [(0, 1), (0, 255)]
    assert bench.result(400, 1.0) == 0


@given(ned=st.tuples(*[st.floats(-0.5, 0.5)] * 3), rate=st.floats(-3.0, 3.0), yaw=st.floats(-3.0, 3.0))
def test_velocities_and_rates_arrive_in_the_crazyflies_frame(ned, rate, yaw):
    bench = FLYING
    bench.stream = None
    bench.setpoint(ned, mask=1479, rate=rate)
    bench.step()
    _, velocity, rate_deg_s = bench.firmware.setpoints[-1]
    assert velocity == pytest.approx(enu_from_ned(ned), abs=1e-6)
    assert rate_deg_s == pytest.approx(-math.degrees(rate), rel=1e-5, abs=1e-6)
    # forward in the body is along the nose
    bench.setpoint((0.4, 0.0, 0.0), frame=8, yaw=yaw_ned_from_enu(yaw))
    bench.step()
    heading = bench.firmware.plant.yaw
    _, velocity, _ = bench.firmware.setpoints[-1]
    assert velocity == pytest.approx((0.4 * math.cos(heading), 0.4 * math.sin(heading), 0.0), abs=0.05)


FLYING = Bench().offboard()
