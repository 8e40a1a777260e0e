"""Tests the effects of vehicle faults: flights end as physics predicts, or continue after recovery."""

import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from sim.scenarios.fault_spec import TABLE, Kind, What
from sim.scenarios.tables import Start, VelocityLoop
from sim.vehicle.vehicle import VehicleSim
from tests.examples import examples
from tests.unit.faults.fault_helpers import CELLS, aloft, fault, hold, off_home
from tests.unit.vehicle.vehicle_sim_helpers import scenario

OF_THE_VEHICLE = [(what, kind) for what, kind in CELLS if what not in (What.TARGET_ODOMETRY, What.ROBOT)]
FOR_HALF_A_SECOND = [
    (what, kind)
    for what, kind in OF_THE_VEHICLE
    if TABLE[what][kind].healable and kind not in (Kind.WEAK, Kind.DEAD)
]
# faults of links and of the clock; they do not change the vehicle
NEUTRAL = {What.LINK_IN, What.LINK_OUT, What.HEARTBEAT, What.SETPOINTS, What.CLOCK}


def test_a_stuck_motor_turns_on_after_disarming():
    sim = aloft(fault(What.MOTOR, Kind.STUCK, start_s=0.5, motor=3))
    hold(sim, 1.0)
    sim.disarm(force=True)
    sim.advance(1000)
    rpm = sim.truth().rotor_rpm
    assert rpm[2] == pytest.approx(18_970, rel=0.03)
    assert max(rpm[0], rpm[1], rpm[3]) < 1.0
    assert not sim.motors_running  # without a command the motors do not restart


@examples(25, suppress_health_check=list(HealthCheck), derandomize=True)
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
