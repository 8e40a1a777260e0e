"""Messages in and out of the Crazyflie bridge: telemetry by another decoder, commands, refusals."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.frames import enu_from_ned, yaw_ned_from_enu
from bridge.mavlink.client.texts import TextAssembler
from bridge.mavlink.client.vehicle_state import VehicleState
from bridge.mavlink.codec.packing import pack
from bridge.mavlink.profiles.autopilots import profile
from bridge.mavlink.server.texts import Text, TextWire
from flightstack.core.types import Landed, Mode
from tests.crazyflie_firmware.bench import CLIENT, GROUND, NAN, OTHER, Bench
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


def test_position_and_attitude_come_at_100_hz_with_the_firmwares_clock():
    bench = Bench().ready().run(1.0)
    bench.out.clear()
    bench.run(1.0)
    for kind in ("LOCAL_POSITION_NED", "ATTITUDE"):
        times_ms = [m.time_boot_ms for _, m in bench.out if m.get_type() == kind]
        assert len(times_ms) == 100
        assert times_ms[-1] - times_ms[0] == pytest.approx(990, abs=2)
    assert len(bench.times("HEARTBEAT")) == 1


def test_intervals_can_be_set_and_nobody_may_starve_the_one_who_flies():
    bench = Bench().offboard()
    assert bench.result(511, 32.0, 50_000.0, sender=OTHER) == 1
    assert bench.result(511, 32.0, 50_000.0) == 0
    bench.run(0.1)
    bench.out.clear()
    bench.run(1.0)
    assert len(bench.times("LOCAL_POSITION_NED")) == pytest.approx(20, abs=1)
    ack, interval = bench.command(510, 32.0)
    assert (ack.result, interval.interval_us) == (0, 50_000)
    assert bench.result(511, 32.0, 0.0) == 0
    assert bench.result(511, 30.0, -1.0) == 0
    assert bench.result(511, 0.0, 10_000.0) == 4  # HEARTBEAT has no rate to set
    bench.run(0.1)
    bench.out.clear()
    bench.run(0.5)
    assert len(bench.times("LOCAL_POSITION_NED")) == pytest.approx(50, abs=1)
    assert not bench.times("ATTITUDE")


@pytest.mark.parametrize("id_", [0, 1, 30, 31, 32, 147, 148, 242, 245])
def test_messages_on_request(id_):
    bench = Bench().ready()
    ack, message = bench.command(512, float(id_))
    assert (ack.result, message.get_msgId()) == (0, id_)


def test_messages_it_does_not_have_and_messages_of_a_crazyflie_not_heard_are_refused():
    bench = Bench().ready()
    assert bench.result(512, 435.0) == 2
    bench.mute = True
    bench.run(1.5)
    assert bench.result(512, 32.0) == 1


COMMANDS = {
    "unknown": ((9999,), 3),
    "infinite": ((400, math.inf), 2),
    "neither arm nor disarm": ((400, 0.6e9), 3),
    "no custom mode": ((176, 0.0, 6.0), 2),
    "no such mode": ((176, 1.0, 1.0), 2),
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


def test_messages_for_other_vehicles_are_not_obeyed():
    bench = Bench().ready()
    assert bench.command(400, 1.0, system=7) == []
    assert bench.command(400, 1.0, system=0) == []
    assert bench.command(400, 1.0, sender=(1, 1)) == []  # our own, come back
    bench.run(0.2)
    assert not bench.vehicle.armed


SETPOINTS = {
    "position": ({"mask": 2552}, "only velocity"),
    "frame": ({"frame": 7}, "frame 7"),
    "not finite": ({"ned": (NAN, 0.0, 0.0)}, "not finite"),
    "absurd": ({"ned": (1e9, 0.0, 0.0)}, "above"),
    "yaw": ({"yaw": NAN}, "yaw not finite"),
    "yaw rate": ({"mask": 1479, "rate": 100.0}, "yaw rate above"),
}


@pytest.mark.parametrize("name", SETPOINTS)
def test_bad_set_points_are_dropped_with_a_reason(name):
    change, reason = SETPOINTS[name]
    bench = Bench().offboard()
    bench.stream = None
    before = len(bench.velocities())
    bench.setpoint(**change)
    bench.step()
    assert len(bench.velocities()) == before
    assert any(t.startswith("Set-point dropped") and reason in t for t in bench.texts)


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


def test_time_and_ping_are_answered():
    bench = Bench().ready()
    (answer,) = bench.node.handle(mav.MAVLink_timesync_message(0, 123), CLIENT, bench.now_s)
    assert answer.ts1 == 123
    assert answer.tc1 == pytest.approx(bench.last("LOCAL_POSITION_NED").time_boot_ms * 1e6, abs=3e7)
    assert bench.node.handle(mav.MAVLink_timesync_message(5, 123), CLIENT, bench.now_s) == []
    (echo,) = bench.node.handle(mav.MAVLink_ping_message(9, 3, 0, 0), CLIENT, bench.now_s)
    assert (echo.seq, echo.target_system, echo.target_component) == (3, *CLIENT)


def test_set_mode_is_obeyed_or_refused_with_a_text():
    bench = Bench().hover()
    bench.node.handle(mav.MAVLink_set_mode_message(1, 1, 0x00060000), CLIENT, bench.now_s)
    bench.node.handle(mav.MAVLink_set_mode_message(1, 1, 0x05040000), CLIENT, bench.now_s)
    bench.step()
    assert any("Mode offboard refused" in t for t in bench.texts)
    assert any("there is none" in t for t in bench.texts)
    bench.node.handle(mav.MAVLink_set_mode_message(1, 1, 0x06040000), OTHER, bench.now_s)
    assert bench.vehicle.mode.value == "land"


@pytest.mark.parametrize("length", [1, 49, 50, 51, 100, 101, 180])
def test_long_texts_come_through(length):
    text = "x" * length
    assembler = TextAssembler()
    came = [t for m in TextWire().messages(Text(4, text)) for t in assembler.add(through_the_wire(m))]
    assert came == [(4, text)]
