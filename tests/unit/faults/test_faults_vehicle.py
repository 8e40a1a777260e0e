"""Physical effects of vehicle faults: each cell has the end that physics predicts; recovered vehicles
fly on."""

import math

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from logs.schema.events import ContactBit
from sim.plant.params import load
from sim.scenarios.fault_spec import TABLE, After, Kind, What
from sim.scenarios.scenario import Start, VelocityLoop
from sim.vehicle.vehicle import VehicleSim
from tests.unit.faults.fault_helpers import CELLS, aloft, fault, hold, off_home
from tests.unit.vehicle.vehicle_sim_helpers import LOOPS, fly, scenario

OF_THE_VEHICLE = [(what, kind) for what, kind in CELLS if what not in (What.TARGET_ODOMETRY, What.ROBOT)]
FOR_HALF_A_SECOND = [
    (what, kind)
    for what, kind in OF_THE_VEHICLE
    if TABLE[what][kind].healable and kind not in (Kind.WEAK, Kind.DEAD)
]
NEUTRAL = {What.LINK_IN, What.LINK_OUT, What.HEARTBEAT, What.SETPOINTS, What.CLOCK}  # process faults


@pytest.mark.parametrize(("what", "kind"), OF_THE_VEHICLE)
def test_every_fault_can_happen_in_flight_and_is_told(what, kind):
    sim = aloft(fault(what, kind, start_s=0.5))
    for _ in range(200):
        hold(sim, 0.01)
        truth = sim.truth()
        assert all(map(math.isfinite, (*truth.position_enu_m, *truth.rotor_rpm, truth.battery_v)))
    (text,) = sim.faults.take_texts()
    assert text.begins
    assert what.value.replace("_", " ") in str(text)


@pytest.mark.parametrize("loop", LOOPS)
def test_a_dead_motor_tips_it_over(loop):
    sim = aloft(fault(What.MOTOR, Kind.DEAD, start_s=0.5), loop=loop)
    truths = hold(sim, 3.0)
    seen = 0
    for truth in truths:
        seen |= truth.contacts
    assert seen & ContactBit.TUMBLED
    assert seen & ContactBit.GROUND
    tipped = next(t for t in truths if t.contacts & ContactBit.TUMBLED)
    assert 0.6 < tipped.time_s < 1.1  # 0.25 s of rolling with half the thrust on one side
    assert truths[-1].rotor_rpm[1] < 1.0
    assert sim.crashed
    assert not sim.motors_running


@pytest.mark.parametrize(("loop", "motor"), zip([*LOOPS] * 2, [1, 2, 3, 4], strict=True))
def test_a_tenth_less_thrust_of_one_motor_is_flown_out(loop, motor):
    sim = aloft(fault(What.MOTOR, Kind.WEAK, start_s=0.5, motor=motor, value=0.9), loop=loop)
    truths = hold(sim, 4.0)
    assert sim.state_text == "flying"
    assert max(map(off_home, truths)) < 0.06
    commands = [c / max(sim.motor_commands) for c in sim.motor_commands]
    assert commands.index(1.0) == motor - 1  # it works harder for the same thrust
    rotor = load().rotor
    mean = sum(rotor.thrust_n(rpm) for rpm in truths[-1].rotor_rpm)
    assert mean == pytest.approx(0.0319 * 9.81, rel=0.01)


@pytest.mark.parametrize("loop", LOOPS)
def test_two_fifths_less_cannot_be_flown(loop):
    # the weak motor would need a command of 0.078 / 0.6 = 0.130 N, but 0.120 N is the limit
    sim = aloft(fault(What.MOTOR, Kind.WEAK, start_s=0.5, value=0.6), loop=loop)
    truths = hold(sim, 5.0)
    assert any(t.contacts & ContactBit.GROUND for t in truths)


def test_a_stuck_motor_turns_on_after_disarming():
    sim = aloft(fault(What.MOTOR, Kind.STUCK, start_s=0.5, motor=3))
    hold(sim, 1.0)
    sim.disarm(force=True)
    sim.advance(1000)
    rpm = sim.truth().rotor_rpm
    assert rpm[2] == pytest.approx(18_970, rel=0.03)
    assert max(rpm[0], rpm[1], rpm[3]) < 1.0
    assert not sim.motors_running  # no command is active


@pytest.mark.parametrize("loop", LOOPS)
def test_without_motion_capture_the_estimate_is_invalid_after_half_a_second(loop):
    sim = aloft(fault(What.MOCAP, Kind.OFF, start_s=0.5), loop=loop)
    hold(sim, 0.98)
    assert sim.estimate().valid
    hold(sim, 0.06)
    assert not sim.estimate().valid
    assert max(map(off_home, hold(sim, 1.0))) < 0.15  # the IMU bridges one second


def test_frozen_motion_capture_makes_it_wander_while_it_believes_to_stand():
    sim = aloft(fault(What.MOCAP, Kind.STUCK, start_s=0.5))
    fly(sim, (0.2, 0.0, 0.0), 3.0)
    truth, believed = sim.truth(), sim.estimate()
    assert believed.valid
    assert math.dist(believed.position_enu_m, truth.position_enu_m) > 0.3


def test_a_wrong_position_is_where_it_flies_to():
    truths = hold(aloft(fault(What.MOCAP, Kind.WRONG, start_s=0.5, offset_m=(0.3, 0.0, 0.0))), 6.0)
    assert truths[-1].position_enu_m == pytest.approx((1.7, 0.0, 1.7), abs=0.03)


def test_garbage_in_the_motion_capture_throws_it_down():
    sim = aloft(fault(What.MOCAP, Kind.GARBAGE, start_s=0.5))
    truths = hold(sim, 6.0)
    assert sim.crashed
    assert truths[-1].position_enu_m[2] < 0.1


@pytest.mark.parametrize("kind", [Kind.SLOW, Kind.DELAYED, Kind.INTERMITTENT])
@pytest.mark.parametrize("what", [What.MOCAP, What.OWN_STATE])
@pytest.mark.parametrize("loop", LOOPS)
def test_a_poor_measurement_is_flown_out(loop, what, kind):
    sim = aloft(fault(what, kind, start_s=0.5), loop=loop)
    assert max(map(off_home, hold(sim, 6.0))) < 0.05
    assert sim.state_text == "flying"


@pytest.mark.parametrize("kind", [Kind.OFF, Kind.STUCK])
def test_a_lost_own_state_concerns_the_autopilot_only(kind):
    sim = aloft(fault(What.OWN_STATE, kind, start_s=0.5))
    believed = []
    for _ in range(20):
        fly(sim, (0.2, 0.0, 0.0), 0.1)
        believed.append(sim.estimate())
    assert believed[-1].valid is (kind is Kind.STUCK)
    assert believed[-1].position_enu_m == believed[5].position_enu_m
    assert sim.truth().velocity_enu_m_s[0] == pytest.approx(0.18, abs=0.03)  # the firmware knows better


@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(
    cell=st.sampled_from(FOR_HALF_A_SECOND),
    start_s=st.floats(0.1, 1.0),
    duration_s=st.floats(0.05, 0.5),
    loop=st.sampled_from(list(VelocityLoop)),
    seed=st.integers(0, 5),
)
def test_after_a_short_fault_it_flies_on(cell, start_s, duration_s, loop, seed):
    sim = aloft(fault(*cell, start_s=start_s, duration_s=duration_s), loop=loop, seed=seed)
    truths = hold(sim, start_s + duration_s + 5.0)
    begins, ends = sim.faults.take_texts()
    assert begins.begins
    assert not ends.begins
    assert sim.state_text == "flying"
    assert sim.estimate().valid
    assert off_home(truths[-1]) < 0.05
    assert max(map(off_home, truths)) < (0.02 if cell[0] in NEUTRAL else 0.8)


def test_take_off_is_when_the_ground_has_been_left():
    late = fault(What.BATTERY, Kind.DROP, start_s=0.5, after=After.TAKEOFF, value=0.3)
    sim = VehicleSim(scenario(start=Start(ground_position_m=(-1.2, 0.3)), fault=(late,)), 1)
    sim.advance(1000)
    sim.arm()
    told = None
    for k in range(400):
        (truth,) = fly(sim, (0.0, 0.0, 0.3), 0.01)
        if truth.contacts & ContactBit.GROUND:
            left_s = truth.time_s
        if sim.faults.take_texts():
            told = 1.0 + 0.01 * k
            break
    assert told is not None
    assert told - left_s == pytest.approx(
        0.5 + 0.2, abs=0.06
    )  # 0.2 s without contact, checked 25 times a second


@pytest.mark.parametrize("kind", TABLE[What.MOCAP])
def test_the_same_seed_fails_in_the_same_way_whatever_the_chunks(kind):
    ends = []
    for chunk_ms in (10, 15, 10):
        sim = aloft(fault(what=What.MOCAP, kind=kind, start_s=0.123, duration_s=0.2), seed=4)
        sim.set_velocity((0.2, 0.0, 0.0), 0.0)
        for _ in range(450 // chunk_ms):
            sim.advance(chunk_ms)
        ends.append((repr(sim.truth()), repr(sim.estimate())))
    assert ends[0] == ends[1] == ends[2]


def test_a_low_battery_is_not_armed():
    on_ground = Start(ground_position_m=(-1.2, 0.3))
    sim = VehicleSim(scenario(start=on_ground, fault=(fault(What.BATTERY, Kind.OFF),)), 1)
    sim.advance(10)
    assert "battery at" in sim.arm()
