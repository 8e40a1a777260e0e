"""Types of an autopilot profile."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum

from flightstack.core.types import Mode, Request, VehicleStatus

# Set-point mask: ignore position (7) and acceleration (0x1C0), use velocity and yaw, ignore yaw rate (0x800).
# PX4 and ArduPilot interpret only this mask alike; without a yaw PX4 drifts and ArduPilot turns.
VELOCITY_AND_YAW = 2503


class TakeoffAltitude(Enum):
    """Meaning of param7 of MAV_CMD_NAV_TAKEOFF."""

    AMSL = "above sea level"
    ABOVE_HOME = "above home, from its height there"


class Reading(Enum):
    """Consequence of a MAV_RESULT for the next try; no result proves that a command was carried out."""

    NOTED = "telemetry decides"
    WORKING = "wait longer"
    AGAIN = "try again"
    FINAL = "give up when said twice"


class Encoding(Enum):
    """Encoding of an integer parameter in the float field of PARAM_VALUE."""

    BYTEWISE = "bytes of the integer"  # MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    C_CAST = "converted to a float"


Params = tuple[float | None, ...]  # seven; None is "unset", sent as the profile's unset value


@dataclass(frozen=True, slots=True)
class Step:
    """A command of a sequence, and the status after which it is no longer needed."""

    command: int  # MAV_CMD
    name: str
    params: Callable[[float], Params]  # function of the take-off altitude in the profile's convention, m
    done: Callable[[VehicleStatus], bool]
    prestream: bool = False  # set-points must be streaming first
    blind: bool = False  # also sent to a vehicle without status, and after any reply
    period_s: float = 0.5  # s between two tries
    tries: int = 10


@dataclass(frozen=True, slots=True)
class Profile:
    """Everything that is specific to one autopilot."""

    name: str
    title: str
    autopilot: int  # MAV_AUTOPILOT in its heartbeat
    modes: Mapping[int, Mode]  # by custom_mode of the heartbeat; others are OTHER
    sequences: Mapping[Request, tuple[Step, ...]]
    answers: Mapping[int, Reading]  # by MAV_RESULT; others are AGAIN
    takeoff_altitude: TakeoffAltitude
    # Set-points may be sent during a take-off of the vehicle; else a set-point ends it, and the external mode
    # follows set-points only from the first one on.
    stream_in_takeoff: bool
    prestream_s: float  # s of unbroken set-points before the mode is switched
    unset: float  # value of a command parameter that is not given
    encoding: Encoding
    needs_origin: bool  # without satellites there is no position before SET_GPS_GLOBAL_ORIGIN
    stream_lost: str  # text: reaction to missing set-points
    time_sync: str  # text: use of TIMESYNC
    prepare: tuple[Step, ...] = ()  # on the ground before the first request
    asked_hz: Mapping[int, float] = field(default_factory=dict)  # besides position, attitude, landed state
    # message id to MAV_DATA_STREAM, for versions without SET_MESSAGE_INTERVAL
    data_streams: Mapping[int, int] = field(default_factory=dict)
    setpoint_mask: int = VELOCITY_AND_YAW
    frame: int = 1  # MAV_FRAME_LOCAL_NED

    def mode(self, custom_mode: int) -> Mode:
        """Mode of a heartbeat's custom_mode."""
        return self.modes.get(custom_mode, Mode.OTHER)
