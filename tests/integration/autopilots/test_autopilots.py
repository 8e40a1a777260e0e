"""Tests the pre-flight check, and `sitl` with the program PX4 (if found) and an imitation of ArduCopter."""

import os
import re
import signal
import sys
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import pytest

from flightstack.common.strict_toml import dumps
from flightstack.config import path_of
from flightstack.launch.run_options import Flies
from flightstack.launch.vehicles import VEHICLES
from logs.reader.flight import load_flight
from sim.scenarios.scenario import load, text
from sim.scenarios.tables import PathKind
from tests.integration.flights.test_sitl import KEYS
from tests.integration.runs import WALL_MAX_S, called, flightstack
from tests.integration.sim_processes import ROOT, verb
from tests.px4_place import px4_or_skip


@contextmanager
def vehicle_process(*arguments):
    """Run ``flightstack vehicle``, disarmed on the ground; yield the process and its URL for a client."""
    words = ("vehicle", "--scenario", "paper_moving_1", "--url", "udpin:127.0.0.1:0", *arguments)
    with verb(*words, within_s=WALL_MAX_S) as (child, ready):
        yield child, ready.split()[1].replace("udpin", "udpout")


def test_preflight_tells_safe_from_unsafe(tmp_path):
    with vehicle_process() as (_, url):
        done = flightstack("preflight", "--vehicle", url, "--json")
        assert (done.code, done.json["safe"], done.json["autopilot"]) == (0, True, "sitl")
        table = flightstack("preflight", "--vehicle", url)
        assert table.code == 0
        assert "may arm" in table.out
    with vehicle_process("--parameter", "COM_OF_LOSS_T=3", "--parameter", "MPC_Z_VEL_MAX_DN=0.3") as (_, url):
        done = flightstack("preflight", "--vehicle", url, "--json")
        unsafe = [p["name"] for p in done.json["parameters"] if p["level"] == "unsafe"]
        assert (done.code, unsafe) == (1, ["COM_OF_LOSS_T", "MPC_Z_VEL_MAX_DN"])
        config = tmp_path / "accepts.toml"
        text = path_of("crazyflie").read_text()
        accepted = 'accepted_parameters = ["COM_OF_LOSS_T", "MPC_Z_VEL_MAX_DN"]'
        config.write_text(re.sub(r"accepted_parameters = \[\]", accepted, text))
        done = flightstack("preflight", "--vehicle", url, "--config", config)
        assert done.code == 0, done.out


def test_preflight_of_nobody_and_of_nonsense():
    done = flightstack("preflight", "--vehicle", "udpout:127.0.0.1:9", "--wait", 0.5, "--json")
    assert (done.code, done.json["safe"]) == (1, False)
    assert "no heartbeat" in done.json["problem"]
    done = flightstack("preflight", "--vehicle", "tcp:127.0.0.1:9", "--wait", 0.5)
    assert done.code == 1  # the vehicle may start later, so onboard retries until its time-out
    assert "TCP connection to 127.0.0.1:9 cannot be opened (Connection refused): tried again" in done.err
    assert flightstack("preflight", "--vehicle", "udpout:127.0.0.1:9", "--autopilot", "betaflight").code == 2
    vehicle = ("vehicle", "--scenario", "lab", "--url", "udpin:127.0.0.1:0", "--duration", 1)
    wrong = flightstack(*vehicle, "--parameter", "COM_OF_LOSS_T=99")
    assert wrong.code == 2
    assert "allowed is 0.1 to 5" in wrong.err
    assert flightstack(*vehicle, "--parameter", "COM_OF_LOSS_T").code == 2


@pytest.mark.xdist_group("real-time")
def test_onboard_does_not_arm_what_is_unsafe():
    onboard = ("onboard", "--config", "crazyflie", "--no-record", "--duration", 20)
    with vehicle_process("--parameter", "COM_OF_LOSS_T=3") as (child, url):
        done = flightstack(*onboard, "--vehicle", url)
        assert done.code == 1, done.out
        assert "UNSAFE: COM_OF_LOSS_T is 3 s: for this time the vehicle flies with" in done.out
        assert "WAIT: unsafe parameters of the autopilot: COM_OF_LOSS_T" in done.out
        other = flightstack(*onboard, "--vehicle", url, "--autopilot", "ardupilot")
        assert other.code == 1
        assert "is for autopilot 3; choose the profile that fits" in other.out
        child.send_signal(signal.SIGTERM)
        assert "armed" not in child.communicate(timeout=WALL_MAX_S)[0].split()


ORIGIN_WGS84 = (47.397742, 8.545594, 10.0)


@pytest.mark.xdist_group("real-time")
@pytest.mark.xdist_group("stream 0")
def test_one_command_lands_a_real_px4_and_its_log_knows_the_truth(tmp_path):
    px4 = px4_or_skip()
    words = ("--scenario", "large", "--px4", px4, "--seed", 1, "--no-report", "--json")
    done = flightstack("sitl", *words, "--out", tmp_path / "run")
    assert done.code == 0, done.out + done.err
    found = done.json
    assert set(found) >= KEYS
    assert (found["outcome"], found["judged_from"]) == ("landed", "truth")
    assert found["touchdown_error_m"] < 0.3
    flight = load_flight(found["log"])
    assert flight.metadata["run"]["vehicle"] == "px4"
    assert "scenario.toml" in flight.attachments


@pytest.mark.xdist_group("real-time")
def test_arducopters_program_is_started_and_flown_over_tcp(tmp_path):
    scenario = load("grid")
    there = replace(scenario.onboard.vehicle, origin_wgs84=ORIGIN_WGS84)
    config, still = tmp_path / "config.toml", tmp_path / "still.toml"
    checks = replace(scenario.onboard.checks, wait_time_max_s=150.0)  # a busy machine is slow to start
    config.write_text(dumps(replace(scenario.onboard, vehicle=there, checks=checks)))
    target = replace(scenario.target, path=PathKind.STILL, speed_m_s=0.0)
    still.write_text(text(replace(scenario, name="still", target=target)))
    program = tmp_path / "arducopter"
    program.write_text(
        f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} -m tests.ardupilot_program "$@"\n'
    )
    program.chmod(0o755)
    done = flightstack(
        "sitl", "--scenario", still, "--ardupilot", program, "--config", config,
        "--instance", os.getpid() % 10, "--no-report", "--json", "--out", tmp_path / "run",
    )  # fmt: skip
    assert done.code == 0, done.out + done.err
    assert set(done.json) >= KEYS
    assert (done.json["outcome"], done.json["judged_from"]) == ("landed", "estimate")
    defaults = (tmp_path / "run" / "ardupilot" / "defaults.parm").read_text()
    assert "GUID_TIMEOUT 0.5\n" in defaults


@pytest.mark.parametrize(
    ("holds", "name"),
    [
        (b"\x7fELF..ArduCopter V4.6.3 (8f1c2a7)\x00", "ardupilot-1kg"),
        (b"ArduCopter V4.7.0\x00", "ardupilot47-1kg"),
        (b"\x00" * 5000 + b"ArduCopter V4.8.0-dev (1a2b)", "ardupilot47-1kg"),
        (b"ArduCopter V4.10.1", "ardupilot47-1kg"),
        (b"#!/bin/sh", "ardupilot47-1kg"),
        (b"", "ardupilot47-1kg"),
    ],
)
def test_arducopters_configuration_is_that_of_the_release_in_its_program(holds, name, tmp_path):
    program = tmp_path / "arducopter"
    program.write_bytes(holds)
    assert VEHICLES[Flies.ARDUPILOT].configuration(load("large"), program) == name


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--px4", "{program}", "--lockstep"), "--lockstep with --px4"),
        (("--px4", "{program}", "--ardupilot", "{program}"), "only one of"),
        (("--speed", "2"), "--lockstep is faster"),
        (("--ardupilot", "{program}", "--mocap"), "works with --px4 only, not with satellites"),
        (("--px4", "{program}"), "is not beside it"),
    ],
)
def test_what_does_not_go_together_is_refused(tmp_path, words, said):
    program = tmp_path / "px4"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    filled = [word.format(program=program) for word in words]
    done = called("sitl", "--scenario", "grid", *filled, "--config", "crazyflie", "--out", tmp_path / "run")
    assert done.code == 2, done.out + done.err
    assert said in done.err
    files = []
    for each in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # the descriptor may be closed by now
            files.append(str(each.readlink()))
    assert files
    assert not [name for name in files if "flightstack-px4-" in name]  # all instance numbers are released
