"""Tests the command line: wrong input, help, lists, and the subcommands ``check`` and ``identify``."""

import json
import subprocess
import sys
import tomllib
from dataclasses import replace

import pytest
from click.testing import CliRunner

from flightstack.cli.main import GROUPS, VERBS, main
from flightstack.common.strict_toml import dumps, from_table, to_table
from flightstack.core.parameters.flight import FlightConfig
from sim.scenarios import scenario
from sim.vehicle.vehicle import VehicleSim
from tests.integration.runs import called, flightstack
from tests.integration.sim_processes import ROOT
from tests.unit.verify.certificate_helpers import config


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["sitl"], ["--scenario"]),
        (["sitl", "--scenario", "nowhere"], ["nowhere", "paper_moving_1"]),
        (["sitl", "--scenario", "paper_moving_1", "--seed", "-1"], ["--seed", "-1"]),
        (["sitl", "--scenario", "paper_moving_1", "--filter", "best"], ["best", "paper", "robust"]),
        (["sitl", "--scenario", "paper_moving_1", "--duration", "0"], ["--duration"]),
        (["sitl", "--scenario", "paper_moving_1", "--duration", "1e9"], ["--duration", "604800"]),
        (["onboard", "--target-offset", "0", "0", "1e3"], ["--target-offset", "1000", "5.0"]),
        (["vehicle", "--scenario", "paper_moving_1", "--url", "serial:/dev/x"], ["serial:", "udpin:HOST"]),
        (["vehicle", "--scenario", "fleet_3", "--url", "udpin:127.0.0.1:65534"],
         ["65534", "vehicle 3", "port 65536", "up to 65535"]),
        (["target", "--scenario", "paper_moving_1", "--listen", "here"], ["here", "tcp/127.0.0.1:7447"]),
        (["report", "absent.mcap"], ["absent.mcap"]),
        (["identify", "absent.mcap"], ["absent.mcap"]),
        (["check", "nowhere"], ["neither a file nor one of"]),
        (["fly"], ["fly"]),
    ],
)  # fmt: skip
def test_wrong_input_is_status_2_and_one_clear_line(arguments, words, tmp_path):
    run = flightstack if arguments[0] in ("target", "vehicle") else called
    result = run(*arguments, cwd=tmp_path)
    assert result.code == 2, result.err
    assert "Traceback" not in result.err
    for word in words:
        assert word in result.err
    assert list(tmp_path.iterdir()) == []  # the command left no file


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (("omega_1_s = 0.7", "omega_s = 0.7"), "wrong unit"),
        (("gain_1_s = [1.0, 1.0, 1.0]", "gains = [1.0, 1.0, 1.0]"), "unknown key"),
        (("velocity_max_m_s = [0.2, 0.2, 0.5]", "velocity_max_m_s = [0.05, 0.05, 0.05]"), "outruns the box"),
        (("speed_m_s = 0.1\n", "speed_m_s = 0.5\n"), "speed_max_m_s"),
    ],
)  # fmt: skip
def test_a_scenario_that_must_not_fly_is_refused_before_anything_starts(change, word, tmp_path):
    text = flightstack("scenarios", "paper_moving_1").out
    assert change[0] in text
    file = tmp_path / "changed.toml"
    file.write_text(text.replace(*change))
    result = called("sitl", "--scenario", file, "--lockstep", "--json", "--out", tmp_path / "out")
    assert result.code == 2
    assert word in result.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("verb", VERBS)
def test_help_of_each_verb(verb):
    result = flightstack(verb, "--help")
    assert result.code == 0
    assert len(result.out.splitlines()) >= 5


def test_help_lists_every_verb_with_a_line_in_its_group():
    found, title = {}, ""
    for line in flightstack("--help").out.splitlines():
        if line.endswith(":") and not line.startswith(" "):
            title = line.removesuffix(":")
        elif title in GROUPS and line.strip():
            name, *words = line.split()
            assert words, name
            assert words[-1].endswith("."), name  # the line is a sentence
            found.setdefault(title, []).append(name)
    assert found == {title: list(verbs) for title, verbs in GROUPS.items()}


def test_a_verb_loads_nothing_of_the_others():
    code = (
        "import sys; from flightstack.cli.main import main; main(['key', '--help'], standalone_mode=False); "
        "print(*{name.partition('.')[0] for name in sys.modules})"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0, check=True
    )
    assert not {"numpy", "rich", "pymavlink", "sim", "logs", "bridge"} & set(done.stdout.split())


def run(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


def write(tmp_path, settings, name="onboard.toml"):
    path = tmp_path / name
    path.write_text(dumps(settings))
    return path


def test_a_proven_configuration_exits_0_and_all_shows_each_room(tmp_path):
    file = write(tmp_path, config())
    short = run("check", file)
    assert short.exit_code == 0
    assert len(short.output.splitlines()) == 2
    assert "proven: all" in short.output
    result = run("check", "--all", file)
    assert result.exit_code == 0
    assert "must not fly" not in result.output
    assert "not proven" not in result.output
    for word in ("barrier", "recovery", "drift", "filter robust"):
        assert word in result.output


def test_what_is_not_proven_exits_1_and_says_what_to_change(tmp_path):
    result = run("check", write(tmp_path, config(robust={"commit_speed_m_s": 0.5})))
    assert result.exit_code == 1
    assert "not proven: drift: " in result.output
    assert "proven: barrier" not in result.output  # only unproven checks are printed
    assert "lower robust.commit_speed_m_s" in result.output
    result = run("check", write(tmp_path, config(robust={"rate_1_s": 9.0})))
    assert result.exit_code == 1
    assert "must not fly" in result.output
    assert "lower robust.rate_1_s" in result.output


def test_json_holds_every_check(tmp_path):
    result = run("check", "--json", write(tmp_path, config(robust={"commit_speed_m_s": 0.5})))
    found = json.loads(result.output)
    assert (found["proven"], found["flies"], found["filter"]) == (False, True, "robust")
    (drift,) = (check for check in found["checks"] if check["name"] == "drift")
    assert not drift["proven"]
    assert drift["room"] < 0.0
    assert all(check["remedy"] is None for check in found["checks"] if check["proven"])


@pytest.mark.parametrize("name", [n for n in scenario.names() if n.startswith("paper")])
def test_the_papers_scenarios_pass_the_papers_checks(name):
    result = run("check", name)
    assert result.exit_code == 0, result.output
    assert "filter paper" in result.output


@pytest.mark.parametrize("name", ["sim", "logs"])
def test_a_package_of_another_project_with_the_same_name_is_named(name, tmp_path):
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").touch()
    program = (  # the imports are those of an installed wheel, not of the editable hook
        "import sys; sys.meta_path[:] = [f for f in sys.meta_path if '__editable__' not in f.__module__]\n"
        f"sys.path[:0] = [{str(tmp_path)!r}]; sys.path.append({str(ROOT)!r})\n"
        "from flightstack.cli.main import main\n"
        "main(dict(logs=['log', 'verdict', 'x'], sim=['scenarios'])[sys.argv[1]])"
    )
    done = subprocess.run([sys.executable, "-P", "-c", program, name], capture_output=True, text=True)
    assert done.returncode == 2, done.stderr
    assert f"{name!r} at {tmp_path / name} belongs to another project" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.fixture(scope="module")
def flights(flown):
    """Return the paths of the logs of two landings."""
    landings = [flown("lab", seed) for seed in (1, 2)]
    assert [landing.code for landing in landings] == [0, 0], landings
    return [landing.log for landing in landings]


def step_lag_s(axis):
    """Return the group delay, s: area between final value and step response, divided by the final value."""
    still = replace(scenario.load("lab"), wind=scenario.Wind())
    plant = VehicleSim(still, 1)
    plant.arm()
    for _ in range(300):
        plant.set_velocity((0.0, 0.0, 0.0), 0.0)
        plant.advance(10)
    command = tuple(0.3 if i == axis else 0.0 for i in range(3))
    flown = []
    for _ in range(250):
        flown.append(plant.truth().velocity_enu_m_s[axis])
        plant.set_velocity(command, 0.0)
        plant.advance(10)
    end = sum(flown[-50:]) / 50
    return sum(0.01 * (1.0 - v / end) for v in flown)


def test_the_simulated_crazyflie_is_identified_from_its_flights(flights):
    result = run("identify", *flights)
    assert result.exit_code == 0, result.output
    table = tomllib.loads(result.output)
    odometry = scenario.load("lab").odometry
    assert table["target"]["position_noise_m"] == pytest.approx(odometry.position_noise_m, rel=0.15)
    assert table["target"]["velocity_noise_m_s"] == pytest.approx(odometry.velocity_noise_m_s, rel=0.15)
    assert table["target"]["delay_s"] == pytest.approx(odometry.delay_s, abs=0.011)  # tolerance: one tick
    assert table["envelope"]["target_rate_hz"] == odometry.rate_hz
    loop = table["velocity_loop"]
    for key, axis in (("lag_xy_s", 0), ("lag_z_s", 2)):
        # the tolerance covers short flights with gusts over MAVLink, and motor lags that differ by 20 %
        assert loop[key] == pytest.approx(step_lag_s(axis), rel=0.3)
    whole = {name: {**values} for name, values in to_table(config()).items() if isinstance(values, dict)}
    for section, values in table.items():
        whole[section].update(values)
    assert from_table(FlightConfig, whole).velocity_loop.lag_z_s == loop["lag_z_s"]  # a valid configuration
    shown = json.loads(run("identify", "--json", *flights).output)
    assert shown["horizontal"]["lag_s"] == pytest.approx(loop["lag_xy_s"], abs=1e-3)
    assert shown["vertical"]["explained"] > 0.9


def test_one_short_flight_is_refused_with_what_to_fly(flights, tmp_path):
    short = tmp_path / "short.mcap"
    whole = flights[0].read_bytes()
    short.write_bytes(whole[: len(whole) // 6])
    result = run("identify", short)
    assert result.exit_code == 2, result.output
    assert "fly longer" in result.output
