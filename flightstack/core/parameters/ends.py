"""How a flight begins and ends: take-off, touchdown, contact, and the way back up; sizes of vehicle and pad.

Defaults are a Crazyflie's on a pad of 20 cm; docs/how_to/autopilots.md says what else is the vehicle's.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Annotated

from flightstack.common.strict_toml import span
from flightstack.core.types import Vec3


class TouchdownRule(Enum):
    """When the motors go off."""

    PAPER = "paper"  # below touchdown.height_m inside the descending cone (paper V)
    CONTACT = "contact"  # after the vehicle reports that it stands


@dataclass(frozen=True, slots=True)
class Takeoff:
    """From the ground to where the landing begins."""

    height_m: Annotated[float, span(0.2, 10.0)] = 0.5
    start_offset_m: Vec3 | None = None  # relative to the landing spot, ENU; None: begin where it hovers
    level_first_m: Annotated[float, span(0.02, 2.0)] = 0.1  # sideways to the start only so near its height
    arrival_radius_m: Annotated[float, span(0.02, 0.5)] = 0.05
    arrival_speed_m_s: Annotated[float, span(0.01, 0.5)] = 0.05
    timeout_s: Annotated[float, span(5.0, 300.0)] = 60.0


@dataclass(frozen=True, slots=True)
class Touchdown:
    """The last centimetres."""

    rule: TouchdownRule = TouchdownRule.CONTACT
    height_m: Annotated[float, span(0.01, 1.0)] = 0.05  # paper V: motors off below 5 cm
    pad_radius_m: Annotated[float, span(0.03, 2.0)] = 0.10
    feet_below_reference_m: Annotated[float, span(0.0, 0.5)] = 0.0144  # Crazyflie 2.0, CAD
    target_speed_max_m_s: Annotated[float, span(0.0, 3.0)] = 0.21  # TurtleBot3 Burger wheel limit
    # errors of a late own state grow with the speed: for so long from the landing's begin it waits ...
    calm_wait_s: Annotated[float, span(0.0, 60.0)] = 0.0
    calm_speed_m_s: Annotated[float, span(0.01, 3.0)] = 0.21  # ... until the target is slower than this ...
    calm_height_m: Annotated[float, span(0.05, 3.0)] = 0.25  # ... so high above the pad
    descent_m_s: Annotated[float, span(0.02, 1.0)] = 0.2  # paper filter: relative to the pad, to contact
    # without an own state it sinks on with its last set-point: by then it stands
    blind_time_s: Annotated[float, span(0.0, 5.0)] = 0.4
    timeout_s: Annotated[float, span(0.5, 60.0)] = 2.0  # descent; a forced disarm shows with a heartbeat


@dataclass(frozen=True, slots=True)
class Contact:
    """What tells that the vehicle stands on the pad."""

    gap_m: Annotated[float, span(0.001, 0.5)] = 0.01  # of its feet: noise of two positions, tilt of the pad
    beyond_m: Annotated[float, span(0.0, 0.5)] = 0.0  # outside the pad's edge: errors of two positions
    # a vehicle that slides is off the pad before the others tell: it stands below this height, if ...
    sliding_gap_m: Annotated[float, span(0.0, 0.1)] = 0.0
    sliding_radius_m: Annotated[float, span(0.005, 1.0)] = 0.05  # ... it is soon so far from the middle
    speed_m_s: Annotated[float, span(0.005, 0.5)] = 0.05  # sinking slower than that, something holds it up
    time_s: Annotated[float, span(0.01, 2.0)] = 0.1  # of that
    stopped_time_s: Annotated[float, span(0.0, 1.0)] = 0.03  # told to sink and not sinking, low over the pad


@dataclass(frozen=True, slots=True)
class Retreat:
    """Up and away from the pad: going around, holding, climbing, flying clear."""

    drift_time_s: Annotated[float, span(0.05, 5.0)] = 0.3  # looks so far ahead: the horizontal loop's answer
    h_left_m: Annotated[float, span(0.01, 3.0)] = 0.08  # of h to climb away with; with less it goes on down
    hold_climb_m_s: Annotated[float, span(0.02, 5.0)] = 0.4  # of the robust hold, target out of sight
    climb_margin_m: Annotated[float, span(0.05, 5.0)] = 0.2  # above the barrier's peak: clear of the target
    clear_time_max_s: Annotated[float, span(5.0, 600.0)] = 30.0  # to fly clear; then it lands where it is
    # slowest that the vehicle's own landing sinks: how long a target that comes nearer has time to
    landing_speed_m_s: Annotated[float, span(0.05, 5.0)] = 0.3
    abort_time_max_s: Annotated[float, span(5.0, 1800.0)] = 60.0  # until the stack ends, not down by then
