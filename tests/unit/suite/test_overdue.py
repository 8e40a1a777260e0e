"""A run that takes too long says what it waits for."""

from pathlib import Path

from tests import overdue

pytest_plugins = ["pytester"]


def test_tests_and_processes_are_told(pytester, monkeypatch):
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    monkeypatch.setenv("PYTHONPATH", str(Path(overdue.__file__).parents[1]))
    pytester.makeconftest(
        """
        from tests import overdue
        from tests.overdue import (
            pytest_runtest_logfinish, pytest_runtest_logstart, pytest_sessionfinish, pytest_sessionstart
        )
        overdue.AFTER_S = 6.0  # a busy machine takes seconds to begin
        """
    )
    pytester.makepyfile(
        """
        import time
        import pytest

        @pytest.mark.parametrize("seconds", [0.0, 12.0])
        def test_waits(seconds):
            time.sleep(seconds)
        """
    )
    ended = pytester.runpytest_subprocess("-p", "no:cacheprovider", "-n", "2", timeout=60)
    ended.assert_outcomes(passed=2)
    ended.stderr.fnmatch_lines(["after 6 s still under way:", "*test_waits?12.0?", "*pytest*"])
    assert "test_waits[0.0]" not in ended.stderr.str()
