"""Parameters of start and end of a flight: take-off, touchdown, contact, go-around, sizes.

The defaults are those of a Crazyflie on a pad of 20 cm; see docs/how_to/autopilots.md for other vehicles.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Annotated

from flightstack.common.strict_toml import span
from flightstack.core.types import Vec3


class TouchdownRule(Enum):
    """Condition that stops the motors."""

    PAPER = "paper"  # below touchdown.height_m inside the descending cone (paper V)
    CONTACT = "contact"  # after the vehicle reports ground contact


@dataclass(frozen=True, slots=True)
class Takeoff:
    """Flight from the ground to the place where the landing starts."""

    height_m: Annotated[float, span(0.2, 10.0)] = 0.5  # height of the take-off
    # start position relative to the landing spot, ENU; None: start from the hover position
    start_offset_m: Vec3 | None = None
    # largest height difference to the start at which the vehicle moves horizontally
    level_first_m: Annotated[float, span(0.02, 2.0)] = 0.1
    arrival_radius_m: Annotated[float, span(0.02, 0.5)] = 0.05  # largest distance from the start on arrival
    arrival_speed_m_s: Annotated[float, span(0.01, 0.5)] = 0.05  # largest speed on arrival
    timeout_s: Annotated[float, span(5.0, 300.0)] = 60.0  # longest take-off with the flight to the start


@dataclass(frozen=True, slots=True)
class Touchdown:
    """Final descent to the pad."""

    rule: TouchdownRule = TouchdownRule.CONTACT  # `contact`: until contact; `paper`: motors off at height_m
    height_m: Annotated[float, span(0.01, 1.0)] = 0.05  # paper filter: height of the touchdown (section V)
    pad_radius_m: Annotated[float, span(0.03, 2.0)] = 0.10  # radius of the pad
    feet_below_reference_m: Annotated[float, span(0.0, 0.5)] = 0.0144  # feet below the centre of mass (CAD)
    target_speed_max_m_s: Annotated[float, span(0.0, 3.0)] = 0.21  # fastest target; TurtleBot3 Burger's limit
    # maximum wait for a slow target after the landing starts: errors of a delayed vehicle state grow with
    # speed
    calm_wait_s: Annotated[float, span(0.0, 60.0)] = 0.0
    calm_speed_m_s: Annotated[float, span(0.01, 3.0)] = 0.21  # target speed at which the wait ends
    calm_height_m: Annotated[float, span(0.05, 3.0)] = 0.25  # height above the pad during the wait
    descent_m_s: Annotated[float, span(0.02, 1.0)] = 0.2  # paper filter: descent speed relative to the pad
    # duration of a descent with the last set-point after a loss of the vehicle state
    blind_time_s: Annotated[float, span(0.0, 5.0)] = 0.4
    timeout_s: Annotated[float, span(0.5, 60.0)] = 2.0  # time limit, including a forced disarm


@dataclass(frozen=True, slots=True)
class Contact:
    """Criteria for the contact of the vehicle with the pad."""

    # largest height of the feet at contact: noise of two positions, tilt of the pad
    gap_m: Annotated[float, span(0.001, 0.5)] = 0.01
    # tolerance beyond the pad's edge: errors of two positions
    beyond_m: Annotated[float, span(0.0, 0.5)] = 0.0
    # height below which a sliding vehicle has contact, before the other criteria detect it
    sliding_gap_m: Annotated[float, span(0.0, 0.1)] = 0.0
    # predicted distance from the centre that counts as sliding
    sliding_radius_m: Annotated[float, span(0.005, 1.0)] = 0.05
    # sink rate below which the pad supports the vehicle
    speed_m_s: Annotated[float, span(0.005, 0.5)] = 0.05
    time_s: Annotated[float, span(0.01, 2.0)] = 0.1  # duration of the low sink rate
    # time without motion that counts as contact, low over the pad, despite a descent command
    stopped_time_s: Annotated[float, span(0.0, 1.0)] = 0.03


@dataclass(frozen=True, slots=True)
class Retreat:
    """Motion away from the pad: go-around, hold, climb, flight clear of the target."""

    # horizon of the drift prediction: response time of the horizontal loop
    drift_time_s: Annotated[float, span(0.05, 5.0)] = 0.3
    # least h for a go-around; below it the descent continues
    h_left_m: Annotated[float, span(0.01, 3.0)] = 0.08
    hold_climb_m_s: Annotated[float, span(0.02, 5.0)] = 0.4  # climb rate of the robust filter's hold
    # height above the barrier's peak that counts as clear of the target
    climb_margin_m: Annotated[float, span(0.05, 5.0)] = 0.2
    # maximum time to fly clear; after it the vehicle lands at its position
    clear_time_max_s: Annotated[float, span(5.0, 600.0)] = 30.0
    # least sink rate of the autopilot's landing: it bounds the time in which a target can approach
    landing_speed_m_s: Annotated[float, span(0.05, 5.0)] = 0.3
    # maximum time of an abort; after it the stack exits
    abort_time_max_s: Annotated[float, span(5.0, 1800.0)] = 60.0
