"""What the onboard process is told about its vehicle's autopilot."""

from __future__ import annotations

from dataclasses import dataclass

from flightstack.common.strict_toml import ConfigError
from flightstack.core.types import Vec3

_NAME_MAX = 16  # characters of a MAVLink parameter's name


@dataclass(frozen=True, slots=True)
class VehicleSide:
    """Settings of the autopilot that a person has looked at, and where its coordinates begin."""

    # parameters of the pre-flight check that do not keep it from arming, whatever they are set to
    accepted_parameters: tuple[str, ...] = ()
    # latitude and longitude in degrees, m above sea level (WGS84) and not 0: for an autopilot without
    # satellites
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


def check_origin(name: str, origin_wgs84: Vec3) -> None:
    """Refuse an origin of local coordinates that an autopilot would not take, or would take wrongly.

    A height of 0 counts as "not known" in ArduPilot (``AP_Baro::update_field_elevation``, 4.6), which has it
    in centimetres: on the ground it resets its height datum once a second.

    Args:
        name: how the user calls it.
        origin_wgs84: latitude and longitude in degrees, m above sea level.

    Raises:
        ConfigError: out of range, or a height of 0.
    """
    latitude_deg, longitude_deg, height_m = origin_wgs84
    if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0 and -500.0 <= height_m <= 9000.0):
        raise ConfigError(
            f"{name}: found {list(origin_wgs84)}; allowed are a latitude of -90 to 90 and "
            "a longitude of -180 to 180 degrees, and -500 to 9000 m"
        )
    if abs(round(height_m * 1000.0)) < 10:  # mm on the wire; less is 0 in its centimetres
        raise ConfigError(
            f"{name}: found a height of {height_m:g} m; ArduPilot takes 0 for an unknown height and resets "
            "its height datum every second on the ground; give the height above sea level, or 10 where it is "
            "not known: the height above the ground does not depend on it"
        )
