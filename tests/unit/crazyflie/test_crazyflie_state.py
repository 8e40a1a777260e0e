"""Decoding of log packets, the firmware's clock, and the queues towards cflib."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.crazyflie.link import ORDERS_MAX, VELOCITY_AGE_MAX_S, Outbox
from bridge.crazyflie.state import BootClock, decode_state, decompress_quaternion
from bridge.crazyflie.types import Info, Order, Pose, SetParam, StateBlock, Velocity
from tests.crazyflie_firmware.bench import Bench
from tests.crazyflie_firmware.toc import quaternion_bits

UNIT = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .filter(lambda q: sum(e * e for e in q) > 0.01)
    .map(lambda q: tuple(e / math.sqrt(sum(x * x for x in q)) for e in q))
)


@given(UNIT)
def test_quaternions_survive_compression_to_a_quarter_of_a_degree(q):
    back = decompress_quaternion(quaternion_bits(q))
    assert sum(e * e for e in back) == pytest.approx(1.0)
    angle = 2.0 * math.acos(min(1.0, abs(sum(a * b for a, b in zip(q, back, strict=True)))))
    assert math.degrees(angle) < 0.3


def test_pitch_rate_is_turned_the_right_way_round():
    values = dict.fromkeys(("stateEstimateZ.x", "stateEstimateZ.y", "stateEstimateZ.z"), 1500)
    values |= dict.fromkeys(("stateEstimateZ.vx", "stateEstimateZ.vy", "stateEstimateZ.vz"), -250)
    values |= {"stateEstimateZ.quat": quaternion_bits((1.0, 0.0, 0.0, 0.0))}
    values |= {f"stateEstimateZ.rate{a}": 100 for a in ("Roll", "Pitch", "Yaw")}
    values |= {"supervisor.info": 0xF0A, "pm.vbatMV": 3999}
    state = decode_state(StateBlock(0, values), 7, 1.0)
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
    boot_ms, late_s = clock.take(1010, 1.41)
    assert (boot_ms, late_s) == (1010, pytest.approx(0.4, abs=1e-3))
    assert clock.now_ns(2.0) == pytest.approx(2e9, abs=1e6)


def test_a_restart_begins_the_clock_anew():
    clock = BootClock()
    clock.take(500_000, 500.0)
    assert clock.take(200, 501.0) == (200, 0.0)
    assert clock.take(300, 501.1)[0] == 300


def test_states_held_up_are_not_sent():
    bench = Bench().ready().run(0.5)
    held = []
    real, bench._take = bench._take, held.append
    bench.run(0.5)
    bench._take = real
    sent, late = len(bench.times("LOCAL_POSITION_NED")), bench.node.late
    for event in held:
        bench._take(event)
    bench.step()
    fresh = len(bench.times("LOCAL_POSITION_NED")) - sent
    assert bench.node.late - late >= 28
    assert fresh <= 22


def test_the_newest_velocity_wins_and_an_old_one_is_not_sent():
    box = Outbox()
    box.put(Velocity((1.0, 0.0, 0.0), 0.0), 0.0)
    box.put(Velocity((2.0, 0.0, 0.0), 0.0), 0.05)
    assert box.get(0.0, lambda: 0.06).velocity_enu_m_s == (2.0, 0.0, 0.0)
    assert box.get(0.0, lambda: 0.06) is None
    box.put(Velocity((3.0, 0.0, 0.0), 0.0), 1.0)
    assert box.get(0.0, lambda: 1.0 + VELOCITY_AGE_MAX_S + 0.01) is None
    assert box.late == 1


def test_an_emergency_stop_goes_first_and_motors_off_takes_the_velocity_away():
    box = Outbox()
    box.put(Velocity((1.0, 0.0, 0.0), 0.0), 0.0)
    box.put(SetParam("a.b", 1.0), 0.0)
    box.put(Order.STOP, 0.0)
    box.put(Order.EMERGENCY_STOP, 0.0)
    box.put(Pose((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), 0.0)
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
    assert box.lost == 2 * ORDERS_MAX + 1
    box.put(Order.ARM, 0.0)
    box.clear()
    assert box.get(0.0, lambda: 0.0) is None
