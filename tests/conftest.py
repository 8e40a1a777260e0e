"""Options of the tests."""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--flights", type=int, default=1, metavar="N", help="fly each flight of a real client N times"
    )


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test with an argument ``flight`` is a whole flight and can be repeated."""
    if "flight" in metafunc.fixturenames:
        metafunc.parametrize("flight", range(metafunc.config.getoption("--flights")))
