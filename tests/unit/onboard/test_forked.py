"""Tests that a forked child, which uses its parent's modules, behaves like a program started anew."""

import json
import os
import subprocess
import sys

import pytest

from flightstack.common.processes import Child
from tests.processes.bounded import PATIENCE_S, gone, killed, line_of

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="forks on Linux only")
BEGIN = """
import os, signal, sys, threading, time
from pathlib import Path
from flightstack.common.processes import Forked
from flightstack.common.processes import Child
folder = Path(sys.argv[1])
def forked(run):
    with (folder / "errors").open("wb") as errors:
        return Forked("a-name-that-is-long", run, errors)
"""


def python(program, folder):
    """Return the output of a Python program, which has only one thread, unlike the process of the tests."""
    words = [sys.executable, "-c", BEGIN + program, str(folder)]
    return subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE_S, check=True).stdout


@pytest.mark.parametrize(
    ("run", "code", "said"),
    [
        ("None", 0, ""),
        ("sys.exit(3)", 3, ""),
        ("sys.exit()", 0, ""),
        ("sys.exit('why')", 1, "why\n"),
        ("1 / 0", 1, "ZeroDivisionError: division by zero\n"),
        ("os.kill(os.getpid(), signal.SIGKILL)", -9, ""),
    ],
)
def test_it_ends_as_a_program_does(tmp_path, run, code, said):
    assert python(f"print(forked(lambda: {run}).wait())", tmp_path) == f"{code}\n"
    errors = (tmp_path / "errors").read_text()
    assert errors.endswith(said)
    assert bool(errors) == bool(said)


def test_it_has_session_name_streams_and_signals_of_its_own_and_no_file_of_its_parent(tmp_path):
    program = """
signal.signal(signal.SIGTERM, lambda *_: None)
signal.signal(signal.SIGINT, lambda *_: None)
signal.signal(signal.SIGHUP, signal.SIG_IGN)
own = open(folder / "own", "wb")
def tell():
    import json
    print(json.dumps({
        "session": os.getsid(0) == os.getpid(),
        "name": Path("/proc/self/comm").read_text().strip(),
        "files": sorted(os.readlink(each) for each in Path("/proc/self/fd").iterdir() if each.exists()),
        "term": signal.getsignal(signal.SIGTERM) is signal.SIG_DFL,
        "int": signal.getsignal(signal.SIGINT) is signal.default_int_handler,
        "hup": signal.getsignal(signal.SIGHUP) is signal.SIG_IGN,
        "blocked": sorted(signal.pthread_sigmask(signal.SIG_BLOCK, ())),
        "input": sys.stdin.read(),
    }))
child = forked(tell)
print(child.stdout.read().decode())
print(child.wait(), signal.getsignal(signal.SIGTERM) is signal.SIG_DFL)
"""
    told, _, last = python(program, tmp_path).partition("\n")
    found = json.loads(told)
    assert found.pop("name") == "a-name-that-is-"
    files = found.pop("files")
    assert [path for path in files if "pipe" not in path] == [
        "/dev/null", f"{tmp_path}/errors",
    ]  # fmt: skip
    assert len(files) == 3
    assert found == {
        "session": True, "term": True, "int": True, "hup": True, "blocked": [], "input": "",
    }  # fmt: skip
    assert last.split() == ["0", "False"]


def test_it_ends_with_a_parent_that_is_killed(tmp_path):
    program = BEGIN + "child = forked(lambda: time.sleep(600.0)); print(child.pid, flush=True); child.wait()"
    parent = subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    try:
        child = int(line_of(parent.stdout))
        os.kill(child, 0)
        parent.kill()
        parent.wait(PATIENCE_S)
        assert gone(child), "it outlived its parent"
    finally:
        killed(parent)


def test_lines_that_come_with_the_one_that_is_waited_for_are_kept(tmp_path):
    child = Child("printf", [r"hello\nready at once\nfirst\nsec"], tmp_path, program=["printf"])
    try:
        assert child.wait_ready() == "at once"
        assert child.lines(0.0) == ["first"]
    finally:
        child.end()
