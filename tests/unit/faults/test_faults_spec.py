"""Tests how ``[[fault]]`` tables define faults, and the reasons of rejections."""

import re
import tomllib
from pathlib import Path

import pytest

from flightstack.common.strict_toml import ConfigError, dumps, from_table, to_table
from sim.scenarios.fault_spec import TABLE, Kind
from sim.scenarios.scenario import Scenario, load, names
from tests.unit.faults.fault_helpers import CELLS, fault, table_row

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


def test_the_documents_scenarios_exist_and_have_faults():
    named = set(re.findall(r"`(fault_\w+)`", DOC))
    assert named == {name for name in names() if name.startswith("fault_")}
    assert all(load(name).fault for name in named)
