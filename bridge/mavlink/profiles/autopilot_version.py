"""What AUTOPILOT_VERSION says: the release, and whether it is one of this project's own vehicles.

Those fly by PX4's commands and show its MAV_AUTOPILOT, but have other parameters; a recorded one has none.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.decoding import Message
from bridge.mavlink.profiles.autopilots import CRAZYFLIE, OWN_SITL
from bridge.mavlink.profiles.profile import Profile

# flight_custom_version, where others have eight digits of their revision
SITL_MARK = b"cfstack\x00"
CRAZYFLIE_MARK = b"cfbridge"
RECORDED_MARK = b"recorded"
_MARKED: Mapping[bytes, Profile] = MappingProxyType({SITL_MARK: OWN_SITL, CRAZYFLIE_MARK: CRAZYFLIE})


def marked(message: Message) -> Profile | None:
    """Profile of one of this project's own vehicles by its AUTOPILOT_VERSION, None if it is another's."""
    return _MARKED.get(bytes(message.flight_custom_version))


def is_recorded(message: Message) -> bool:
    """Whether it is a log that is played: it obeys nothing, so nothing can be unsafe."""
    return bytes(message.flight_custom_version) == RECORDED_MARK


def recorded_version() -> Message:
    """AUTOPILOT_VERSION of a log that is played."""
    zeros = [0] * 8
    return dialect.MAVLink_autopilot_version_message(
        0, 0, 0, 0, 0, list(RECORDED_MARK), zeros, zeros, 0, 0, 0
    )


def release(message: Message) -> str:
    """Release as ``1.16.0`` of an AUTOPILOT_VERSION, with what it is short of a release."""
    version = message.flight_sw_version
    kind = dialect.enums["FIRMWARE_VERSION_TYPE"].get(version & 0xFF)
    number = f"{version >> 24 & 0xFF}.{version >> 16 & 0xFF}.{version >> 8 & 0xFF}"
    if kind is None or kind.name.endswith("OFFICIAL"):
        return number
    return f"{number} {kind.name.removeprefix('FIRMWARE_VERSION_TYPE_').lower()}"
