"""The words of an autopilot profile: what can differ between autopilots, nothing about any one of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum

from flightstack.core.types import Mode, Request, VehicleStatus

# Set-point mask: ignore position (7) and acceleration (0x1C0), use velocity and yaw, ignore yaw rate (0x800).
# The one mask that PX4 and ArduPilot read alike; without a yaw PX4 drifts and ArduPilot turns its nose.
VELOCITY_AND_YAW = 2503


class TakeoffAltitude(Enum):
    """What param7 of MAV_CMD_NAV_TAKEOFF means."""

    AMSL = "above sea level"
    ABOVE_HOME = "above home, from its height there"


class Reading(Enum):
    """What a MAV_RESULT means for the next try; none of them proves that anything was done."""

    NOTED = "telemetry decides"
    WORKING = "wait longer"
    AGAIN = "try again"
    FINAL = "give up when said twice"


class Encoding(Enum):
    """How an integer parameter travels in the float field of PARAM_VALUE."""

    BYTEWISE = "bytes of the integer"  # MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    C_CAST = "converted to a float"


Params = tuple[float | None, ...]  # seven; None is "unset", sent as the profile's unset value


@dataclass(frozen=True, slots=True)
class Step:
    """One command on the way to what is wanted, and how the vehicle shows that it is no longer needed."""

    command: int  # MAV_CMD
    name: str
    params: Callable[[float], Params]  # of the take-off altitude in the profile's convention, m
    done: Callable[[VehicleStatus], bool]
    prestream: bool = False  # set-points must be streaming first
    blind: bool = False  # also sent to a vehicle that shows no status, and whatever it answers
    period_s: float = 0.5  # s between two tries
    tries: int = 10


@dataclass(frozen=True, slots=True)
class Profile:
    """One autopilot: everything the stack has to know about it."""

    name: str
    title: str
    autopilot: int  # MAV_AUTOPILOT in its heartbeat
    modes: Mapping[int, Mode]  # custom_mode of the heartbeat; what is not listed is OTHER
    sequences: Mapping[Request, tuple[Step, ...]]
    answers: Mapping[int, Reading]  # by MAV_RESULT; what is not listed is AGAIN
    takeoff_altitude: TakeoffAltitude
    # Set-points may be sent while it takes off by itself; where not, one ends the take-off, and the external
    # mode follows us only from the first one on.
    stream_in_takeoff: bool
    prestream_s: float  # s of unbroken set-points before the mode is switched
    unset: float  # value of a command parameter that is not given
    encoding: Encoding
    needs_origin: bool  # without satellites there is no position before SET_GPS_GLOBAL_ORIGIN
    stream_lost: str  # what it does when set-points stop, for people
    time_sync: str  # what becomes of TIMESYNC, for people
    prepare: tuple[Step, ...] = ()  # on the ground, before anything else is wanted
    asked_hz: Mapping[int, float] = field(default_factory=dict)  # besides position, attitude, landed state
    # message id to MAV_DATA_STREAM, for versions that do not know SET_MESSAGE_INTERVAL
    data_streams: Mapping[int, int] = field(default_factory=dict)
    setpoint_mask: int = VELOCITY_AND_YAW
    frame: int = 1  # MAV_FRAME_LOCAL_NED

    def mode(self, custom_mode: int) -> Mode:
        """Reduce the heartbeat's custom_mode to what the stack needs."""
        return self.modes.get(custom_mode, Mode.OTHER)
