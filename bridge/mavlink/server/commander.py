"""Modes of a PX4-like vehicle, what clients' commands do with them, and which client has control.

One sender of set-points has control of the vehicle, and few commands of other senders are obeyed: PX4 obeys
the newest message, and a second companion or a forgotten script could take over in flight.

A subclass arms and disarms, flies the modes, and has fail-safes of its own. Methods that can refuse return
the reason, None when done.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from enum import Enum
from typing import ClassVar, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.server.profile import AIRBORNE_STATE, FlightMode
from bridge.mavlink.server.setpoints import Setpoint
from bridge.mavlink.server.texts import Texts
from bridge.mavlink.transport.address import Peer
from flightstack.core.types import ZERO, Vec3

# system id, component id, and the address where there is one: ids alone are not unique
Sender = tuple[int, int] | tuple[int, int, Peer]

# System ids of ground stations: QGroundControl, MAVProxy and dronekit use 255, MAVSDK uses 245.
GROUND_STATIONS = frozenset({255, 245})


class Right(Enum):
    """Which senders may do something while one of them has control."""

    ANYBODY = "anybody"  # changes nothing, or makes the vehicle safer: questions, telemetry, landing
    OWNER = "owner"  # changes what the vehicle does
    OWNER_OR_GROUND = "owner or ground station"  # motors off in an emergency


class Battery(NamedTuple):
    """Battery of one cell."""

    voltage_v: float
    percent: int  # -1: not known


class Commander(ABC):
    """One vehicle as the server sees it."""

    height_range_m: ClassVar[tuple[float, float]]  # of a take-off, above home

    def __init__(self) -> None:
        self.mode = FlightMode.HOLD  # meaningful also while disarmed
        self.failsafe = False  # the mode was not requested but forced by a failure
        self.texts = Texts()
        self.home_enu_m: Vec3 = ZERO
        self.takeoff_z_m = 0.0  # height of the next or present take-off, local
        self._owner: Sender | None = (
            None  # sender that has control; it loses control when its set-points stop
        )
        self._setpoint_s = -math.inf  # time of the owner's newest set-point

    @property
    @abstractmethod
    def armed(self) -> bool:
        """Whether the motors may run."""

    @property
    def arming(self) -> bool:
        """Whether arming was requested and its result is not known yet."""
        return False

    @property
    @abstractmethod
    def standing(self) -> bool:
        """Whether it is on the ground or on the pad, not just touching."""

    @property
    @abstractmethod
    def battery(self) -> Battery: ...

    @property
    @abstractmethod
    def stream_lost_s(self) -> float:
        """Silence after which OFFBOARD has no stream and control is free."""

    @abstractmethod
    def sensors_healthy(self, now_s: float, /) -> int:
        """MAV_SYS_STATUS_SENSOR bits in good order, besides those of the profile."""

    @abstractmethod
    def problems(self, now_s: float, /) -> list[str]:
        """Reasons why the vehicle would not arm now; empty when ready."""

    @abstractmethod
    def yaw_rad(self) -> float | None:
        """Heading, counter-clockwise from east; None: not known."""

    @abstractmethod
    def arm(self, now_s: float, /) -> str | None: ...

    @abstractmethod
    def disarm(self, now_s: float, /, *, force: bool) -> str | None:
        """Disarm; in the air only by force."""

    @abstractmethod
    def _why_no_mode(self, mode: FlightMode, now_s: float) -> str | None:
        """Why it cannot change to any mode but LAND."""

    @abstractmethod
    def _height_m(self) -> float:
        """Local height by the estimate; -inf: not known."""

    @abstractmethod
    def _default_takeoff_z_m(self) -> float:
        """Local height of a take-off that names none."""

    @abstractmethod
    def _begin(self, now_s: float) -> None:
        """Begin to fly ``mode`` from the present state."""

    @abstractmethod
    def _take(self, setpoint: Setpoint, now_s: float) -> None:
        """Take the owner's set-point; it is flown in OFFBOARD only."""

    # What clients command

    @property
    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""
        return int(dialect.MAV_LANDED_STATE_ON_GROUND) if self.standing else AIRBORNE_STATE[self.mode]

    def forbids(self, sender: Sender, right: Right, now_s: float) -> str | None:
        """Why this sender may not do something now; while disarmed every sender may."""
        ground = right is Right.OWNER_OR_GROUND and sender[0] in GROUND_STATIONS
        if not self.armed or right is Right.ANYBODY or ground:
            return None
        return self._other_has_control(sender, now_s)

    def _other_has_control(self, sender: Sender, now_s: float) -> str | None:
        """Text on the other sender that has control; None: this sender has it, or it is free."""
        owner = self._owner
        if owner is None or sender == owner or now_s - self._setpoint_s > self.stream_lost_s:
            return None
        at = f" at {owner[2][0]}:{owner[2][1]}" if len(owner) == 3 and owner[:2] == sender[:2] else ""
        return f"{owner[0]}/{owner[1]}{at} has control"

    def take_off(self, height_m: float | None, now_s: float) -> str | None:
        """Climb to a local height and hold there; disarmed: as soon as it is armed. It never descends."""
        reason = self._why_no_mode(FlightMode.TAKEOFF, now_s)
        if reason is not None:
            return f"Take-off refused: {reason}"
        if height_m is None:
            height_m = self._default_takeoff_z_m()
        (low, high), above_home_m = self.height_range_m, height_m - self.home_enu_m[2]
        if not low <= above_home_m <= high:
            return f"Take-off refused: {above_home_m:.4g} m above home, {low:g} to {high:g}"
        if self.mode is FlightMode.TAKEOFF and height_m == self.takeoff_z_m:
            return None
        if not self.standing and height_m < self._height_m():
            self.texts.say(dialect.MAV_SEVERITY_NOTICE, "Already higher than the take-off height")
            height_m = self._height_m()
        self.takeoff_z_m = height_m
        self._enter(FlightMode.TAKEOFF, now_s)
        return None

    def land(self, now_s: float) -> None:
        """Land at the present place; on the ground there is nothing to do. Nothing refuses it."""
        if self.armed:
            self._enter(FlightMode.LAND, now_s)

    def set_mode(self, mode: FlightMode, now_s: float) -> str | None:
        if mode is FlightMode.TAKEOFF:
            return self.take_off(None, now_s)
        if mode is FlightMode.LAND:
            self.land(now_s)
            return None
        reason = self._why_no_mode(mode, now_s)
        if reason is None and mode is FlightMode.OFFBOARD and not self._streamed(now_s):
            reason = "no set-points"
        if reason is not None:
            return f"Mode {mode.value} refused: {reason}"
        self._enter(mode, now_s)
        return None

    def take_setpoint(self, setpoint: Setpoint, sender: Sender, now_s: float) -> str | None:
        """Take a valid set-point; it keeps the stream alive in all modes."""
        other = self._other_has_control(sender, now_s)
        if other is not None:
            return f"Set-point dropped: {other}"
        self._owner, self._setpoint_s = sender, now_s
        self._take(setpoint, now_s)
        return None

    def _streamed(self, now_s: float) -> bool:
        """Whether the stream of set-points is alive."""
        return now_s - self._setpoint_s <= self.stream_lost_s + 1e-9

    def _enter(
        self, mode: FlightMode, now_s: float, *, failsafe: bool = False, restart: bool = False
    ) -> None:
        """Change the mode and begin to fly it; the same mode is begun anew by ``restart`` only."""
        self.failsafe = failsafe
        if mode is not self.mode or restart:
            self._change(mode)
            self._begin(now_s)

    def _change(self, mode: FlightMode) -> None:
        """Change the mode alone."""
        if mode is not self.mode:
            self.texts.say(dialect.MAV_SEVERITY_INFO, f"Mode {mode.value}")
        self.mode = mode
