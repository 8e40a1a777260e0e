"""Checks for any filter: contact is told from a descent, and a vehicle that does not follow is noticed."""

from __future__ import annotations

from flightstack.core.parameters.flight import FlightConfig
from flightstack.verify.types import Check


def contact(config: FlightConfig, descent_m_s: float, key: str) -> Check:
    """Sinking as told is faster than what counts as standing."""
    found = config.contact.speed_m_s
    return Check(
        "contact.speed_m_s",
        "a vehicle that sinks as told is not taken for one that stands",
        descent_m_s - found,
        "m/s",
        f"found {found:g}, {key} is {descent_m_s:g}",
        f"lower contact.speed_m_s or raise {key}",
    )


def reaches_touchdown(config: FlightConfig) -> Check:
    """The height of the paper's touchdown rule lies above the pad."""
    found, stands_m = config.touchdown.height_m, config.touchdown.feet_below_reference_m
    return Check(
        "touchdown.height_m",
        "a vehicle standing on the pad is below the height at which the touchdown begins",
        found - stands_m,
        "m",
        f"found {found:g}, it stands at {stands_m:g} m",
        "raise touchdown.height_m",
    )


def notices(config: FlightConfig) -> Check:
    """A vehicle that stands still although it is told to fly lags behind by its speed times the memory."""
    found, most_s = config.checks.follow_lag_max_s, config.checks.follow_memory_s
    return Check(
        "checks.follow_lag_max_s",
        "a vehicle that does not move although told to at full speed is noticed",
        most_s - found,
        "s",
        f"found {found:g}, after long the sum is that of {most_s:g} s",
        "raise checks.follow_memory_s or lower checks.follow_lag_max_s",
    )
