"""Flight modes and commands of a vehicle that behaves like PX4, and the choice of the client in control.

One sender of set-points has control of the vehicle; only a few commands of other senders are accepted. PX4
follows the newest message, so a second companion or a forgotten script could take over in flight.

A subclass arms and disarms, flies the modes, and adds its fail-safes. Methods that can refuse return the
reason, or None after success.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from enum import Enum
from typing import Any, ClassVar, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import enu_from_ned, flu_from_frd, quaternion_from_yaw, world_from_body, yaw_enu_from_ned
from bridge.mavlink.codec.messages import Message
from bridge.mavlink.server.profile import AIRBORNE_STATE, FlightMode
from bridge.mavlink.transport.address import Peer
from flightstack.core.types import ZERO, Vec3

# system id, component id, and the address if there is one: ids alone are not unique
Sender = tuple[int, int] | tuple[int, int, Peer]

# System ids of ground stations: QGroundControl, MAVProxy and dronekit use 255, MAVSDK uses 245.
GROUND_STATIONS = frozenset({255, 245})


SPEED_MAX_M_S = 5.0  # maximum accepted speed, m/s; far above the commands of any controller of this stack
YAW_RATE_MAX_RAD_S = 6.0  # maximum accepted yaw rate, rad/s

# POSITION_TARGET_TYPEMASK: a set bit means "ignore". Bit 9 concerns the acceleration, which is unused.
_POSITION = 0b000000111
_VELOCITY = 0b000111000
_ACCELERATION = 0b111000000
_YAW = 1 << 10
_YAW_RATE = 1 << 11
_FRAMES = (dialect.MAV_FRAME_LOCAL_NED, dialect.MAV_FRAME_BODY_NED)


class Setpoint(NamedTuple):
    velocity_enu_m_s: Vec3
    yaw_rad: float | None  # heading to hold, counter-clockwise from east; None: ``yaw_rate_rad_s`` applies
    yaw_rate_rad_s: float  # yaw rate, counter-clockwise; 0 holds the present heading


def read_setpoint(message: Any, yaw_rad: Callable[[], float | None]) -> Setpoint | str:
    """Convert SET_POSITION_TARGET_LOCAL_NED into a set-point, or return the reason of its refusal.

    A velocity in a body frame is rotated by the heading only, as in PX4. ``yaw_rad`` returns the present
    heading of the vehicle, counter-clockwise from east; None: unknown.
    """
    mask = message.type_mask
    if mask & _POSITION != _POSITION or mask & _ACCELERATION != _ACCELERATION or mask & _VELOCITY:
        return f"Set-point dropped: mask {mask}, only velocity (2503)"
    v = (message.vx, message.vy, message.vz)
    if not math.isfinite(sum(v)):
        return "Set-point dropped: velocity not finite"
    if v[0] * v[0] + v[1] * v[1] + v[2] * v[2] > SPEED_MAX_M_S**2:
        return f"Set-point dropped: above {SPEED_MAX_M_S:g} m/s"
    if message.coordinate_frame not in _FRAMES:
        known = " or ".join(map(str, _FRAMES))
        return f"Set-point dropped: frame {message.coordinate_frame}, only {known}"
    if message.coordinate_frame == dialect.MAV_FRAME_BODY_NED:
        heading_rad = yaw_rad()
        if heading_rad is None:
            return "Set-point dropped: body frame, but the heading is not known"
        velocity = world_from_body(quaternion_from_yaw(heading_rad), flu_from_frd(v))
    else:
        velocity = enu_from_ned(v)
    if not mask & _YAW:
        if not math.isfinite(message.yaw):
            return "Set-point dropped: yaw not finite"
        return Setpoint(velocity, yaw_enu_from_ned(message.yaw), 0.0)
    if not mask & _YAW_RATE:
        if not abs(message.yaw_rate) <= YAW_RATE_MAX_RAD_S:  # this form also rejects NaN
            return f"Set-point dropped: yaw rate above {YAW_RATE_MAX_RAD_S:g} rad/s"
        return Setpoint(velocity, None, -message.yaw_rate)
    return Setpoint(velocity, None, 0.0)


_CHUNK = 50  # maximum number of characters of one STATUSTEXT
_TEXTS_MAX = 64  # maximum number of texts that wait to be sent
# time between two refusals on one topic, s; a wrong stream repeats its error 100 times a second
_SAME_GAP_S = 1.0
_BURST = 20  # maximum number of refusals in _SAME_GAP_S; the start of a ground station causes 12


class Text(NamedTuple):
    severity: int  # severity number of MAVLink (MAV_SEVERITY)
    text: str


class Texts:
    """Texts that wait to be sent, at most 64; the rate of refusals is limited."""

    def __init__(self) -> None:
        self.waiting: list[Text] = []  # texts that wait to be sent, oldest first
        self._said_s: dict[str, float] = {}  # times of the refusals in the last second, by topic
        self._hidden = 0
        self._id = 0  # id of the newest text that was split into chunks

    def say(self, severity: int, text: str) -> None:
        if len(self.waiting) < _TEXTS_MAX:
            self.waiting.append(Text(severity, text))

    def refuse(
        self, text: str, now_s: float, topic: str = "", severity: int = dialect.MAV_SEVERITY_WARNING
    ) -> None:
        """Add a refusal, unless its topic (default: the text) had a refusal in the last second."""
        topic = topic or text
        self._said_s = {of: at_s for of, at_s in self._said_s.items() if now_s - at_s < _SAME_GAP_S}
        if topic in self._said_s:
            return
        if len(self._said_s) >= _BURST:
            self._hidden += 1
            return
        if self._hidden:
            self.say(dialect.MAV_SEVERITY_WARNING, f"{self._hidden} refusals not shown")
            self._hidden = 0
        self._said_s[topic] = now_s
        self.say(severity, text)

    def take(self) -> list[Text]:
        texts, self.waiting = self.waiting, []
        return texts

    def messages(self, text: Text) -> list[Message]:
        """Convert a text into STATUSTEXT messages; a long text is split into chunks."""
        raw = text.text.encode("ascii", "replace")
        if len(raw) <= _CHUNK:
            return [dialect.MAVLink_statustext_message(text.severity, raw)]
        self._id = self._id % 0xFFFF + 1  # 0 means "not in chunks"
        # A chunk shorter than 50 characters ends the text; after a full last chunk an empty chunk follows.
        return [
            dialect.MAVLink_statustext_message(text.severity, raw[at : at + _CHUNK], self._id, at // _CHUNK)
            for at in range(0, len(raw) + 1, _CHUNK)
        ]


class Right(Enum):
    """Senders that may send a command while one sender has control."""

    ANYBODY = "anybody"  # any sender; for queries, telemetry and landing, which are harmless
    OWNER = "owner"  # sender in control; for commands that change the motion of the vehicle
    OWNER_OR_GROUND = "owner or ground station"  # sender in control or ground station; to stop the motors


class Battery(NamedTuple):
    """Voltage and charge of a battery with one cell."""

    voltage_v: float
    percent: int  # remaining charge, percent; -1: unknown


class Commander(ABC):
    """State and commands of one vehicle, as the server needs them."""

    mark: ClassVar[bytes]  # kind of vehicle: 8 bytes of AUTOPILOT_VERSION.flight_custom_version
    # MAV_SYS_STATUS_SENSOR bits that are always healthy
    sensors: ClassVar[int] = (
        dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO
        | dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL
        | dialect.MAV_SYS_STATUS_SENSOR_3D_MAG
        | dialect.MAV_SYS_STATUS_SENSOR_BATTERY
    )
    height_range_m: ClassVar[tuple[float, float]]  # lowest and highest take-off above home, m

    def __init__(self) -> None:
        self.mode = FlightMode.HOLD  # flight mode; also defined for a disarmed vehicle
        self.failsafe = False  # whether a failure, not a client, has set the mode
        self.texts = Texts()
        self.home_enu_m: Vec3 = ZERO
        self.takeoff_z_m = 0.0  # local height of the next or present take-off, m
        self._owner: Sender | None = None  # sender in control; it loses control when its set-points stop
        self._setpoint_s = -math.inf  # time of the newest set-point of the sender in control

    @property
    @abstractmethod
    def armed(self) -> bool:
        """Whether the motors may run."""

    @property
    def arming(self) -> bool:
        """Whether arming was requested and the result is not known yet."""
        return False

    @property
    @abstractmethod
    def standing(self) -> bool:
        """Whether the vehicle stands on the ground or the pad; a short touch does not count."""

    @property
    @abstractmethod
    def battery(self) -> Battery: ...

    @property
    @abstractmethod
    def stream_lost_s(self) -> float:
        """Time without set-points after which the stream counts as lost and control is free, s."""

    @abstractmethod
    def sensors_healthy(self, now_s: float, /) -> int:
        """Return the MAV_SYS_STATUS_SENSOR bits of healthy sensors, in addition to ``sensors``."""

    @abstractmethod
    def problems(self, now_s: float, /) -> list[str]:
        """Return the reasons against arming now; empty when ready."""

    @abstractmethod
    def yaw_rad(self) -> float | None:
        """Return the heading, counter-clockwise from east; None: unknown."""

    @abstractmethod
    def arm(self, now_s: float, /) -> str | None: ...

    @abstractmethod
    def disarm(self, now_s: float, /, *, force: bool) -> str | None:
        """Disarm the vehicle; in the air only if ``force`` is set."""

    @abstractmethod
    def terminate(self, now_s: float, /) -> str | None:
        """Stop the motors at any height."""

    @abstractmethod
    def _why_no_mode(self, mode: FlightMode, now_s: float) -> str | None:
        """Return the reason why the mode cannot start, or None; a change to LAND is not checked."""

    @abstractmethod
    def _height_m(self) -> float:
        """Return the estimated local height, m; -inf: unknown."""

    @abstractmethod
    def _default_takeoff_z_m(self) -> float:
        """Return the default local height of a take-off, m."""

    @abstractmethod
    def _begin(self, now_s: float) -> None:
        """Start to fly ``mode`` from the present state."""

    @abstractmethod
    def _take(self, setpoint: Setpoint, now_s: float) -> None:
        """Handle a set-point of the sender in control; a set-point is flown only in OFFBOARD."""

    # Commands of clients

    @property
    def landed_state(self) -> int:
        return int(dialect.MAV_LANDED_STATE_ON_GROUND) if self.standing else AIRBORNE_STATE[self.mode]

    def forbids(self, sender: Sender, right: Right, now_s: float) -> str | None:
        """Return the reason to refuse a command of a sender, or None; if disarmed, accept all senders."""
        ground = right is Right.OWNER_OR_GROUND and sender[0] in GROUND_STATIONS
        if not self.armed or right is Right.ANYBODY or ground:
            return None
        return self._other_has_control(sender, now_s)

    def _other_has_control(self, sender: Sender, now_s: float) -> str | None:
        """Return a text about another sender that has control; None if no other sender has control."""
        owner = self._owner
        if owner is None or sender == owner or now_s - self._setpoint_s > self.stream_lost_s:
            return None
        at = f" at {owner[2][0]}:{owner[2][1]}" if len(owner) == 3 and owner[:2] == sender[:2] else ""
        return f"{owner[0]}/{owner[1]}{at} has control"

    def take_off(self, height_m: float | None, now_s: float) -> str | None:
        """Climb to a local height, m, and hold it; never descend. A disarmed vehicle climbs after arming."""
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

    def land(self, now_s: float) -> str | None:
        """Land at the present position. A landing is never refused; a disarmed vehicle ignores it."""
        if self.armed:
            self._enter(FlightMode.LAND, now_s)
        return None

    def set_mode(self, mode: FlightMode, now_s: float) -> str | None:
        if mode is FlightMode.TAKEOFF:
            return self.take_off(None, now_s)
        if mode is FlightMode.LAND:
            return self.land(now_s)
        reason = self._why_no_mode(mode, now_s)
        if reason is None and mode is FlightMode.OFFBOARD and not self._streamed(now_s):
            reason = "no set-points"
        if reason is not None:
            return f"Mode {mode.value} refused: {reason}"
        self._enter(mode, now_s)
        return None

    def take_setpoint(self, setpoint: Setpoint, sender: Sender, now_s: float) -> str | None:
        """Take a set-point unless another sender has control; in any mode it continues the stream."""
        other = self._other_has_control(sender, now_s)
        if other is not None:
            return f"Set-point dropped: {other}"
        self._owner, self._setpoint_s = sender, now_s
        self._take(setpoint, now_s)
        return None

    def _streamed(self, now_s: float) -> bool:
        return now_s - self._setpoint_s <= self.stream_lost_s + 1e-9

    def _enter(
        self, mode: FlightMode, now_s: float, *, failsafe: bool = False, restart: bool = False
    ) -> None:
        """Change the mode and start to fly the new mode; the present mode restarts only with ``restart``."""
        self.failsafe = failsafe
        if mode is not self.mode or restart:
            self._change(mode)
            self._begin(now_s)

    def _change(self, mode: FlightMode) -> None:
        """Change the mode and report it, without ``_begin``."""
        if mode is not self.mode:
            self.texts.say(dialect.MAV_SEVERITY_INFO, f"Mode {mode.value}")
        self.mode = mode
