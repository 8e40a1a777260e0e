"""Finds recorded flights for tests: the excerpt in the repository, and the folder of all flights."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PIECE = ROOT / "tests" / "data" / "flights" / "figure8_medium_6s.parquet"
VARIABLE = "FLIGHTSTACK_FLIGHTS"


def folder() -> Path | None:
    """Return the folder of all recorded flights, from a variable or near the checkout; None: no folder."""
    named = os.environ.get(VARIABLE)
    places = [Path(named)] if named else [above / "shared" / "flights" for above in ROOT.parents[:3]]
    return next((place for place in places if any(place.glob("*.parquet"))), None)


def flights(*names: str) -> list[Path]:
    """Return the paths of the named flights, or of all; skip the test if the flights' folder is not found."""
    found = folder()
    if found is None:
        pytest.skip(f"no recorded flights here; {VARIABLE} names their folder")
    return [found / f"{name}.parquet" for name in names] or sorted(found.glob("*.parquet"))
