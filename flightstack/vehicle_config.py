"""What the onboard process is told about its vehicle's autopilot."""

from __future__ import annotations

from dataclasses import dataclass

from flightstack.strict_toml import ConfigError
from flightstack.types import Vec3

_NAME_MAX = 16  # characters of a MAVLink parameter's name


@dataclass(frozen=True, slots=True)
class VehicleSide:
    """Settings of the autopilot that a person has looked at, and where its coordinates begin."""

    # parameters of the pre-flight check that do not keep it from arming, whatever they are set to
    accepted_parameters: tuple[str, ...] = ()
    # latitude and longitude in degrees, m above sea level (WGS84): for an autopilot without satellites
    origin_wgs84: Vec3 | None = None

    def __post_init__(self) -> None:
        for name in self.accepted_parameters:
            if not (0 < len(name) <= _NAME_MAX and name.isascii() and name.upper() == name):
                raise ConfigError(
                    f"accepted_parameters: found {name!r}; names of parameters are needed, in capitals, at "
                    f"most {_NAME_MAX} characters, for example COM_OF_LOSS_T"
                )
        if self.origin_wgs84 is not None:
            latitude, longitude, height_m = self.origin_wgs84
            if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0 and -500.0 <= height_m <= 9000.0):
                raise ConfigError(
                    f"origin_wgs84: found {list(self.origin_wgs84)}; allowed are a latitude of -90 to 90 and "
                    "a longitude of -180 to 180 degrees, and -500 to 9000 m"
                )
