"""Finds the real PX4 program for the tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from sim.px4.program import find_px4

PX4_PLACE = "FLIGHTSTACK_PX4"  # environment variable: the program or its folder (sim.px4.program.find_px4)
ROOT = Path(__file__).parents[1]


def px4_place() -> Path | None:
    """Return the path of PX4's program or of the program's folder; None: no path is named, and none is found.

    The use of a named path without PX4 causes an error, so that no test is skipped by mistake.
    """
    named = os.environ.get(PX4_PLACE)
    if named:
        return Path(named)
    beside = [up / "shared" / "px4" for up in ROOT.parents]  # shared/px4 in any folder above the checkout
    return next((place for place in beside if (place / "px4").is_file()), None)


def px4_or_skip() -> Path:
    """Return the path of PX4; skip the test if there is no PX4."""
    place = px4_place()
    if place is None:
        pytest.skip(f"no PX4 here: {PX4_PLACE} names none, and there is no folder shared/px4 beside this one")
    return find_px4(place).binary
