"""Decodes MAVLink telemetry into the newest vehicle state and status in the stack's frames; no I/O."""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import enu_from_ned, yaw_enu_from_ned
from bridge.mavlink.client.senders import SILENT_S
from bridge.mavlink.codec.messages import Message
from bridge.mavlink.profiles import Profile, refusal
from flightstack.core.sender_clock import Reading, SenderClock
from flightstack.core.types import Landed, Mode, OwnState, Power, VehicleStatus

_GLOBAL_POSITION = dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
_ARMED = dialect.MAV_MODE_FLAG_SAFETY_ARMED
_PREARM = dialect.MAV_SYS_STATUS_PREARM_CHECK
_REBOOT_S = 1.0  # smallest backward step of the boot clock that shows a reboot after a silence, s
# time for which rejected messages must agree before they are accepted, s; longer than the default of
# checks.own_age_max_s, so the vehicle state counts as lost first
_PROOF_S = 0.3
_TICK_S = 0.1  # maximum period of the loop that handles messages, s; messages wait up to this time
_YAW_AGE_MAX_S = 0.5  # maximum time between a position and the attitude that gives the heading, s
_LARGEST = 1e6  # maximum plausible value, m, m/s, rad or rad/s; a larger value counts as corrupted
_THROTTLE_AGE_MAX_S = 1.0  # maximum age of the throttle in VFR_HUD, s
_VOLTAGE_UNKNOWN = 0xFFFF  # value in mV of an unknown voltage, MAVLink SYS_STATUS.voltage_battery
_LANDED = {state.value: state for state in Landed}


class Battery(NamedTuple):
    """Battery data of SYS_STATUS; unknown values are None."""

    arrival_s: float
    voltage_v: float | None
    share: float | None  # remaining charge, 0 to 1


class VehicleState:
    """Newest state and status of the vehicle from its messages; the caller has checked the sender."""

    def __init__(self, profile: Profile | None) -> None:
        # profile with the meaning of the modes; None: still unknown, so no status is available
        self.profile = profile
        # numbers of rejected messages by reason; ``onboard.waiting`` shows these numbers
        self.counters = Counter[str]()
        self.own: OwnState | None = None  # newest vehicle state; None before a position and an attitude
        # newest status, None before a heartbeat; ``arrival_s`` is the heartbeat's arrival
        self.status: VehicleStatus | None = None
        # altitude of home above sea level, m; None before HOME_POSITION
        self.home_amsl_m: float | None = None
        # arrival time, s, and newest height above home, m; None before GLOBAL_POSITION_INT
        self.above_home: tuple[float, float] | None = None
        self.autopilot: int | None = None  # MAV_AUTOPILOT of the newest heartbeat; None: no heartbeat
        self.type: int | None = None  # MAV_TYPE of the newest heartbeat; None: no heartbeat
        # whether the vehicle has sent its origin since its last restart
        self.origin_known = False
        # time of the last restart on the stack's clock: the boot clock stepped, or heartbeats resumed after a
        # silence; -inf: no restart
        self.restarted_s = -math.inf
        self._beat_s = math.inf  # arrival time of the newest heartbeat, s
        self._following = profile is None or profile.stream_in_takeoff
        self._custom_mode = 0
        self.battery: Battery | None = None  # newest battery data; None before SYS_STATUS
        # newest data of battery and motors; None: no data yet; updated only after ``watch_power``
        self.power: Power | None = None
        self._throttle, self._throttle_s, self._cos_tilt = math.nan, -math.inf, math.nan
        self._watches_power = False
        # late messages are accepted: a simulator may be slower than real time
        self._position_clock, self._attitude_clock = (
            SenderClock(math.inf, _PROOF_S, _TICK_S, _REBOOT_S) for _ in range(2)
        )
        self._yaw_enu_rad: float | None = None
        self._yaw_time_s = 0.0
        self._landed = Landed.UNKNOWN
        self._ready = False
        self._handlers = {
            dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._on_position,
            dialect.MAVLINK_MSG_ID_ATTITUDE: self._on_attitude,
            dialect.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._on_extended_state,
            dialect.MAVLINK_MSG_ID_SYS_STATUS: self._on_sys_status,
            dialect.MAVLINK_MSG_ID_HOME_POSITION: self._on_home,
            _GLOBAL_POSITION: self._on_global_position,
            dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._on_origin,
        }

    def watch_power(self) -> None:
        self._watches_power = True
        self._handlers[dialect.MAVLINK_MSG_ID_VFR_HUD] = self._on_vfr_hud

    @property
    def following(self) -> bool:
        """Whether the external mode follows this stack's set-points, not a take-off of the vehicle."""
        return self._following

    def follow(self, following: bool) -> None:
        """Record whether the vehicle now follows set-points, or (False) its own take-off."""
        if following != self._following:
            self._following = following
            self._refresh()

    @property
    def heeded(self) -> frozenset[int]:
        counts_from_home = self.profile is None or self.profile.takeoff_above_home
        return frozenset(self._handlers) - (set() if counts_from_home else {_GLOBAL_POSITION})

    @property
    def repeated(self) -> frozenset[int]:
        """Ids of the messages that repeat known values as long as the vehicle's condition does not change.

        SYS_STATUS also contains the battery, which the controller uses only after ``watch_power``.
        """
        landed, battery = dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, dialect.MAVLINK_MSG_ID_SYS_STATUS
        return frozenset((landed,) if self._watches_power else (landed, battery))

    def took(self, own: OwnState) -> None:
        """Record a vehicle state that other code decoded, and its heading as the newest heading."""
        self.own, self._yaw_enu_rad, self._yaw_time_s = own, own.yaw_rad, own.source_time_s

    def update(self, message: Message, arrival_s: float) -> None:
        """Handle a message of the vehicle; ``arrival_s`` is on the stack's clock."""
        handler = self._handlers.get(message.get_msgId())  # a STATUSTEXT has a field named id
        if handler is not None:
            handler(message, arrival_s)

    def tilted(self, roll_rad: float, pitch_rad: float) -> None:
        self._cos_tilt = math.cos(roll_rad) * math.cos(pitch_rad)

    def _on_position(self, m: Message, arrival_s: float) -> None:
        time_s: float = m.time_boot_ms * 1e-3
        if not _usable(m.x, m.y, m.z, m.vx, m.vy, m.vz):
            self.counters["not_finite"] += 1
        elif not self._in_time(self._position_clock, time_s, arrival_s):
            return
        elif self._yaw_enu_rad is None or abs(time_s - self._yaw_time_s) > _YAW_AGE_MAX_S:
            self.counters["without_yaw"] += 1
        else:
            position, velocity = enu_from_ned((m.x, m.y, m.z)), enu_from_ned((m.vx, m.vy, m.vz))
            self.own = OwnState(arrival_s, time_s, position, velocity, self._yaw_enu_rad)

    def _on_attitude(self, m: Message, arrival_s: float) -> None:
        time_s: float = m.time_boot_ms * 1e-3
        if not _usable(m.roll, m.pitch, m.yaw, m.rollspeed, m.pitchspeed, m.yawspeed):
            self.counters["not_finite"] += 1
        elif self._in_time(self._attitude_clock, time_s, arrival_s):
            # the age of a heading is the time stamp of the position minus that of the attitude
            self._yaw_enu_rad = yaw_enu_from_ned(m.yaw)
            self._yaw_time_s = time_s
            if self._watches_power:
                self.tilted(m.roll, m.pitch)

    def _in_time(self, clock: SenderClock, time_s: float, arrival_s: float) -> bool:
        """Whether a boot time is plausible; an accepted step of the boot clock means a restart."""
        reading = clock.accept(time_s, arrival_s)
        if reading is Reading.STEPPED:
            self._restart(arrival_s)
        elif reading is Reading.AHEAD:
            self.counters["ahead"] += 1
        elif not reading.good:
            self.counters["out_of_order"] += 1
        return reading.good

    def _on_heartbeat(self, m: Message, arrival_s: float) -> None:
        if arrival_s - self._beat_s > SILENT_S:
            self._restart(arrival_s)
        self._beat_s = arrival_s
        self.autopilot, self.type, profile = m.autopilot, m.type, self.profile
        if profile is None or refusal(m.autopilot, m.type, profile) is not None:
            self.counters["other_autopilot"] += 1  # ignored: its mode numbers have another meaning
            return
        armed = bool(m.base_mode & _ARMED)
        if not armed and not profile.stream_in_takeoff:
            self._following = False
        self._custom_mode = m.custom_mode
        self.status = VehicleStatus(arrival_s, armed, self._mode(), self._landed, self._ready)

    def _restart(self, arrival_s: float) -> None:
        """Handle a restart, or a silence that may have been a restart."""
        self.restarted_s, self.origin_known = arrival_s, False

    def _mode(self) -> Mode:
        """Return the mode of the newest heartbeat; an external mode without set-points is a take-off."""
        assert self.profile is not None
        mode = self.profile.mode(self._custom_mode)
        return Mode.TAKEOFF if mode is Mode.EXTERNAL and not self._following else mode

    def _on_extended_state(self, m: Message, _arrival_s: float) -> None:
        self._landed = _LANDED.get(m.landed_state, Landed.UNKNOWN)
        self._refresh()

    def _on_sys_status(self, m: Message, arrival_s: float) -> None:
        voltage_v = m.voltage_battery * 1e-3 if m.voltage_battery != _VOLTAGE_UNKNOWN else None
        share = m.battery_remaining / 100.0 if m.battery_remaining >= 0 else None
        self.battery = Battery(arrival_s, voltage_v, share)
        self._ready = bool(m.onboard_control_sensors_health & _PREARM)
        self._refresh()
        if self._watches_power:
            self._tell_power(arrival_s)

    def _on_vfr_hud(self, m: Message, arrival_s: float) -> None:
        self._throttle, self._throttle_s = m.throttle * 1e-2, arrival_s  # VFR_HUD contains percent
        self._tell_power(arrival_s)

    def _tell_power(self, arrival_s: float) -> None:
        battery = self.battery
        voltage_v = battery.voltage_v if battery is not None else None
        told = arrival_s - self._throttle_s <= _THROTTLE_AGE_MAX_S
        self.power = Power(
            arrival_s,
            voltage_v if voltage_v is not None else math.nan,
            self._throttle if told else math.nan,
            self._cos_tilt,
        )

    def _on_home(self, m: Message, _arrival_s: float) -> None:
        self.home_amsl_m = m.altitude * 1e-3  # HOME_POSITION contains mm

    def _on_global_position(self, m: Message, arrival_s: float) -> None:
        self.above_home = (arrival_s, m.relative_alt * 1e-3)  # GLOBAL_POSITION_INT contains mm

    def _on_origin(self, _m: Message, _arrival_s: float) -> None:
        self.origin_known = True

    def _refresh(self) -> None:
        old = self.status
        if old is not None:
            self.status = VehicleStatus(old.arrival_s, old.armed, self._mode(), self._landed, self._ready)


def _usable(a: float, b: float, c: float, d: float, e: float, f: float) -> bool:
    """Whether all numbers are finite and of plausible size."""
    most = _LARGEST
    return (
        -most < a < most and -most < b < most and -most < c < most
        and -most < d < most and -most < e < most and -most < f < most
    )  # fmt: skip
