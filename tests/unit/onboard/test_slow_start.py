"""Start-up on a slow computer: what works is waited for and says what it does; what hangs is named."""

import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from flightstack.common import processes
from flightstack.common.hangup import Stop
from flightstack.common.processes import Child, LaunchError
from flightstack.onboard import lockstep
from flightstack.onboard.runner import ClockStoppedError
from sim import clock

WORKS = "import time\nwhile time.process_time() < {}: pass\nprint('ready here', flush=True)"
SLEEPS = "import time\ntime.sleep(60)"


def child(tmp_path, code):
    return Child("slow", ["-c", code], tmp_path, program=[sys.executable])


def test_a_child_that_computes_is_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "START_TIME_MAX_S", 0.6)
    monkeypatch.setattr(processes, "_WORKING_S", 0.02)
    slow = child(tmp_path, WORKS.format(0.8))
    assert slow.wait_ready() == "here"
    slow.end()


@pytest.mark.parametrize(
    ("code", "work_max_s", "said"),
    [(SLEEPS, 60.0, "0.4 s without any"), ("while True: pass", 0.5, "not ready after 1 s of processor time")],
)
def test_a_child_that_hangs_is_not(tmp_path, monkeypatch, code, work_max_s, said):
    monkeypatch.setattr(processes, "START_TIME_MAX_S", 0.4 if code is SLEEPS else 20.0)
    monkeypatch.setattr(processes, "START_WORK_MAX_S", work_max_s)
    with pytest.raises(LaunchError, match="slow did not start: not ready") as raised:
        child(tmp_path, code).wait_ready()
    assert said in str(raised.value) or work_max_s < 1.0


def test_one_that_ends_says_why(tmp_path):
    with pytest.raises(LaunchError, match="slow did not start: no such thing"):
        child(tmp_path, "raise SystemExit('no such thing')").wait_ready()


def test_a_long_wait_says_what_it_waits_for_once(monkeypatch, capsys):
    monkeypatch.setattr(clock, "_SAID_S", 0.01)
    assert not clock.wait_until(lambda: False, Stop(), 0.2, pause_s=0.001, what="the robot")
    assert capsys.readouterr().err == "waits for the robot\n"


COMPILES = """
import numpy as np
from flightstack.compiled import jit
functions = []
for n in range(10):
    scope = {}
    exec(f"def f{n}(x):\\n    return x[0] + {n}.0", scope)
    scope[f"f{n}"].__module__ = "x"
    functions.append(jit.jitted(scope[f"f{n}"]))
with jit.telling():
    for each in functions:
        each(np.zeros(1))
jit.keep("all")
print(jit.is_kept("all"), jit.is_kept("more"))
"""


def test_compiling_says_how_far_it_is(tmp_path):
    code = COMPILES.replace("jit.jitted(", "jit.load_numba().njit(").replace(
        "functions = []", "functions = []\njit._made += [''] * 10"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env={"NUMBA_CACHE_DIR": str(tmp_path), "PATH": "/usr/bin"},
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    said = done.stderr.splitlines()
    shares = [int(line.split()[-2]) for line in said[:-1]]
    assert shares == sorted(set(shares))
    assert (shares[0], shares[-1], len(shares)) == (0, 90, 10)
    assert said[-1] == "flightstack: compiled"
    assert done.stdout == "True False\n"


@pytest.mark.parametrize("asked_before", [False, True])
def test_a_companion_says_that_it_waits_for_its_vehicle_and_not_for_ever(monkeypatch, capsys, asked_before):
    for name, value in {"SAID_S": -1.0, "FIRST_WAIT_MAX_S": 0.1, "LOST_RUN_MAX_S": 0.1}.items():
        monkeypatch.setattr(lockstep, name, value)
    endpoint = SimpleNamespace(wait=lambda _: time.sleep(0.001))
    link = SimpleNamespace(poll=lambda _: None, take_timesync=lambda: None, endpoint=endpoint)
    ticks = lockstep.VehicleTicks(SimpleNamespace(link=link), 100, lambda: False)
    if asked_before:
        ticks.passed(0)
    why = "no further message" if asked_before else "no vehicle asked for a tick within 0.1 s"
    with pytest.raises(ClockStoppedError, match=why):
        ticks.wait()
    assert capsys.readouterr().err.count("waits for the vehicle") == (not asked_before)
