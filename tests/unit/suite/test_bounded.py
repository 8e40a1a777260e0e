"""Waits for processes end, whatever the process does."""

import subprocess
import sys

import pytest

from tests.processes.bounded import killed, line_of, lines_of

SHORT_S = 0.3


def started(code):
    return subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)


def test_lines_are_read_one_by_one_and_the_rest_is_left():
    child = started("print('one'); print(); print('three'); print('four')")
    assert line_of(child.stdout) == "one\n"
    assert [line for _, line in zip(range(2), lines_of(child.stdout, 60.0), strict=False)] == [
        "\n",
        "three\n",
    ]
    assert child.communicate()[0] == "four\n"
    assert killed(child) == ""


def test_a_process_that_says_nothing_or_half_a_line_is_not_waited_for_for_ever():
    for code in ("", "print('half', end='', flush=True); "):
        child = started(f"{code}import time; time.sleep(600)")
        with pytest.raises(AssertionError, match="no line within"):
            line_of(child.stdout, SHORT_S)
        killed(child)
        assert child.returncode < 0


def test_a_grandchild_that_holds_the_pipe_holds_up_nobody():
    sleeps = "import time; time.sleep(10)"
    child = started(
        f"import subprocess, sys; subprocess.Popen([sys.executable, '-c', '{sleeps}']); print('on')"
    )
    assert line_of(child.stdout) == "on\n"
    assert killed(child, SHORT_S) == ""
    assert child.stdout.closed
