"""A quick run breaks off what needs much processor time, and nothing else."""

import pytest

from tests import quick

pytest_plugins = ["pytester"]


@pytest.mark.parametrize(
    ("options", "outcomes"), [((), {"passed": 3}), (("--quick",), {"passed": 1, "skipped": 2})]
)
def test_a_slow_test_and_a_slow_fixture_are_broken_off_in_a_quick_run_alone(
    pytester, monkeypatch, options, outcomes
):
    monkeypatch.setattr(quick, "CPU_MAX_S", 0.2)
    pytester.makeconftest(
        """
        from tests.quick import pytest_runtest_call, pytest_runtest_setup

        def pytest_addoption(parser):
            parser.addoption("--quick", action="store_true")
        """
    )
    pytester.makepyfile(
        """
        import time
        import pytest

        def spend():
            until_s = time.process_time() + 0.6
            while time.process_time() < until_s:
                pass

        @pytest.fixture
        def slow():
            spend()

        def test_slow():
            spend()

        def test_with_a_slow_fixture(slow):
            pass

        def test_quick():
            pass
        """
    )
    found = pytester.runpytest_inprocess("-p", "no:cacheprovider", "-rs", *options)
    found.assert_outcomes(**outcomes)
    if options:
        found.stdout.fnmatch_lines(["*needs more than 0.2 s of processor time: mark it slow*"])


@pytest.mark.parametrize("pattern", quick.SLOW)
def test_every_slow_module_exists(pattern):
    assert list((quick.ROOT / "tests" / "unit").glob(pattern))
