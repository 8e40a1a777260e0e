"""Typed configuration of the onboard process, checked before a flight.

Each class is a table of the file; each field is a key with its unit. ``flightstack.config`` reads the file.
The defaults are those of a Crazyflie on a pad of 20 cm; see docs/how_to/autopilots.md for other vehicles.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Annotated

from flightstack.common.strict_toml import ConfigError, Each, span
from flightstack.core.parameters.filters import FILTERS, check_name, named
from flightstack.core.parameters.fleet import ALONE, Fleet
from flightstack.core.parameters.reserve import Reserve
from flightstack.core.parameters.robust import (
    Envelope,
    OwnStateLink,
    Robust,
    TargetLink,
    VelocityFeedback,
    VelocityLoop,
)
from flightstack.core.safety.barrier import Barrier
from flightstack.core.types import Vec3


class TouchdownRule(Enum):
    """Condition under which the motors stop."""

    PAPER = "paper"  # the vehicle is below touchdown.height_m inside the descending cone (paper V)
    CONTACT = "contact"  # contact with the pad was detected (table [contact])


@dataclass(frozen=True, slots=True)
class Takeoff:
    """Flight from the ground to the place where the landing starts."""

    height_m: Annotated[float, span(0.2, 10.0)] = 0.5  # height of the take-off above the ground
    # start position relative to the landing spot, ENU; None: start from the hover position
    start_offset_m: Vec3 | None = None
    # maximum height difference to the start at which the vehicle moves horizontally
    level_first_m: Annotated[float, span(0.02, 2.0)] = 0.1
    arrival_radius_m: Annotated[float, span(0.02, 0.5)] = 0.05  # maximum distance from the start on arrival
    arrival_speed_m_s: Annotated[float, span(0.01, 0.5)] = 0.05  # maximum speed on arrival
    timeout_s: Annotated[float, span(5.0, 300.0)] = 60.0  # time limit of take-off and flight to the start


PAD_RADIUS_M = span(0.05, 2.0)  # range of a pad's radius, also in a scenario


@dataclass(frozen=True, slots=True)
class Touchdown:
    """Final descent to the pad."""

    rule: TouchdownRule = TouchdownRule.CONTACT  # motors off on contact (`contact`) or at height_m (`paper`)
    height_m: Annotated[float, span(0.01, 1.0)] = 0.05  # paper filter: height of the touchdown (section V)
    pad_radius_m: Annotated[float, PAD_RADIUS_M] = 0.10  # radius of the pad
    feet_below_reference_m: Annotated[float, span(0.0, 0.5)] = 0.0144  # height of centre of mass above feet
    target_speed_max_m_s: Annotated[float, span(0.0, 3.0)] = 0.21  # maximum target speed (TurtleBot3 Burger)
    # maximum wait for a slow target after the landing starts; at low speed a delayed vehicle state has
    # smaller errors
    calm_wait_s: Annotated[float, span(0.0, 60.0)] = 0.0
    calm_speed_m_s: Annotated[float, span(0.01, 3.0)] = 0.21  # target speed below which the wait ends
    calm_height_m: Annotated[float, span(0.05, 3.0)] = 0.25  # height above the pad during the wait
    descent_m_s: Annotated[float, span(0.02, 1.0)] = 0.2  # paper filter: descent speed relative to the pad
    # time after a loss of the vehicle state in which the descent continues with the last set-point
    blind_time_s: Annotated[float, span(0.0, 5.0)] = 0.4
    timeout_s: Annotated[float, span(0.5, 60.0)] = 2.0  # time limit of the touchdown, forced disarm included


@dataclass(frozen=True, slots=True)
class Contact:
    """Criteria for the contact of the vehicle with the pad."""

    # maximum height of the feet at contact; this height covers two positions' noise and the pad's tilt
    gap_m: Annotated[float, span(0.001, 0.5)] = 0.01
    # tolerance beyond the pad's edge, for the errors of two positions
    beyond_m: Annotated[float, span(0.0, 0.5)] = 0.0
    # height below which a vehicle that slides off counts as in contact, before the other criteria apply
    sliding_gap_m: Annotated[float, span(0.0, 0.1)] = 0.0
    # predicted distance from the pad's centre from which the vehicle counts as sliding off
    sliding_radius_m: Annotated[float, span(0.005, 1.0)] = 0.05
    # sink rate below which the pad supports the vehicle
    speed_m_s: Annotated[float, span(0.005, 0.5)] = 0.05
    time_s: Annotated[float, span(0.01, 2.0)] = 0.1  # time with a sink rate below speed_m_s until contact
    # time after which a vehicle low over the pad that does not follow a descent command counts as in contact
    stopped_time_s: Annotated[float, span(0.0, 1.0)] = 0.03


@dataclass(frozen=True, slots=True)
class Retreat:
    """Motion away from the pad: go-around, hold, climb, flight clear of the target."""

    # horizon of the drift prediction: about the lag of the horizontal loop
    drift_time_s: Annotated[float, span(0.05, 5.0)] = 0.3
    # minimum h for a go-around; at a lower h the descent continues
    h_left_m: Annotated[float, span(0.01, 3.0)] = 0.08
    hold_climb_m_s: Annotated[float, span(0.02, 5.0)] = 0.4  # climb rate of the robust filter's hold
    # height above the boundary's peak from which the vehicle is above every part of the target
    climb_margin_m: Annotated[float, span(0.05, 5.0)] = 0.2
    # maximum time to fly clear of the target; after it the vehicle lands where it is
    clear_time_max_s: Annotated[float, span(5.0, 600.0)] = 30.0
    # minimum sink rate of the autopilot's landing; this rate limits the time in which a target can approach
    landing_speed_m_s: Annotated[float, span(0.05, 5.0)] = 0.3
    # maximum time of an abort; after it the stack exits
    abort_time_max_s: Annotated[float, span(5.0, 1800.0)] = 60.0


_NAME_MAX = 16  # maximum length of a MAVLink parameter name, characters


@dataclass(frozen=True, slots=True)
class Loop:
    """Rate of the onboard process."""

    rate_hz: Annotated[int, span(10, 500)] = 100  # rate of the ticks


@dataclass(frozen=True, slots=True)
class PositionLoop:
    """Gain K_p of the position loop, per axis."""

    gain_1_s: Each[Annotated[float, span(0.05, 10.0)]] = (1.0, 1.0, 1.0)  # gain K_p of the position loop


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a command: velocity (paper: v_m), rate of change, and height above which no climb is sent."""

    velocity_max_m_s: Each[Annotated[float, span(0.05, 5.0)]] = (0.2, 0.2, 0.5)  # maximum commanded velocity
    # paper filter: maximum allowed rate of change of the command
    slew_max_m_s2: Each[Annotated[float, span(0.2, 50.0)]] = (4.0, 4.0, 4.0)
    altitude_max_m: Annotated[float, span(0.5, 100.0)] = 3.0  # height (z) above which no climb is allowed


@dataclass(frozen=True, slots=True)
class Checks:
    """Limits of the received data, and waiting times after a loss."""

    own_age_max_s: Annotated[float, span(0.02, 0.4)] = 0.2  # maximum accepted age of a vehicle state
    target_age_max_s: Annotated[float, span(0.02, 1.0)] = 0.25  # maximum accepted age of a target state
    # maximum allowed difference between position and integrated velocity of the vehicle
    own_drift_max_m: Annotated[float, span(0.05, 2.0)] = 0.15
    own_drift_memory_s: Annotated[float, span(0.2, 20.0)] = 2.0  # decay time of the position difference
    # maximum allowed lag behind the set-points, as a time at the maximum velocity
    follow_lag_max_s: Annotated[float, span(0.1, 5.0)] = 0.45
    follow_memory_s: Annotated[float, span(0.1, 20.0)] = 1.0  # decay time of the tracking lag
    status_age_max_s: Annotated[float, span(1.0, 10.0)] = 3.0  # maximum accepted age of a heartbeat (1 Hz)
    target_speed_max_m_s: Annotated[float, span(0.1, 10.0)] = 1.5  # maximum accepted speed of a target sample
    target_jump_max_m: Annotated[float, span(0.02, 5.0)] = 0.2  # maximum accepted jump of the target
    # maximum allowed difference between position and integrated velocity of the target
    target_drift_max_m: Annotated[float, span(0.02, 2.0)] = 0.1
    target_drift_memory_s: Annotated[float, span(0.2, 20.0)] = 2.0  # decay time of the position difference
    # maximum height of a vehicle on the ground above the landing spot; more for a take-off from a table
    target_below_max_m: Annotated[float, span(0.02, 100.0)] = 0.15
    target_frame: str = "map"  # frame_id of the target's odometry
    target_child_frame: str = "target"  # child_frame_id of the target's odometry
    hold_time_s: Annotated[float, span(0.1, 10.0)] = 1.0  # time in HOLD before the climb
    climb_time_max_s: Annotated[float, span(0.5, 60.0)] = 10.0  # maximum time in CLIMB before an abort
    recovery_time_s: Annotated[float, span(0.05, 5.0)] = 0.3  # time with good inputs before a start or retry
    retries_max: Annotated[int, span(0, 20)] = 3  # maximum number of go-arounds before an abort
    swings_max: Annotated[int, span(1, 100)] = 3  # maximum number of exits from the cone over the pad
    over_pad_time_max_s: Annotated[float, span(2.0, 600.0)] = 15.0  # maximum time over the pad in the air
    landing_time_max_s: Annotated[float, span(5.0, 600.0)] = 120.0  # maximum duration of a landing
    wait_time_max_s: Annotated[float, span(1.0, 3600.0)] = 60.0  # maximum wait for inputs before the landing
    clearance_m: Annotated[float, span(0.3, 20.0)] = 1.0  # minimum safe horizontal distance to the target


@dataclass(frozen=True, slots=True)
class VehicleSide:
    """Autopilot settings that the user has accepted, and the origin of the autopilot's coordinates."""

    # parameters whose values never block arming in the pre-flight check
    accepted_parameters: tuple[str, ...] = ()
    # origin for an autopilot without satellite positioning: latitude and longitude (WGS84) in degrees, height
    # above mean sea level in m; a height of 0 is refused
    origin_wgs84: Vec3 | None = None

    def __post_init__(self) -> None:
        for name in self.accepted_parameters:
            if not (0 < len(name) <= _NAME_MAX and name.isascii() and name.upper() == name):
                raise ConfigError(
                    f"accepted_parameters: found {name!r}; names of parameters are needed, in capitals, at "
                    f"most {_NAME_MAX} characters, for example COM_OF_LOSS_T"
                )
        if self.origin_wgs84 is not None:
            check_origin("origin_wgs84", self.origin_wgs84)


@dataclass(frozen=True, slots=True)
class FlightConfig:
    """Complete configuration of the onboard process."""

    barrier: Barrier
    filter: str = "robust"  # name of the safety filter: `paper`, `robust`, or MODULE:NAME of a class
    loop: Loop = field(default_factory=Loop)
    position_loop: PositionLoop = field(default_factory=PositionLoop)
    limits: Limits = field(default_factory=Limits)
    touchdown: Touchdown = field(default_factory=Touchdown)
    takeoff: Takeoff = field(default_factory=Takeoff)
    contact: Contact = field(default_factory=Contact)
    retreat: Retreat = field(default_factory=Retreat)
    checks: Checks = field(default_factory=Checks)
    # assumptions of the robust filter; the paper filter ignores them
    robust: Robust = field(default_factory=Robust)
    velocity_loop: VelocityLoop = field(default_factory=VelocityLoop)
    velocity_feedback: VelocityFeedback = field(default_factory=VelocityFeedback)
    own: OwnStateLink = field(default_factory=OwnStateLink)
    target: TargetLink = field(default_factory=TargetLink)
    envelope: Envelope = field(default_factory=Envelope)  # range that the certificate of `check` covers
    vehicle: VehicleSide = field(default_factory=VehicleSide)
    reserve: Reserve | None = None  # None: the battery sets no limits, and its state is not requested
    fleet: Fleet = ALONE  # without this table the vehicle is alone

    @property
    def slew_max_m_s2(self) -> Vec3:
        """Acceleration limit of the robust filter's velocity on each axis, m/s^2.

        In a fleet ``fleet.slew_xy_max_m_s2`` limits the vector of both horizontal axes (each axis: divided by
        sqrt(2)), because a vehicle that lags behind its commands comes too near to its neighbours.
        """
        (x, y, z), side = self.robust.acceleration_max_m_s2, self.fleet.slew_side_max_m_s2
        return min(x, side), min(y, side), z

    @property
    def descending(self) -> FlightConfig:
        """This configuration with the gain of the final descent as its gain over the pad."""
        return replace(self, robust=replace(self.robust, gain_over_pad_1_s=self.robust.to_contact_1_s))

    @property
    def far(self) -> FlightConfig:
        """This configuration with the feedback and gain for far from the pad; unchanged if ``far_m`` is 0."""
        if not self.velocity_feedback.far_m:
            return self
        robust = replace(self.robust, gain_over_pad_1_s=self.robust.gain_1_s)
        return replace(self, robust=robust, velocity_feedback=self.velocity_feedback.far)

    def __post_init__(self) -> None:
        peak = self.barrier.peak_height_m
        least_m = peak + self.retreat.climb_margin_m
        if self.limits.altitude_max_m < least_m:
            raise ConfigError(
                f"limits.altitude_max_m: found {self.limits.altitude_max_m:g}, the barrier's peak is "
                f"{peak:.3g} m above the pad; allow at least {least_m:.3g}"
            )
        self.fleet.check(self.velocity_loop.lag_xy_s, 1.0 / self.loop.rate_hz, self.checks.clearance_m)
        check_name(self.filter)
        # an external filter checks its configuration when it flies: reading a log must not run its code
        if self.filter in FILTERS:
            named(self.filter).check_config(self)


def check_origin(name: str, origin_wgs84: Vec3) -> None:
    """Reject an origin of local coordinates that an autopilot would reject or misinterpret.

    ArduPilot treats a height of 0 as "not known" (``AP_Baro::update_field_elevation``, 4.6) and stores
    heights in centimetres. With a height of 0 ArduPilot resets the height datum on the ground at 1 Hz.
    """
    latitude_deg, longitude_deg, height_m = origin_wgs84
    if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0 and -500.0 <= height_m <= 9000.0):
        raise ConfigError(
            f"{name}: found {list(origin_wgs84)}; allowed are a latitude of -90 to 90 and "
            "a longitude of -180 to 180 degrees, and -500 to 9000 m"
        )
    if abs(round(height_m * 1000.0)) < 10:  # the message has mm; ArduPilot rounds less than 10 mm to 0 cm
        raise ConfigError(
            f"{name}: found a height of {height_m:g} m; ArduPilot takes 0 for an unknown height and resets "
            "its height datum every second on the ground; give the height above sea level, or 10 where it is "
            "not known: the height above the ground does not depend on it"
        )
