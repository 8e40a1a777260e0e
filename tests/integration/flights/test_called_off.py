"""Tests a signal during the start of a subcommand: no flight starts, no process remains, the status is 1."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from unittest import mock

import click
import pytest
from click.testing import CliRunner
from rich.console import Console

from flightstack.cli.main import main
from flightstack.common import hangup
from flightstack.common.terminal import Bar
from tests.integration.sim_processes import COMMAND
from tests.processes.bounded import PATIENCE_S, gone, killed, wait_for
from tests.processes.ports import free_port

pytestmark = pytest.mark.xdist_group("real-time")


def verb(name, port):
    """Return the command line of a subcommand that waits after its start."""
    vehicle = [
        "--vehicle",
        f"udpout:127.0.0.1:{port}",
        "--target",
        "cf1/target/odom",
        "--config",
        "crazyflie",
    ]
    return {
        "fly": ["fly", *vehicle, "--no-report", "--out", "out"],
        "sitl": ["sitl", "--scenario", "paper_static_1", "--no-report", "--out", "out"],
        "onboard": ["onboard", *vehicle],
    }[name]


def children(pid):
    return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.mark.parametrize(
    ("name", "number"), [("fly", signal.SIGTERM), ("sitl", signal.SIGINT), ("onboard", signal.SIGQUIT)]
)
def test_a_signal_while_the_recorder_starts_calls_the_flight_off(name, number, tmp_path):
    child = subprocess.Popen(
        [*COMMAND, *verb(name, free_port(udp=True))], cwd=tmp_path, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    try:
        wait_for(lambda: list(tmp_path.rglob("flight.mcap")), "the recorder")
        started = children(child.pid)
        os.kill(child.pid, number)
        said = child.communicate(timeout=PATIENCE_S)[0]
    finally:
        killed(child)
    assert child.returncode == 1, said
    assert "Traceback" not in said
    assert all(gone(pid) for pid in started)
    assert "TAKEOFF" not in said


def test_a_signal_whose_exception_was_dropped_is_raised_when_the_start_is_over(monkeypatch):
    monkeypatch.setattr(hangup, "_came", [])
    hangup.start()
    hangup.begun()
    with pytest.raises(hangup.CalledOffError, match="SIGTERM"):
        os.kill(os.getpid(), signal.SIGTERM)
    with pytest.raises(hangup.CalledOffError, match="SIGTERM"):
        hangup.Stop().install()


def test_a_command_with_many_results_obeys_a_dropped_signal_with_the_next_result(monkeypatch):
    monkeypatch.setattr(hangup, "_came", [])
    with Bar(Console(), "", None) as bar:
        bar.done("landed")
        monkeypatch.setattr(hangup, "_came", [hangup.CalledOffError("ended by SIGTERM")])
        with pytest.raises(hangup.CalledOffError):
            bar.done("landed")


@pytest.mark.parametrize("error", [ImportError("initialization failed"), ValueError("bad"), SystemError()])
def test_a_library_that_turns_the_exception_into_its_own_error_ends_the_verb_as_quietly(monkeypatch, error):
    monkeypatch.setattr(hangup, "_came", [hangup.CalledOffError("ended by SIGHUP")])
    with mock.patch.object(click.Group, "invoke", side_effect=error):
        result = CliRunner().invoke(main, ["scenarios"])
    assert (result.exit_code, result.stderr) == (1, "flightstack: ended by SIGHUP\n")


LOADS = """
import os, sys
sys.argv[0] = "flightstack"
import flightstack.cli
os.kill(os.getpid(), int(sys.argv[1]))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_while_the_command_loads_a_signal_ends_it_quietly(number):
    done = subprocess.run(
        [sys.executable, "-c", LOADS, str(int(number))], capture_output=True, timeout=PATIENCE_S
    )
    assert (done.returncode, done.stdout, done.stderr) == (-number, b"", b"")
