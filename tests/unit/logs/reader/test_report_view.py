"""Tests values that the report computes from a log, and the data for viewers."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from flightstack.cli.main import main
from flightstack.common.options import declared
from flightstack.config import load, path_of
from flightstack.config.options import Repeated
from flightstack.core.safety.barrier import RobustBarrier
from flightstack.core.safety.qp_filter import SafetyFilter
from flightstack.core.types import FilterStatus, Phase
from flightstack.launch.run_options import RunOptions
from logs.curves import estimate_errors, held_margin_m
from logs.reader.flight import load_fleet, load_flight
from logs.report.derived import fault_spans
from logs.report.report import command, repeat_section
from tests.synthetic_flight import BARRIER, BOX, landing, write_log
from tests.unit.logs.helpers import record

CONFIG = path_of("crazyflie")
MARGIN_M, FADE_M = 0.04, 0.06


@pytest.fixture
def written(tmp_path):
    def write(rows, **more):
        return load_flight(write_log(tmp_path / "flight.mcap", rows, **more))

    return write


def test_the_margin_is_read_back_from_what_the_filter_left(written):
    """The margin computed from the logged slack equals the filter's margin, which fades above the pad."""
    config = dataclasses.replace(load(CONFIG), filter="robust")
    barrier = RobustBarrier(BARRIER, MARGIN_M, FADE_M)
    solver = SafetyFilter(config.robust.rate_1_s)
    rows, box = landing(), (tuple(-b for b in BOX), BOX)
    seen = []
    for row in rows.steps:
        if row.phase == Phase.APPROACH and row.own_valid:
            e = tuple(p - q for p, q in zip(row.own_position_enu_m, row.target_position_enu_m, strict=True))
            h, gradient, dh_dt = barrier.evaluate(e, row.target_velocity_enu_m_s)
            found = solver.solve(row.nominal_enu_m_s, h, gradient, dh_dt, *box)
            row = row._replace(
                gradient=gradient, dh_dt_m_s=dh_dt, filtered_enu_m_s=found.velocity_enu_m_s,
                slack_m_s=found.slack_m_s, filter_status=found.status, h_m=BARRIER.h(e),
            )  # fmt: skip
        else:
            row = row._replace(filter_status=FilterStatus.NOT_RUN)
        seen.append(row)
    rows.steps = seen
    flight = dataclasses.replace(written(rows), config=config)
    margin_m, steps = held_margin_m(flight), flight.steps
    ran = steps.phase == Phase.APPROACH
    expected = MARGIN_M * (1.0 - np.exp(-((steps.d_m / FADE_M) ** 2)))
    assert np.isnan(margin_m[~ran]).all()
    np.testing.assert_allclose(margin_m[ran], expected[ran], atol=1e-9)
    assert held_margin_m(dataclasses.replace(flight, config=None)) is None


def test_errors_are_what_was_put_into_the_estimate(written):
    rows = landing()
    shift = (0.01, -0.02, 0.03)

    def moved(position):
        return tuple(p + s for p, s in zip(position, shift, strict=True))

    truth = {row.tick: row for row in rows.truth}
    rows.steps = [
        row._replace(
            own_position_enu_m=moved(truth[row.tick].position_enu_m),
            target_position_enu_m=truth[row.tick].pad_position_enu_m,
        )
        for row in rows.steps
        if row.tick in truth
    ]  # fmt: skip
    errors = estimate_errors(written(rows))
    known = np.isfinite(errors["vehicle"][:, 0])
    assert known.mean() > 0.9
    np.testing.assert_allclose(errors["vehicle"][known], np.tile(shift, (known.sum(), 1)), atol=1e-9)
    np.testing.assert_allclose(errors["target"][known], 0.0, atol=1e-9)


def test_faults_have_begin_and_end_and_count_once(written):
    rows = landing()
    at = [row.stamp_ns for row in rows.steps]
    rows.events = [
        (at[100], 30, "Fault: motor 2 weak"),
        (at[101], 30, "vehicle: Fault: motor 2 weak"),  # the onboard process also logs the vehicle's texts
        (at[200], 20, "Fault over: motor 2 weak"),
        (at[201], 20, "vehicle: Fault over: motor 2 weak"),
        (at[300], 30, "Fault: target odometry off"),
    ]
    flight = written(rows)
    spans = fault_spans(flight)
    assert [s.text for s in spans] == ["motor 2 weak", "target odometry off"]
    assert (spans[0].begin_s, spans[0].end_s) == pytest.approx((1.0, 2.0))
    assert spans[1].end_s == flight.duration_s


def test_the_command_repeats_the_run(written, tmp_path):
    run = {"scenario": "my odd name", "seed": "7", "filter": "robust", "mode": "lockstep"}
    told = "flightstack sitl --scenario 'a b.toml' --seed 7 --filter robust --lockstep"
    assert command(run, "a b.toml") == told
    written(landing())
    fleet = load_fleet(tmp_path / "flight.mcap")
    fleet = dataclasses.replace(fleet, metadata={"fleet": run}, attachments={"scenario.toml": b"name = 'x'"})
    text = repeat_section(fleet)
    assert "--scenario scenario.toml --seed 7 --filter robust --lockstep" in text
    assert "--scenario &#39;my odd name&#39;" in text
    assert "not the log of a simulated run" in repeat_section(dataclasses.replace(fleet, attachments={}))


# options that do not change the flight, or whose values are in the scenario that the log contains
NOT_TOLD = {"scenario", "seed", "filter", "lockstep", "out", "listen", "zenoh_config", "ros2_where", "view"}
NOT_TOLD |= {"ros_domain", "instance", "members", "runs", "as_json", "with_report", "px4_sih", "ardupilot"}


def test_every_option_that_changes_a_run_is_in_its_log_and_in_the_command():
    given = {
        "duration_s": 20.0, "signing_key": Path("a key"), "autopilot": "ardupilot",
        "accept_release": True, "config_file": Path("paper"), "px4": Path("px4"), "mocap": True, "speed": 2.0,
    }  # fmt: skip
    options = RunOptions(scenario="room", **given)
    told = given.keys() | {each.name for each in declared(Repeated)}
    assert told == {field.name for field in dataclasses.fields(RunOptions)} - NOT_TOLD
    assert RunOptions(scenario="room").described() == {}
    names = {"config_file": "config", "px4": "program"}
    assert options.described().keys() - {"vehicle"} == {names.get(name, name) for name in given}
    assert command({"seed": "7", **options.described()}, "scenario.toml") == (
        "flightstack sitl --scenario scenario.toml --seed 7 --px4 px4 "
        "--autopilot ardupilot --accept-release --speed 2 --duration 20 --signing-key 'a key' --mocap"
    )


@pytest.mark.slow
def test_a_broken_log_is_shown_up_to_its_break(tmp_path):
    killed = record(tmp_path / "killed.mcap", close=False)
    flight = load_flight(killed)
    assert flight.problems
    assert len(flight.steps.t_s) > 200
    done = CliRunner().invoke(main, ["view", str(killed), "--save", str(tmp_path / "killed.rrd")])
    assert done.exit_code == 1
    assert "the log is broken" in done.output
    assert (tmp_path / "killed.rrd").stat().st_size > 10_000
