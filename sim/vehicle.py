"""The simulated Crazyflie: body, rotors, firmware, estimator and the deck it lands on, in 1 ms steps.

Deterministic in (scenario, seed). Knows nothing of MAVLink or of the wall clock.
"""

from __future__ import annotations

from dataclasses import dataclass

from flightstack.types import Vec3
from sim.scenario import Scenario

STEP_S = 0.001

CONTACT_PAD = 1
CONTACT_GROUND = 2
CONTACT_ROBOT = 4
CONTACT_PAD_EDGE = 8
CONTACT_TUMBLED = 16


@dataclass(frozen=True, slots=True)
class Estimate:
    """What the on-board estimator believes."""

    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    quaternion: tuple[float, float, float, float]  # w, x, y, z; FLU body in ENU world
    angular_velocity_flu_rad_s: Vec3
    valid: bool


@dataclass(frozen=True, slots=True)
class Truth:
    """The true state and what happened since the last call of ``truth`` (fields of TrueState.msg)."""

    time_s: float
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    quaternion: tuple[float, float, float, float]  # w, x, y, z; FLU body in ENU world
    angular_velocity_flu_rad_s: Vec3
    rotor_rpm: tuple[float, float, float, float]
    pad_position_enu_m: Vec3
    pad_velocity_enu_m_s: Vec3
    pad_yaw_rad: float
    h_m: float
    h_min_m: float
    h_min_outside_pad_m: float  # +inf if no step was outside the pad's radius
    contacts: int  # bits CONTACT_*
    first_touch_relative_position_enu_m: Vec3
    first_touch_relative_velocity_enu_m_s: Vec3
    first_touch_time_s: float  # NaN until there was one
    motors_running: bool
    battery_v: float
    wind_enu_m_s: Vec3


class VehicleSim:
    """One vehicle with its deck."""

    time_s: float
    battery_v: float
    armed: bool
    locked: bool
    state_text: str  # supervisor state and why
    on_pad: bool
    on_ground: bool
    landed: bool
    motors_running: bool

    def __init__(self, scenario: Scenario, seed: int) -> None: ...
    def set_deck(self, position_enu_m: Vec3, yaw_rad: float, velocity_enu_m_s: Vec3, yaw_rate_rad_s: float) -> None: ...
    def advance(self, steps: int) -> None: ...
    def arm(self) -> str | None: ...
    def disarm(self, force: bool) -> str | None: ...
    def set_velocity(self, velocity_enu_m_s: Vec3, yaw_rad: float) -> None: ...
    def stop_setpoint(self) -> None: ...
    def begin_judging(self) -> None: ...
    def estimate(self) -> Estimate: ...
    def truth(self) -> Truth: ...
