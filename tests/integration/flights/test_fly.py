"""``flightstack fly``: a flight of a vehicle and a target that are somebody else's, by one command."""

import json
import signal
import subprocess
from contextlib import contextmanager

import pytest

from flightstack.common.processes import Child, Port
from flightstack.common.strict_toml import dumps
from logs.reader.flight import load_flight
from sim.scenarios.scenario import load
from tests.integration.runs import COMMAND, WALL_MAX_S, called, flightstack

pytestmark = pytest.mark.xdist_group("real-time")

SCENARIO = "grid"


@contextmanager
def theirs(folder):
    """Vehicle and robot that run by themselves; yields the words that plug them in."""
    config = folder / "mine.toml"
    config.write_text(dumps(load(SCENARIO).onboard))
    ports, children = [Port(), Port()], []
    target_at, onboard_at = (port.endpoint for port in ports)
    try:
        common = ["--scenario", SCENARIO, "--duration", "200"]
        vehicle = Child(
            "vehicle", ["vehicle", *common, "--connect", target_at, "--url", "udpin:127.0.0.1:0"], folder
        )
        children.append(vehicle)
        target = Child("target", ["target", *common, "--listen", target_at, "--connect", onboard_at], folder)
        children.append(target)
        url = vehicle.wait_ready().replace("udpin", "udpout")
        target.wait_ready()
        yield [
            "--vehicle", url, "--target", "cf1/target/odom", "--connect", target_at, "--listen", onboard_at,
            "--config", str(config), "--target-offset", "0", "0", "0",
        ]  # fmt: skip
    finally:
        for child in reversed(children):
            child.end()
        for port in ports:
            port.close()


def test_lands_records_judges_and_reports(tmp_path):
    with theirs(tmp_path) as words:
        done = flightstack("fly", *words, "--out", tmp_path / "flight", "--json")
    assert done.code == 0, done.err
    found = done.json
    assert found["outcome"] == "landed"
    assert found["judged_from"] == "estimate"
    assert found["touchdown_error_m"] <= 0.10
    assert found["config"] == "mine"
    flight = load_flight(found["log"])
    assert flight.complete
    assert flight.truth is None
    assert flight.metadata["run"]["vehicle"] == words[1]
    assert flight.metadata["run"]["pad_radius_m"] == "0.1"
    assert flight.metadata["preflight"]["problem"] == ""
    assert (tmp_path / "flight" / "report.html").stat().st_size > 100_000


def test_ctrl_c_flies_clear_and_lands_before_anything_ends(tmp_path):
    out = tmp_path / "flight"
    with theirs(tmp_path) as words:
        run = subprocess.Popen(
            [*COMMAND, "fly", *words, "--out", str(out), "--no-report"],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        said = []
        for line in run.stdout:
            said.append(line)
            if "-> APPROACH" in line:
                run.send_signal(signal.SIGINT)
                break
        said.append(run.communicate(timeout=WALL_MAX_S)[0])
    assert run.returncode == 1, said
    flight = load_flight(out / "flight.mcap")
    assert flight.complete
    assert any("-> ABORT" in event.text for event in flight.events)
    assert flight.steps.own_position_enu_m[-1, 2] < 0.1


def test_without_a_log_the_onboard_process_is_believed_and_nothing_measured(tmp_path):
    with theirs(tmp_path) as words:
        out = tmp_path / "flight"
        done = flightstack("fly", *words, "--no-record", "--out", out, "--json")
    assert done.code == 0, done.err
    assert (done.json["outcome"], done.json["log"]) == ("landed", None)
    assert done.json["touchdown_error_m"] is None
    assert not list(out.glob("*.mcap"))


def test_a_vehicle_that_does_not_answer_is_not_flown_and_said_so(tmp_path):
    words = ["--vehicle", "udpout:127.0.0.1:9", "--config", "crazyflie", "--duration", "1"]
    done = flightstack("fly", *words, "--out", tmp_path, "--json")
    assert done.code == 1
    assert done.json["outcome"] is None
    assert "no heartbeat" in done.json["reason"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--vehicle", "udpin:0.0.0.0:0", "--config", "crazyflie"), "--signing-key FILE"),
        (("--vehicle", "udpout:127.0.0.1:9", "--config", "nowhere"), "px4"),
    ],
)
def test_wrong_input_is_status_2_with_what_to_do(tmp_path, words, said):
    done = called("fly", *words, "--out", tmp_path / "flight")
    assert done.code == 2
    assert said in done.err


def test_onboard_alone_records_unless_declined(tmp_path):
    words = ["onboard", "--vehicle", "udpout:127.0.0.1:9", "--config", "crazyflie", "--duration", "1"]
    done = flightstack(*words, cwd=tmp_path)
    assert done.code == 1
    (log,) = tmp_path.glob("runs/*/flight.mcap")
    assert f"log {log.relative_to(tmp_path)}" in done.out
    declined = tmp_path / "declined"
    declined.mkdir()
    assert flightstack(*words, "--no-record", cwd=declined).code == 1
    assert not list(declined.iterdir())


def test_the_configurations_are_listed_and_printed():
    listed = flightstack("config")
    assert listed.code == 0
    assert {line.split()[0] for line in listed.out.splitlines()} >= {"crazyflie", "sitl-1kg"}
    printed = flightstack("config", "crazyflie")
    assert "[barrier]" in printed.out
    assert flightstack("config", "nowhere").code == 2
    assert json.loads(flightstack("check", "crazyflie", "--json").out)["config"] == "crazyflie"
