"""Tests both connections of the Crazyflie bridge: log packets, clock, firmware settings, and MAVLink."""

from __future__ import annotations

import math
from itertools import pairwise
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.crazyflie.condition import with_remedy
from bridge.crazyflie.packets import (
    ORDERS_MAX,
    VELOCITY_AGE_MAX_S,
    BootClock,
    Info,
    Order,
    Outbox,
    SetParam,
    Velocity,
    decode_state,
)
from bridge.crazyflie.process import Loop
from bridge.crazyflie.rules import DRAG, UNKNOWN_DRAG
from bridge.frames import enu_from_ned, yaw_ned_from_enu
from bridge.mavlink.client.vehicle_state import VehicleState
from bridge.mavlink.profiles import profile
from bridge.ros2.cdr import Pose
from flightstack.cli.real import _drag_1_s
from flightstack.common.hangup import Stop
from flightstack.common.strict_toml import ConfigError
from flightstack.core.types import Landed, Mode
from tests.crazyflie_firmware.bench import Bench
from tests.crazyflie_firmware.firmware import Firmware, quaternion_bits
from tests.crazyflie_firmware.plant import Point
from tests.crazyflie_firmware.supervisor import State
from tests.unit.mavlink.codec.frames_of_messages import packed


def test_only_a_missing_usb_device_gets_the_remedy():
    failed = "Couldn't load link driver: "
    assert with_remedy(f"{failed}Cannot find a Crazyradio Dongle").startswith(
        "Cannot find a Crazyradio Dongle: plug it in; on Linux install Bitcraze's udev rules"
    )
    assert with_remedy(f"{failed}[Errno 111]") == f"{failed}[Errno 111]"


def test_pitch_rate_is_turned_the_right_way_round():
    values = dict.fromkeys(("stateEstimateZ.x", "stateEstimateZ.y", "stateEstimateZ.z"), 1500)
    values |= dict.fromkeys(("stateEstimateZ.vx", "stateEstimateZ.vy", "stateEstimateZ.vz"), -250)
    values |= {"stateEstimateZ.quat": quaternion_bits((1.0, 0.0, 0.0, 0.0))}
    values |= {f"stateEstimateZ.rate{a}": 100 for a in ("Roll", "Pitch", "Yaw")}
    values |= {"supervisor.info": 0xF0A, "pm.vbatMV": 3999}
    state = decode_state(values, 7, 1.0)
    assert state.position_enu_m == (1.5, 1.5, 1.5)
    assert state.velocity_enu_m_s == (-0.25, -0.25, -0.25)
    assert state.angular_velocity_flu_rad_s == (0.1, -0.1, 0.1)
    assert state.info == Info.ARMED | Info.CAN_FLY
    assert state.battery_v == 3.999


@given(st.integers(0, (1 << 24) - 1), st.lists(st.integers(1, 60_000), min_size=1, max_size=50))
def test_the_clock_goes_on_over_the_end_of_24_bits(start_ms, steps_ms):
    clock, true_ms = BootClock(), start_ms
    clock.take(start_ms, 0.0)
    for step_ms in steps_ms:
        true_ms += step_ms
        boot_ms, late_s = clock.take(true_ms % (1 << 24), (true_ms - start_ms) / 1000.0)
        assert boot_ms == true_ms
        assert late_s == pytest.approx(0.0, abs=1e-6)


def test_packets_out_of_order_are_dropped_late_ones_are_known_and_a_restart_is_one():
    clock = BootClock()
    assert clock.take(1000, 1.0) == (1000, 0.0)
    assert clock.take(1000, 1.0) is None
    assert clock.take(990, 1.0) is None
    assert clock.take(1010, 1.04) == (1010, pytest.approx(0.03, abs=1e-3))
    assert clock.take(1020, 1.42) is None
    assert clock.now_ns(2.0) == pytest.approx(2e9, abs=1e6)


def test_the_newest_velocity_wins_and_an_old_one_is_not_sent():
    box = Outbox()
    box.put(Velocity((1.0, 0.0, 0.0), 0.0), 0.0)
    box.put(Velocity((2.0, 0.0, 0.0), 0.0), 0.05)
    assert box.get(0.0, lambda: 0.06).velocity_enu_m_s == (2.0, 0.0, 0.0)
    assert box.get(0.0, lambda: 0.06) is None
    box.put(Velocity((3.0, 0.0, 0.0), 0.0), 1.0)
    assert box.get(0.0, lambda: 1.0 + VELOCITY_AGE_MAX_S + 0.01) is None


def test_an_emergency_stop_goes_first_and_motors_off_takes_the_velocity_away():
    box = Outbox()
    box.put(Velocity((1.0, 0.0, 0.0), 0.0), 0.0)
    box.put(SetParam("a.b", 1.0), 0.0)
    box.put(Order.STOP, 0.0)
    box.put(Order.EMERGENCY_STOP, 0.0)
    box.put(Pose(0, "map", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), 0.0)
    came = [box.get(0.0, lambda: 0.0) for _ in range(5)]
    assert came[:3] == [Order.EMERGENCY_STOP, SetParam("a.b", 1.0), Order.STOP]
    assert isinstance(came[3], Pose)
    assert came[4] is None


def test_the_outbox_is_bounded_and_never_loses_what_stops_motors():
    box = Outbox()
    for i in range(3 * ORDERS_MAX):
        box.put(SetParam(f"p.{i}", 0.0), 0.0)
    box.put(Order.EMERGENCY_STOP, 0.0)
    came = []
    while (packet := box.get(0.0, lambda: 0.0)) is not None:
        came.append(packet)
    assert len(came) == ORDERS_MAX
    assert came[0] is Order.EMERGENCY_STOP
    box.put(Order.ARM, 0.0)
    box.clear()
    assert box.get(0.0, lambda: 0.0) is None


def through_the_wire(message):
    """Pack a message, and return it as pymavlink decodes it."""
    parser = mav.MAVLink(None)
    return parser.decode(bytearray(packed(message)))


def read(bench: Bench, *, power: bool = False) -> VehicleState:
    """Return the vehicle state that the flight stack decodes from the telemetry."""
    state = VehicleState(profile("px4"))
    if power:
        state.watch_power()
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
    assert (
        state.counters["not_finite"] == state.counters["out_of_order"] == state.counters["without_yaw"] == 0
    )
    assert state.battery.voltage_v == pytest.approx(4.1)


def test_the_throttle_is_the_mean_of_the_motors_and_comes_when_it_is_asked_for():
    bench = Bench().offboard()
    assert not bench.times("VFR_HUD")
    assert bench.result(511, mav.MAVLINK_MSG_ID_VFR_HUD, 1e5) == 0
    bench.run(1.0)
    assert len(bench.times("VFR_HUD")) == pytest.approx(10, abs=1)
    state = read(bench, power=True)
    assert state.power.throttle == pytest.approx(0.80)  # thrust as a fraction of 52,500, in whole percents
    assert (state.power.voltage_v, state.power.cos_tilt) == pytest.approx((4.1, 1.0), abs=0.01)


@given(ned=st.tuples(*[st.floats(-0.5, 0.5)] * 3), rate=st.floats(-3.0, 3.0), yaw=st.floats(-3.0, 3.0))
def test_velocities_and_rates_arrive_in_the_crazyflies_frame(ned, rate, yaw):
    bench = FLYING
    bench.stream = None
    bench.setpoint(ned, mask=1479, rate=rate)
    bench.step()
    _, velocity, rate_deg_s = bench.firmware.setpoints[-1]
    assert velocity == pytest.approx(enu_from_ned(ned), abs=1e-6)
    assert rate_deg_s == pytest.approx(-math.degrees(rate), rel=1e-5, abs=1e-6)
    # a forward velocity in the body frame points along the nose
    bench.setpoint((0.4, 0.0, 0.0), frame=8, yaw=yaw_ned_from_enu(yaw))
    bench.step()
    heading = bench.firmware.plant.yaw
    _, velocity, _ = bench.firmware.setpoints[-1]
    assert velocity == pytest.approx((0.4 * math.cos(heading), 0.4 * math.sin(heading), 0.0), abs=0.05)


FLYING = Bench().offboard()


def test_an_exception_in_the_bridge_lands_the_crazyflie_before_it_ends():
    sent, told, said = [], [], []

    def broken():
        raise OSError("gone")

    vehicle = SimpleNamespace(
        busy=True, end=told.append, take_packets=lambda: ["down"],
        settings=SimpleNamespace(leave=list, open=()),
    )  # fmt: skip

    def step(now_s):
        vehicle.busy = len(sent) < 3

    node, link = SimpleNamespace(vehicle=vehicle, step=step), SimpleNamespace(fileno=broken, send=sent.append)
    assert Loop(node, link, link, None, said.append).run(Stop(), None) == 1
    assert sent == ["down"] * 4
    assert len(told) == 1
    assert len(said) == 1
    assert "gone" in said[0]


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
    taken = [clock.take(time_ms + 10 * k, 1000.0 + elapsed_s + 0.01 * k) for k in range(32)]
    assert taken[-1] is not None
    assert clock.restarts == 0


@pytest.mark.parametrize("wrong_ms", [100, 300, 950, 5_000, -500, -5_000])
@pytest.mark.parametrize("stays", [False, True])
def test_a_known_clock_is_moved_by_no_single_packet_and_follows_those_that_agree(wrong_ms, stays):
    clock, usable_s = BootClock(), []
    for k in range(1_000):
        wrong = k == 500 or (stays and k > 500)
        timed = clock.take(60_000 + 10 * k + wrong_ms * wrong, 60.0 + 0.01 * k)
        if timed is not None:
            usable_s.append(60.0 + 0.01 * k)
    gap_s = max(b - a for a, b in pairwise(usable_s))
    assert gap_s < (0.03 if not stays else 0.08 if wrong_ms > 0 else 0.85)
    assert usable_s[-1] == 60.0 + 0.01 * 999


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


RULES = {"drag_1_s": (0.46, 0.46, 0.4), "restore": True}
FOUND = {"stabilizer.estimator": 1.0, **dict.fromkeys(DRAG, 0.0)}


def test_what_it_found_is_restored_once_and_confirmed():
    bench = Bench(**RULES).run(0.1)
    settings = bench.vehicle.settings
    packets = settings.leave()
    assert dict(packets) == FOUND
    assert settings.leave() == []
    assert settings.open == set(FOUND)
    for packet in packets:
        bench._write(packet)
    assert not settings.open


def test_a_firmware_that_cannot_be_told_its_drag_is_named():
    firmware = Firmware()
    for name in DRAG:
        del firmware.params[name]
    assert UNKNOWN_DRAG in Bench(firmware, **RULES).run(0.1).texts
    assert UNKNOWN_DRAG not in Bench(firmware).run(0.1).texts


def test_the_drag_is_that_of_the_vehicle_file():
    assert _drag_1_s("crazyflie20") == pytest.approx((0.461, 0.461, 0.401), abs=0.001)
    assert _drag_1_s("none") is None
    with pytest.raises(ConfigError, match="crazyflie20"):
        _drag_1_s("crazyflie99")
