"""MAV_CMD_INJECT_FAILURE: what each unit and type does, what is refused, and that OK heals."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from sim.faults.link import Way
from sim.faults.mavlink import FAILURES, TYPES, UNITS
from sim.faults.schedule import RUNNING_MAX
from sim.scenarios.fault_spec import Fault
from sim.scenarios.fault_table import Kind, What
from tests.unit.faults.fault_helpers import aloft, fault, hold, off_home

MOTOR, BATTERY, LINK = 101, 100, 105
GPS, VIO = 4, 6
OK, OFF, STUCK, WRONG = 0, 1, 2, 4
CELLS = [(unit, kind) for unit, kinds in FAILURES.items() for kind in kinds]


def texts(sim):
    return [str(text) for text in sim.faults.take_texts()]


def test_numbers_are_mavlinks():
    assert (UNITS[MOTOR], UNITS[GPS], TYPES[OFF]) == ("SYSTEM_MOTOR", "SENSOR_GPS", "OFF")
    assert mav.FAILURE_UNIT_SYSTEM_MAVLINK_SIGNAL == LINK


@pytest.mark.parametrize(("unit", "kind"), CELLS)
def test_every_failure_takes_effect_and_ok_ends_it(unit, kind):
    sim = aloft()
    hold(sim, 0.1)
    assert sim.inject_failure(unit, kind, 1) is None
    began = texts(sim)
    assert began
    assert all(text.startswith("Fault: ") for text in began)
    assert sim.inject_failure(unit, kind, 1) is None
    assert texts(sim) == []  # it is on already
    hold(sim, 0.1)
    assert sim.inject_failure(unit, OK, 0) is None
    assert texts(sim) == [text.replace("Fault: ", "Fault over: ") for text in began]
    truths = hold(sim, 3.0)
    assert sim.state_text == "flying"
    assert off_home(truths[-1]) < 0.3  # a motor off for 0.1 s costs height


def test_motors_are_counted_from_one_and_zero_is_all():
    sim = aloft()
    assert sim.inject_failure(MOTOR, OFF, 3) is None
    assert texts(sim) == ["Fault: motor 3 dead"]
    assert sim.inject_failure(MOTOR, OFF, 0) is None
    assert texts(sim) == ["Fault: motor 1 dead", "Fault: motor 2 dead", "Fault: motor 4 dead"]
    assert sim.inject_failure(MOTOR, OK, 2) is None
    assert texts(sim) == ["Fault over: motor 2 dead"]
    assert sim._vehicle[0].motor_share.tolist() == [0.0, 1.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("unit", "kind", "instance", "words"),
    [
        (0, OFF, 0, ["SENSOR_GYRO", "not simulated", "SYSTEM_MOTOR"]),
        (77, OFF, 0, ["77", "not simulated"]),
        (MOTOR, 6, 1, ["SYSTEM_MOTOR", "DELAYED", "OFF, STUCK, WRONG"]),
        (MOTOR, 99, 1, ["SYSTEM_MOTOR", "99"]),
        (BATTERY, STUCK, 0, ["SYSTEM_BATTERY", "STUCK"]),
        (MOTOR, OFF, 5, ["instance 5", "0 to 4"]),
        (MOTOR, OFF, -1, ["instance -1", "0 to 4"]),
        (GPS, OFF, 2, ["instance 2", "0 or 1"]),
    ],
)
def test_what_is_not_simulated_is_refused_with_the_reason(unit, kind, instance, words):
    sim = aloft()
    reason = sim.inject_failure(unit, kind, instance)
    assert reason is not None
    for word in words:
        assert word in reason
    assert texts(sim) == []


def test_ok_heals_what_the_scenario_began_but_not_what_cannot_heal():
    sim = aloft(
        fault(What.MOCAP, Kind.OFF, start_s=0.1, duration_s=5.0), fault(What.BATTERY, Kind.LOSS, start_s=0.1)
    )
    sim.advance(200)
    assert len(texts(sim)) == 2
    assert sim.inject_failure(VIO, OK, 0) is None
    assert texts(sim) == ["Fault over: mocap off"]
    assert sim.inject_failure(BATTERY, OK, 0) is None
    assert texts(sim) == []
    hold(sim, 6.0)
    assert texts(sim) == []  # its planned end does not come a second time


def test_a_planned_fault_comes_after_a_healing():
    sim = aloft(fault(What.MOTOR, Kind.WEAK, start_s=0.5, value=0.9))
    sim.advance(100)
    assert sim.inject_failure(MOTOR, OK, 0) is None
    sim.advance(500)
    assert texts(sim) == ["Fault: motor 2 weak 0.9"]


def test_wire_failures_concern_both_directions():
    sim = aloft()
    assert not sim.faults.link.active(Way.IN)
    assert sim.inject_failure(LINK, WRONG, 0) is None
    assert texts(sim) == [
        "Fault: link out reorder 0.1",
        "Fault: link in reorder 0.1",
        "Fault: link out duplicate 0.1",
        "Fault: link in duplicate 0.1",
    ]
    assert sim.faults.link.active(Way.IN)
    assert sim.faults.link.active(Way.OUT)


def test_the_number_of_faults_is_bounded():
    many = [Fault(What.MOCAP, Kind.WRONG, offset_m=(0.0001 * k, 0.0, 0.0)) for k in range(RUNNING_MAX)]
    sim = aloft(*many)
    sim.advance(1)
    assert "at most 64" in sim.inject_failure(MOTOR, OFF, 0)
    assert sim.inject_failure(VIO, OK, 0) is None
    assert sim.inject_failure(MOTOR, OFF, 1) is None
