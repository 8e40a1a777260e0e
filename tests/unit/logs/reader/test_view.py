"""Layouts that ship with the package, and the rules of names that viewers and ROS 2 have."""

from __future__ import annotations

import json
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner

from flightstack.cli.main import main
from logs.reader.reader import LogError
from logs.view.read import column, every, read
from logs.view.scene import NAMES, layout
from tests.unit.logs.reader.test_reader import record


def test_the_shipped_files_parse_and_name_every_panel():
    foxglove = json.loads(layout("foxglove.json"))
    used = set()

    def walk(node):
        if isinstance(node, str):
            used.add(node)
        else:
            walk(node["first"])
            walk(node["second"])
            assert node["direction"] in ("row", "column")

    walk(foxglove["layout"])
    for panel, config in foxglove["configById"].items():
        if panel.startswith("Tab!"):
            for tab in config["tabs"]:
                walk(tab["layout"])
    assert used == set(foxglove["configById"])
    root = ElementTree.fromstring(layout("plotjuggler.xml"))
    for splitter in root.iter("DockSplitter"):
        sizes = [float(s) for s in splitter.get("sizes").split(";")]
        assert len(sizes) == int(splitter.get("count")) == len(splitter)
        assert sum(sizes) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_another_name_space(name):
    text = layout(name, "lab/cf7")
    assert "/cf1/" not in text
    assert "/lab/cf7/controller/step" in text


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return record(tmp_path_factory.mktemp("flight") / "flight.mcap")


def run(*arguments):
    return CliRunner().invoke(main, ["view", *map(str, arguments)])


def test_layouts_are_written_once(log, tmp_path):
    done = run(log, "--layouts", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == sorted(NAMES)
    again = run(log, "--layouts", tmp_path / "out")
    assert again.exit_code == 2
    assert "--force" in again.output
    assert run(log, "--layouts", tmp_path / "out", "--force").exit_code == 0


def test_wrong_files_are_refused(tmp_path):
    assert run(tmp_path / "none.mcap", "--save", tmp_path / "x.rrd").exit_code == 2
    (tmp_path / "text.mcap").write_text("no log")
    done = run(tmp_path / "text.mcap", "--save", tmp_path / "x.rrd")
    assert done.exit_code == 2
    assert "not an MCAP file" in done.output
    assert not (tmp_path / "x.rrd").exists()


def test_a_log_without_a_flight_is_refused(tmp_path):
    with pytest.raises(LogError, match="no flight to show"):
        read(record(tmp_path / "empty.mcap", ticks=0))


def test_rows_of_a_log(log):
    seen = read(log)
    assert (seen.namespace, len(seen.steps), len(seen.truths), len(seen.events)) == ("cf1", 300, 300, 3)
    assert seen.origin_ns == seen.steps[0][0]
    np.testing.assert_allclose(column(seen.steps, "own_position_enu_m")[:, 0], 0.01 * np.arange(300))
    assert len(every(seen.steps, 20_000_000)) == 150
    assert seen.problem == ""


def test_a_broken_log_is_shown_up_to_its_break(tmp_path):
    killed = record(tmp_path / "killed.mcap", close=False)
    seen = read(killed)
    assert seen.problem
    assert len(seen.steps) > 200
    done = run(killed, "--save", tmp_path / "killed.rrd")
    assert done.exit_code == 1
    assert "the log is broken" in done.output
    assert (tmp_path / "killed.rrd").stat().st_size > 10_000
