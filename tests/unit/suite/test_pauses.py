"""A test in real time is repeated when the machine paused, and only then."""

from pathlib import Path

import pytest

from tests import pauses

pytest_plugins = ["pytester"]


@pytest.mark.parametrize(("pause_s", "passed"), [(0.0, 1), (9.0, 0)])
def test_a_failure_is_repeated_only_after_a_pause(pytester, monkeypatch, pause_s, passed):
    monkeypatch.setattr(pauses, "PAUSE_S", pause_s)
    monkeypatch.setattr(pauses, "CALM_WAIT_MAX_S", 0.0)
    pytester.makeconftest("from tests.pauses import pytest_runtest_protocol")
    pytester.makepyfile(
        """
        import pytest
        runs = []

        @pytest.mark.xdist_group("real-time")
        def test_flight(tmp_path):
            runs.append(tmp_path)
            assert len(runs) == 2

        def test_other():
            runs.append(0)
            assert len(runs) < 2
        """
    )
    pytester.runpytest_inprocess("-p", "no:cacheprovider").assert_outcomes(passed=passed, failed=2 - passed)


def failing(pytester, monkeypatch, limit, count):
    """Run so many tests in real time that fail on a machine that always pauses, with this limit at 0 s."""
    monkeypatch.setattr(pauses, "PAUSE_S", 0.0)
    monkeypatch.setattr(pauses, limit, 0.0)
    pytester.makeconftest("from tests.pauses import pytest_runtest_protocol")
    pytester.makepyfile(
        f"""
        import pytest

        @pytest.mark.xdist_group("real-time")
        @pytest.mark.parametrize("number", range({count}))
        def test_flight(number):
            assert False
        """
    )
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider", "-rs")
    result.assert_outcomes(skipped=count)
    return result.stdout


def test_a_machine_that_pauses_in_each_attempt_is_said_to_be_unfit(pytester, monkeypatch):
    said = failing(pytester, monkeypatch, "CALM_WAIT_MAX_S", 1)
    said.fnmatch_lines([f"*not a machine for real time*in {pauses.ATTEMPTS} attempts"])


def test_the_attempts_for_nothing_of_all_tests_have_one_bound(pytester, monkeypatch):
    said = failing(pytester, monkeypatch, "REPEATS_MAX_S", 2)
    said.fnmatch_lines(["*not a machine for real time*in 1 attempts"])


HANGS = """
import time
import pytest

runs = []

@pytest.fixture
def room():
    runs.append(0)
    yield
    if len(runs) == {hangs_in_end_of}:
        time.sleep(1000.0)

@pytest.mark.xdist_group("real-time")
def test_flight(room):
    assert len(runs) > 1
    time.sleep(1000.0)
"""


@pytest.mark.parametrize(("hangs_in_end_of", "said"), [(0, "E*Failed: Timeout*"), (1, "* in room")])
def test_what_comes_after_a_failure_has_a_bound_too(pytester, monkeypatch, hangs_in_end_of, said):
    """pytest stops its time-outs at a failure: another attempt, and the ends of fixtures, need others."""
    monkeypatch.setenv("PYTHONPATH", str(Path(pauses.__file__).parents[1]))
    pytester.makeconftest(
        """
        from tests import pauses
        from tests.overdue import pytest_exception_interact
        from tests.pauses import pytest_runtest_protocol
        pauses.PAUSE_S = pauses.CALM_WAIT_MAX_S = 0.0
        pauses.HANGS_S = 1.0
        """
    )
    pytester.makepyfile(HANGS.format(hangs_in_end_of=hangs_in_end_of))
    bounds = ["-o", "timeout=2", "-o", "faulthandler_timeout=3", "-o", "faulthandler_exit_on_timeout=true"]
    ended = pytester.runpytest_subprocess("-p", "no:cacheprovider", *bounds, timeout=60)
    assert ended.ret == 1  # also where another attempt follows the one that hung: it hangs, too
    (ended.stderr if hangs_in_end_of else ended.stdout).fnmatch_lines([said])
