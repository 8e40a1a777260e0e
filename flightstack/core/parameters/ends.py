"""Start and end of a flight: take-off, touchdown, contact, go-around; sizes of vehicle and pad.

Defaults are those of a Crazyflie on a pad of 20 cm; see docs/how_to/autopilots.md for other vehicles.
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
    CONTACT = "contact"  # after the vehicle reports the ground contact


@dataclass(frozen=True, slots=True)
class Takeoff:
    """From the ground to where the landing begins."""

    height_m: Annotated[float, span(0.2, 10.0)] = 0.5
    # relative to the landing spot, ENU; None: start from the hover position
    start_offset_m: Vec3 | None = None
    # largest height difference to the start for horizontal motion
    level_first_m: Annotated[float, span(0.02, 2.0)] = 0.1
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
    # maximum wait after the landing starts for a slow target: errors of a delayed vehicle state grow with
    # speed
    calm_wait_s: Annotated[float, span(0.0, 60.0)] = 0.0
    calm_speed_m_s: Annotated[float, span(0.01, 3.0)] = 0.21  # target speed at which the wait ends
    calm_height_m: Annotated[float, span(0.05, 3.0)] = 0.25  # height above the pad during the wait
    descent_m_s: Annotated[float, span(0.02, 1.0)] = 0.2  # paper filter: relative to the pad, to contact
    # blind descent with the last set-point after a loss of the vehicle state; contact is expected by then
    blind_time_s: Annotated[float, span(0.0, 5.0)] = 0.4
    timeout_s: Annotated[float, span(0.5, 60.0)] = 2.0  # descent; a forced disarm shows with a heartbeat


@dataclass(frozen=True, slots=True)
class Contact:
    """Signs that the vehicle stands on the pad."""

    # height of the feet at contact: noise of two positions, tilt of the pad
    gap_m: Annotated[float, span(0.001, 0.5)] = 0.01
    # distance outside the pad's edge: errors of two positions
    beyond_m: Annotated[float, span(0.0, 0.5)] = 0.0
    # height below which a sliding vehicle has contact, before the other criteria detect it
    sliding_gap_m: Annotated[float, span(0.0, 0.1)] = 0.0
    # predicted distance from the middle that counts as sliding
    sliding_radius_m: Annotated[float, span(0.005, 1.0)] = 0.05
    # sink rate below which something supports the vehicle
    speed_m_s: Annotated[float, span(0.005, 0.5)] = 0.05
    time_s: Annotated[float, span(0.01, 2.0)] = 0.1  # duration of the low sink rate
    # time without motion at a descent command, low over the pad
    stopped_time_s: Annotated[float, span(0.0, 1.0)] = 0.03


@dataclass(frozen=True, slots=True)
class Retreat:
    """Up and away from the pad: going around, holding, climbing, flying clear."""

    # horizon of the drift prediction: response of the horizontal loop
    drift_time_s: Annotated[float, span(0.05, 5.0)] = 0.3
    # least h for a go-around; with less the descent continues
    h_left_m: Annotated[float, span(0.01, 3.0)] = 0.08
    hold_climb_m_s: Annotated[float, span(0.02, 5.0)] = 0.4  # climb rate of the robust hold without a target
    # height above the barrier's peak that is clear of the target
    climb_margin_m: Annotated[float, span(0.05, 5.0)] = 0.2
    # maximum time to fly clear; then it lands at its position
    clear_time_max_s: Annotated[float, span(5.0, 600.0)] = 30.0
    # least sink rate of the vehicle's own landing: bounds the time in which a target can approach
    landing_speed_m_s: Annotated[float, span(0.05, 5.0)] = 0.3
    # maximum time of an abort until the stack ends
    abort_time_max_s: Annotated[float, span(5.0, 1800.0)] = 60.0
