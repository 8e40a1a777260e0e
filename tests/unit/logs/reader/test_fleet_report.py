"""Tests the report of a fleet, and the fleet in Rerun."""

import json
import re
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from flightstack.cli.main import main
from flightstack.core.types import Intent
from logs.recorder.markers import COLORS
from logs.report.report import write_report
from logs.verdict.verdict import judge_fleet

pytest.importorskip("plotly", reason="the report needs plotly: install the extra [report]")
MEMBERS = ("cf1", "cf2", "cf3")


@pytest.fixture(scope="module")
def read(fleet):
    return fleet.read


def run(*arguments):
    return CliRunner().invoke(main, [str(each) for each in arguments])


@pytest.fixture(scope="module")
def told(fleet, tmp_path_factory):
    """Write the report by the command, and return the JSON object that it prints."""
    folder = tmp_path_factory.mktemp("page")
    done = run("report", fleet.log, "--out", folder / "report.html", "--json")
    assert done.exit_code == 0
    assert [page.name for page in folder.iterdir()] == ["report.html"]
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.xdist_group("fleet_log")
def test_who_waited_for_whom_is_what_they_told(read):
    every = {name: flight.spans for name, flight in read.flights.items()}
    waits = {name: [s for s in spans if s.waits] for name, spans in every.items()}
    assert waits["cf1"] == []
    assert {s.gives_way_to for s in waits["cf2"]} == {("cf1",)}
    lengths_s = {name: sum(s.end_s - s.begin_s for s in spans) for name, spans in waits.items()}
    assert lengths_s["cf3"] > lengths_s["cf2"] > 1.0
    for name, spans in every.items():
        assert [a.end_s for a in spans[:-1]] == [b.begin_s for b in spans[1:]]
        assert spans[-1].intent is Intent.DOWN
        steps = read.flights[name].steps
        assert (spans[0].begin_s, spans[-1].end_s) == pytest.approx((steps.t_s[0], steps.t_s[-1]))
    goes = {
        name: next(s.begin_s for s in spans if s.intent is Intent.LANDING) for name, spans in every.items()
    }
    down = {name: spans[-1].begin_s for name, spans in every.items()}
    assert goes["cf2"] >= down["cf1"]  # one vehicle lands at a time
    assert goes["cf3"] >= down["cf2"]


@pytest.mark.slow
@pytest.mark.xdist_group("fleet_log")
def test_the_page_shows_all_members_together_and_each_of_them(told):
    text = Path(told["report"]).read_text(encoding="utf-8")
    assert "all 3 landed" in text
    assert "Mind when reading" not in text
    for member in MEMBERS:
        assert f'<a href="#{member}">{member}</a>' in text
        assert f'<h2 id="{member}">' in text
        assert text.count(f'class="figure" id="figure-{member}-') == 9
        assert told["vehicles"][member]["report"] == told["report"]
    assert text.count('class="figure"') == 3 + 9 * len(MEMBERS)
    assert text.count('class="columns"') == 1  # two tables side by side
    for words in ("waits for cf1", "cf2 right of way", "Save as scenario.toml", "times inside",
                  "flightstack sitl --scenario scenario.toml --seed 1 --filter robust --lockstep",
                  "flightstack replay flight.mcap --check<", "cf3.controller", "cf3 seed"):  # fmt: skip
        assert words in text
    assert re.search(r"<td>cf2</td><td>cf1</td>", text)  # waiting vehicle, vehicle with the right of way


@pytest.mark.slow
@pytest.mark.xdist_group("fleet_log")
@pytest.mark.parametrize(
    ("poor", "begins"),
    [
        (("cf3",), [f"{one} and cf3: the log does not show this pair to the end" for one in ("cf1", "cf2")]),
        (MEMBERS, ["the log is incomplete"]),
    ],
)
def test_the_page_names_the_pairs_that_may_have_collided(read, tmp_path, poor, begins):
    incomplete = {name: replace(read.flights[name], complete=False) for name in poor}
    cut = replace(read, flights={**read.flights, **incomplete})
    text = write_report(cut, judge_fleet(cut), tmp_path / "report.html").read_text(encoding="utf-8")
    ending = ": a collision or an ellipsoid violation cannot be excluded"
    assert re.findall(f"<li>([^<]*){ending}</li>", text) == begins


@pytest.mark.slow
@pytest.mark.xdist_group("fleet_log")
def test_the_paths_of_a_member_have_its_colour_and_its_group_of_the_legend(read):
    """A click in the legend hides the paths of one member, or one kind of marker of all members."""
    from logs.report.space import trajectory_3d

    lines, markers = defaultdict(set), defaultdict(set)
    for trace in trajectory_3d(read.flights).select_traces({"type": "scatter3d"}):
        if trace.mode == "markers":
            markers[trace.legendgroup].add(trace.name)
        else:
            lines[trace.legendgroup].add((trace.name, trace.line.color, trace.line.dash))
    rim = lines.pop(None)
    assert {name for name, *_ in rim} == {"rim of the pad"}
    assert dict(lines) == {
        name: {(f"{name} (true)", color, "solid"), (f"{name} (estimate)", color, "dash")}
        for name, color in zip(MEMBERS, COLORS, strict=False)
    }
    assert sorted(markers.values(), key=min) == [{"end"}, {"start"}, {"touchdown"}]
    assert not markers.keys() & lines.keys()


@pytest.mark.slow
@pytest.mark.xdist_group("fleet_log")
def test_the_verdict_is_printed_with_a_line_of_each_member(fleet):
    table = run("log", "verdict", fleet.log)
    assert table.exit_code == 0
    assert "cf3: touched " in table.output


@pytest.fixture(scope="module")
def saved(fleet, tmp_path_factory):
    """Return the path of the fleet's recording."""
    pytest.importorskip("rerun", reason="needs the extra [view]")  # an import of one second
    from logs.view.view import save

    out = tmp_path_factory.mktemp("view") / "fleet.rrd"
    save(fleet.log, out)
    return out


def chunks(rrd):
    from rerun.chunk import RrdReader

    return RrdReader(rrd).store().stream().to_chunks()


def curve(rrd, entity):
    return values(rrd, entity, "Scalars:scalars")


def values(rrd, entity, column):
    """Return the values of one column of a Rerun entity, in the order of time."""
    found = [
        value
        for chunk in chunks(rrd)
        if chunk.entity_path == entity and not chunk.is_static
        for value in chunk.to_record_batch().column(column).to_pylist()
    ]
    return [each[0] if each else None for each in found]


@pytest.mark.slow
@pytest.mark.xdist_group("fleet_log")
@pytest.mark.slow
def test_each_member_is_in_the_scene_at_its_place(fleet, saved):
    entities = {chunk.entity_path for chunk in chunks(saved)}
    read_log = fleet.read
    for member in MEMBERS:
        for what in (
            "vehicle/vehicle", "vehicle/ellipsoid", "target/pad", "target_pad/barrier", "vehicle_path",
            "target_path", "true_vehicle/body", "velocity/command",
        ):  # fmt: skip
            assert f"/world/{member}/{what}" in entities
        truth = read_log.flights[member].truth
        shown = values(saved, f"/world/{member}/true_vehicle", "Transform3D:translation")
        nearest = [np.abs(truth.position_enu_m - place).sum(1).min() for place in shown[::50]]
        assert max(nearest) < 1e-5
        steps = read_log.flights[member].steps
        assert curve(saved, f"/{member}/barrier/h/estimate") == pytest.approx(steps.h_m.tolist(), nan_ok=True)
    assert not {e for e in entities if e.startswith(("/world/vehicle", "/world/target", "/barrier"))}
