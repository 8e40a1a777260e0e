"""Checks for every filter: contact is distinguished from a descent, and missing motion is detected."""

from __future__ import annotations

import math

from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.parameters.reserve import GRAVITY_M_S2
from flightstack.verify.types import PROOF, Check

STEADY_ERROR = 0.25  # ratio of tolerated velocity error, including gusts, to full speed
FALL_MAX_M_S = 1.0  # allowed fall speed, m/s: twice the landing speed; landing gear withstands this speed


def reaches_touchdown(config: FlightConfig) -> Check:
    """Check that the vehicle starts the touchdown above the height at which it stands."""
    found, stands_m = config.touchdown.height_m, config.touchdown.feet_below_reference_m
    return Check("touchdown.height_m",
                 "a vehicle standing on the pad is below the height at which the touchdown begins",
                 found - stands_m, "m", f"found {found:g}, it stands at {stands_m:g} m",
                 "raise touchdown.height_m")  # fmt: skip


def any_filter(config: FlightConfig, descent_m_s: float, key: str) -> list[Check]:
    """Return the checks of contact, following and fall; ``key``: configuration key of the descent speed."""
    checks, gap_m, touches_m_s = config.checks, config.contact.gap_m, config.contact.speed_m_s
    lag_s, memory_s = checks.follow_lag_max_s, checks.follow_memory_s
    speed = math.sqrt(2.0 * GRAVITY_M_S2 * gap_m)
    return [
        Check("contact.speed_m_s", "a vehicle that descends as commanded is not taken for one that stands",
              descent_m_s - touches_m_s, "m/s", f"found {touches_m_s:g}, {key} is {descent_m_s:g}",
              f"lower contact.speed_m_s or raise {key}"),
        # the tracking lag of a standing vehicle converges to the commanded speed times the decay time
        Check("checks.follow_lag_max_s", "a vehicle that does not move at a full-speed command is detected",
              memory_s - lag_s, "s",
              f"found {lag_s:g}, the tracking lag converges to {memory_s:g} s of flight",
              "raise checks.follow_memory_s or lower checks.follow_lag_max_s"),
        # The tracking lag of a velocity error e converges to e times the decay time. A vehicle that does not
        # follow lands where it is; this place is below the boundary if it is beside the pad.
        Check("checks.follow_memory_s",
              "a steady error of the velocity is not taken for a vehicle that does not follow",
              lag_s / memory_s - STEADY_ERROR, "of the full speed",
              f"found {memory_s:g} s, which allows an error of {lag_s / memory_s:.3g} of the full speed",
              f"lower checks.follow_memory_s to {lag_s / STEADY_ERROR:.3g}, or raise checks.follow_lag_max_s",
              PROOF),
        Check("contact.gap_m",
              f"a vehicle taken for standing, motors off, falls with {FALL_MAX_M_S:g} m/s at most",
              FALL_MAX_M_S - speed, "m/s", f"found {gap_m:g} m, from which it falls with {speed:.3g} m/s",
              "lower contact.gap_m", PROOF),
    ]  # fmt: skip
