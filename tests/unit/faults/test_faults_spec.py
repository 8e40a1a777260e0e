"""Tests how [[fault]] tables and MAV_CMD_INJECT_FAILURE define faults, and the reasons of rejections."""

import re
import tomllib
from pathlib import Path

import pytest

from flightstack.common.strict_toml import ConfigError, dumps, from_table, to_table
from sim.faults.link import Way
from sim.faults.schedule import RUNNING_MAX
from sim.faults.vehicle_faults import FAILURES
from sim.scenarios.fault_spec import TABLE, Fault, Kind, What
from sim.scenarios.scenario import Scenario, load, names
from tests.unit.faults.fault_helpers import CELLS, aloft, fault, hold, off_home, table_row

ONBOARD = {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5}, "takeoff": {"start_offset_m": [-1.0, 0.0, 0.7]}}


def parse(*faults: dict) -> Scenario:
    return from_table(Scenario, {"name": "t", "description": "", "onboard": ONBOARD, "fault": list(faults)})


def test_every_cell_is_read_from_toml_and_written_back():
    for what, kind in CELLS:
        made = fault(what, kind, start_s=1.5, duration_s=2.0 if TABLE[what][kind].healable else None)
        text = dumps(to_table(parse(to_table(made))))
        assert "[[fault]]" in text
        again = from_table(Scenario, tomllib.loads(text))
        assert again.fault == (made,)
        assert what.value.replace("_", " ") in made.text


def test_ends_of_every_range_are_taken_and_what_lies_beyond_is_not():
    for what, kind in CELLS:
        cell = TABLE[what][kind]
        for key, number in (("value", cell.value), ("period_s", cell.period)):
            if number is None:
                with pytest.raises(ConfigError, match=f"{key}: .*takes none"):
                    fault(what, kind, **{key: 1.0})
                continue
            assert number.low <= number.default <= number.high
            if kind is not Kind.INTERMITTENT:
                for good in (number.low, number.high):
                    fault(what, kind, **{key: good})
            for bad in (number.low - 1e-3, number.high + 1e-3):
                with pytest.raises(ConfigError, match=f"{key}: found .* allows"):
                    fault(what, kind, **{key: bad})


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"what": "motor", "kind": "delayed", "motor": 1}, ["kind", "'delayed'", "dead, stuck, weak"]),
        ({"what": "wings", "kind": "dead"}, ["fault[0].what", "'wings'", "motor"]),
        ({"what": "motor", "kind": "melted", "motor": 1}, ["fault[0].kind", "'melted'", "weak"]),
        ({"what": "motor", "kind": "dead"}, ["motor: missing", "1 to 4"]),
        ({"what": "motor", "kind": "dead", "motor": 5}, ["motor: found 5", "1 to 4"]),
        ({"what": "clock", "kind": "stuck", "motor": 1}, ["motor: clock stuck takes none"]),
        ({"what": "mocap", "kind": "wrong"}, ["offset_m, yaw_rad or both"]),
        ({"what": "mocap", "kind": "off", "yaw_rad": 0.1}, ["takes neither"]),
        ({"what": "mocap", "kind": "wrong", "offset_m": [0.0, 101.0, 0.0]}, ["offset_m", "-100 to 100"]),
        ({"what": "mocap", "kind": "off", "after": "landing"}, ["after", "time, takeoff"]),
        ({"what": "target_odometry", "kind": "off", "after": "takeoff"}, ["after", "time, landing"]),
        ({"what": "battery", "kind": "loss", "duration_s": 1.0}, ["duration_s", "cannot end"]),
        ({"what": "mocap", "kind": "off", "duration_s": 0.0}, ["duration_s", "0.001 to 3600"]),
        ({"what": "mocap", "kind": "off", "start_s": -1.0}, ["start_s", "0 to 3600"]),
        (
            {"what": "mocap", "kind": "intermittent", "value": 1.0, "period_s": 1.0},
            ["period_s", "must exceed"],
        ),
        ({"what": "mocap", "kind": "off", "start_ms": 5}, ["wrong unit", "start_s"]),
        ({"what": "mocap"}, ["fault[0].kind: missing"]),
    ],
)
def test_wrong_faults_are_refused_with_the_reason(table, words):
    with pytest.raises(ConfigError) as error:
        parse(table)
    for word in ["fault[0]", *words]:
        assert word in str(error.value)


DOC = (Path(__file__).parents[3] / "docs" / "reference" / "faults.md").read_text()


def test_every_example_of_the_document_is_a_scenario():
    blocks = re.findall(r"^```toml\n(.*?)^```", DOC, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 3
    for block in blocks:
        assert parse(*tomllib.loads(block)["fault"]).fault


def test_the_document_lists_every_fault_and_no_other():
    rows = re.findall(r"^\| `[a-z_]+` \| `[a-z_]+` \| .*$", DOC, re.MULTILINE)
    rows = [row for row in rows if not row.startswith("| `what`")]
    assert rows == [table_row(what, kind) for what, kind in CELLS]


def test_the_document_lists_every_failure_of_mavlink_and_no_other():
    rows = re.findall(r"^\| `[A-Z_]+` \((\d+)\) \| `[A-Z_]+` \((\d+)\) \| (.*) \|$", DOC, re.MULTILINE)
    found = {(int(unit), int(kind)): text for unit, kind, text in rows}
    assert set(found) == {(unit, kind) for unit, kinds in FAILURES.items() for kind in kinds}
    for (unit, kind), text in found.items():
        for made in FAILURES[unit][kind]((1,)):
            assert made.kind.value.replace("_", " ") in text


def test_the_documents_scenarios_exist_and_have_faults():
    named = set(re.findall(r"`(fault_\w+)`", DOC))
    assert named == {name for name in names() if name.startswith("fault_")}
    assert all(load(name).fault for name in named)


MOTOR, BATTERY, LINK = 101, 100, 105
GPS, VIO = 4, 6
OK, OFF, STUCK, WRONG = 0, 1, 2, 4
INJECTED = [(unit, kind) for unit, kinds in FAILURES.items() for kind in kinds]


def texts(sim):
    return [str(text) for text in sim.faults.take_texts()]


@pytest.mark.parametrize(("unit", "kind"), INJECTED)
def test_every_failure_takes_effect_and_ok_ends_it(unit, kind):
    sim = aloft()
    hold(sim, 0.1)
    assert sim.inject_failure(unit, kind, 1) is None
    began = texts(sim)
    assert began
    assert all(text.startswith("Fault: ") for text in began)
    assert sim.inject_failure(unit, kind, 1) is None
    assert texts(sim) == []  # the fault is already active
    hold(sim, 0.1)
    assert sim.inject_failure(unit, OK, 0) is None
    assert texts(sim) == [text.replace("Fault: ", "Fault over: ") for text in began]
    truths = hold(sim, 3.0)
    assert sim.state_text == "flying"
    assert off_home(truths[-1]) < 0.3  # the vehicle loses height if a motor is off for 0.1 s


def test_motors_are_counted_from_one_and_zero_is_all():
    sim = aloft()
    assert sim.inject_failure(MOTOR, OFF, 3) is None
    assert texts(sim) == ["Fault: motor 3 dead"]
    assert sim.inject_failure(MOTOR, OFF, 0) is None
    assert texts(sim) == ["Fault: motor 1 dead", "Fault: motor 2 dead", "Fault: motor 4 dead"]
    assert sim.inject_failure(MOTOR, OK, 2) is None
    assert texts(sim) == ["Fault over: motor 2 dead"]
    assert sim.cell[0].motor_share.tolist() == [0.0, 1.0, 0.0, 0.0]


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
    assert texts(sim) == []  # the scheduled end of the fault has no second effect


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
