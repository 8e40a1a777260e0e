"""Provides verdicts on synthetic logs for the tests of the reader."""

from dataclasses import replace

import pytest

from logs.reader.flight import load_flight
from logs.verdict.verdict import judge
from tests.synthetic_flight import write_log


@pytest.fixture
def verdict_of(tmp_path):
    def judged(rows, config=None, **how):
        flight = load_flight(write_log(tmp_path / "flight.mcap", rows, **how))
        return judge(replace(flight, config=config) if config is not None else flight)

    return judged
