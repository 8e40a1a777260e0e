"""Processes of the tests that have loaded everything are processes of their own."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from flightstack.common.processes import Child
from tests.processes.bounded import PATIENCE_S, killed, line_of
from tests.processes.started import Started, StartedChild


def tell(code):
    print(
        Path.cwd(),
        os.environ["TOLD"],
        os.getsid(0) == os.getpid(),
        "sim.runners.vehicle_process" in sys.modules,
    )
    print("what went wrong", file=sys.stderr)
    sys.exit(code)


def sleep():
    print("asleep", flush=True)
    time.sleep(600.0)


@pytest.mark.parametrize("text", [True, False])
def test_output_status_folder_environment_and_session(tmp_path, monkeypatch, text):
    monkeypatch.setenv("TOLD", "this")
    child = Started(tell, 3, cwd=tmp_path, text=text)
    out, err = child.communicate(PATIENCE_S)
    if not text:
        out, err = out.decode(), err.decode()
    assert out == f"{tmp_path} this True True\n"
    assert err == "what went wrong\n"
    assert child.poll() == child.wait() == child.returncode == 3
    child.terminate()  # it has ended: nothing happens


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL, signal.SIGINT])
def test_it_has_no_handlers_of_the_tests_and_ends_by_a_signal(number):
    child = Started(sleep)
    try:
        assert line_of(child.stdout) == "asleep\n"
        with pytest.raises(subprocess.TimeoutExpired):
            child.wait(0.01)
        with pytest.raises(subprocess.TimeoutExpired):
            child.communicate(0.01)
        assert child.poll() is None
        child.send_signal(number)
        assert child.wait(PATIENCE_S) == (1 if number == signal.SIGINT else -number)  # KeyboardInterrupt
    finally:
        killed(child)


def test_a_child_of_the_launchers_kind_says_what_it_says_as_a_program(tmp_path):
    said = []
    for kind in (Child, StartedChild):
        child = kind("config", ["config", "crazyflie"], tmp_path)
        child.process.wait(PATIENCE_S)
        refused = kind("onboard", ["onboard", "--vehicle"], tmp_path)
        said.append((child.lines(1.0), child.end(), refused.process.wait(PATIENCE_S), refused.errors()))
        refused.end()
    assert said[0] == said[1]
    assert len(said[0][0]) > 20
    assert "requires an argument" in said[0][-1]
