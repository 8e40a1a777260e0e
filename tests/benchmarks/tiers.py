"""Limits of each tier for the results of a campaign with the robust filter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from sim.campaign.rows import Row
from sim.campaign.summary import count, quantile


class Tier(Enum):
    """The scenarios that have limits; the value is the name of the scenario."""

    LAB = "lab"
    ROOM = "room"
    FIELD = "field"
    STORM = "storm"
    DECK = "deck"


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a campaign; crashes and undeclared misses are never allowed."""

    landed_min: float  # lower limit of the fraction of flights that land
    violations_max: float  # upper limit of the fraction of flights that violate the barrier
    error_m: tuple[float, float]  # maximum allowed median and 95th percentile of the touchdown error, m
    # maximum allowed 95th percentiles of the touchdown speed relative to the pad, m/s
    vertical_m_s: float
    horizontal_m_s: float
    slower_max: float | None  # maximum median landing time over that of the paper's filter; None: no limit


LIMITS: dict[Tier, Limits] = {
    Tier.LAB: Limits(0.999, 0.0, (0.010, 0.025), 0.25, 0.10, 1.25),
    Tier.ROOM: Limits(0.995, 0.0, (0.020, 0.040), 0.40, 0.25, None),
    Tier.FIELD: Limits(0.995, 0.0, (0.020, 0.050), 0.30, 0.15, 1.25),
    Tier.STORM: Limits(0.97, 0.001, (0.040, 0.080), 0.40, 0.25, None),
    Tier.DECK: Limits(0.995, 0.0, (0.020, 0.050), 0.35, 0.15, None),
}


def misses(tier: Tier, rows: Sequence[Row], paper: Sequence[Row] | None) -> list[str]:
    """Return the limits that a campaign does not meet, as text; empty if it meets all.

    ``tier``: tier of the limits; ``rows``: campaign rows; ``paper``: rows of the paper's filter on the same
    scenario; without these rows, a limit on the landing time counts as not met.
    """
    limits, counts = LIMITS[tier], count(rows)
    n = counts["runs"]
    found = []

    def ask(name: str, value: float | None, most: float, unit: str, scale: float = 1.0) -> None:
        if value is None:
            found.append(f"{name}: not known, at most {most * scale:g} {unit} asked")
        elif not value <= most:
            found.append(f"{name}: {value * scale:.4g} {unit}, at most {most * scale:g} {unit} asked")

    if counts["landed"] < limits.landed_min * n:
        found.append(f"landed: {counts['landed']} of {n}, at least {100.0 * limits.landed_min:g} % asked")
    for name, key in (("crashes", "crashes"), ("misses nobody declared", "undeclared_misses")):
        if number := counts[key]:
            found.append(f"{name}: {number} of {n}, none allowed")
    if counts["violations"] > limits.violations_max * n:
        found.append(
            f"violations: {counts['violations']} of {n}, at most {100.0 * limits.violations_max:g} % allowed"
        )
    for name, column, share, most in (
        ("touchdown error, median", "touchdown_error_m", 0.5, limits.error_m[0]),
        ("touchdown error, 95 %", "touchdown_error_m", 0.95, limits.error_m[1]),
        ("touchdown speed, vertical, 95 %", "touchdown_speed_vertical_m_s", 0.95, limits.vertical_m_s),
        ("touchdown speed, horizontal, 95 %", "touchdown_speed_horizontal_m_s", 0.95, limits.horizontal_m_s),
    ):
        unit, scale = ("cm", 100.0) if column == "touchdown_error_m" else ("m/s", 1.0)
        ask(name, quantile(rows, column, share), most, unit, scale)
    if limits.slower_max is not None:
        ask(
            "median time to land over that of the paper's filter", _slower(rows, paper), limits.slower_max, ""
        )
    return found


def _slower(rows: Sequence[Row], paper: Sequence[Row] | None) -> float | None:
    own = quantile(rows, "time_to_land_s", 0.5)
    other = quantile(paper, "time_to_land_s", 0.5) if paper is not None else None
    return own / other if own is not None and other else None
