"""Options of the tests."""

from __future__ import annotations

import hypothesis
import pytest

hypothesis.settings.register_profile("any machine", deadline=None)  # a busy one is no failure
hypothesis.settings.load_profile("any machine")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--flights", type=int, default=1, metavar="N", help="fly each flight of a real client N times"
    )


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test with an argument ``flight_number`` is a whole flight and can be repeated."""
    if "flight_number" in metafunc.fixturenames:
        metafunc.parametrize("flight_number", range(metafunc.config.getoption("--flights")))
