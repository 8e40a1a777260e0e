"""Messages and requests of the companion; each request is repeated until the vehicle shows its effect.

Only telemetry counts: an acknowledgement does not prove that a command was executed (PX4 answers a mode
change twice, the first time always with ACCEPTED, and each answer can be lost). A rejection only affects the
retries.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import ned_from_enu, yaw_ned_from_enu
from bridge.mavlink.codec.messages import Message
from bridge.mavlink.profiles import Profile, Step
from flightstack.core.safety.gate import ApprovedSetpoint
from flightstack.core.types import Request, VehicleStatus

_PERIOD_S = 1.0  # time between two messages with the origin, s
_TRIES = 60
_E7 = 1e7  # MAVLink's integer degrees are multiples of 1e-7 degrees


class Origin(NamedTuple):
    """Position on earth (WGS84) of the origin of the local frame."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float


class OriginSender:
    """Sends SET_GPS_GLOBAL_ORIGIN to a disarmed vehicle on the ground until it reports its origin."""

    def __init__(self, origin: Origin | None, target_system: int) -> None:
        """``origin`` None: no message is sent."""
        self._origin, self._target_system = origin, target_system
        self._tries = 0
        self._last_s = -math.inf

    def restart(self) -> None:
        """Send the origin again after a restart: the vehicle may have lost the origin."""
        self._tries = 0

    def step(self, wanted: bool, now_s: float) -> list[Message]:
        """Return the message to send now.

        ``wanted``: the vehicle is disarmed and has sent neither its origin nor a local position. A local
        position shows that the vehicle has an origin; a second origin would reset the estimate.
        """
        origin = self._origin
        if origin is None or not wanted or self._tries >= _TRIES or now_s - self._last_s < _PERIOD_S:
            return []
        self._tries += 1
        self._last_s = now_s
        place = (round(origin.latitude_deg * _E7), round(origin.longitude_deg * _E7))
        height_mm = round(origin.altitude_amsl_m * 1000.0)
        return [dialect.MAVLink_set_gps_global_origin_message(self._target_system, *place, height_mm)]


def companion_heartbeat() -> Message:
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
    )


def request_message(target: tuple[int, int], message_id: int, unset: float) -> Message:
    """Return the command REQUEST_MESSAGE; ``unset`` is the autopilot's value of an omitted parameter."""
    params = (float(message_id), *(unset,) * 5, 0.0)
    return dialect.MAVLink_command_long_message(*target, dialect.MAV_CMD_REQUEST_MESSAGE, 0, *params)


# Set-point mask: ignore position (7) and acceleration (0x1C0), use velocity and yaw, ignore yaw rate (0x800).
# Only this mask has the same meaning in PX4 and ArduPilot; without a yaw PX4 drifts and ArduPilot turns.
VELOCITY_AND_YAW = 2503


def velocity_setpoint(setpoint: ApprovedSetpoint, target: tuple[int, int], now_s: float) -> Message:
    unused = (0.0, 0.0, 0.0)
    return dialect.MAVLink_set_position_target_local_ned_message(
        round(now_s * 1000) & 0xFFFFFFFF,
        *target,
        dialect.MAV_FRAME_LOCAL_NED,
        VELOCITY_AND_YAW,
        *unused,
        *ned_from_enu(setpoint.velocity_enu_m_s),
        *unused,
        yaw_ned_from_enu(setpoint.yaw_rad),
        0.0,
    )


_SET_MESSAGE_INTERVAL = 511  # MAV_CMD number of SET_MESSAGE_INTERVAL
_CHECK_S = 1.0  # time over which a rate is measured, s
_ENOUGH = 0.7  # sufficient fraction of the requested rate; lost messages and the autopilot's tick lower it
_ROUNDING_S = 1e-6  # margin for the rounding error of a time, s
_REQUESTS = 5  # number of requests that are sent at intervals of _CHECK_S; later requests follow at _AGAIN_S
_AGAIN_S = 3.0  # interval of the requests after the first _REQUESTS, s, while no message arrives


@dataclass(slots=True)
class _Stream:
    message_id: int
    rate_hz: float
    tries: int = 0
    seen: int = 0
    since_s: float = 0.0


class StreamRequests:
    """Counts messages and returns SET_MESSAGE_INTERVAL commands while their rate is too low; no I/O.

    As long as no message arrives, requests follow every second at first, then less often: an autopilot may
    have no position for minutes (no satellite fix, no origin). ``rates_hz``: required rate by message id.
    """

    def __init__(self, rates_hz: Mapping[int, float], target: tuple[int, int], unset: float) -> None:
        self._streams = {id_: _Stream(id_, rate) for id_, rate in rates_hz.items()}
        self._target, self._unset = target, unset
        self.quiet_until_s = -math.inf  # time before which ``step`` returns no message

    def seen(self, message_id: int, count: int = 1) -> None:
        stream = self._streams.get(message_id)
        if stream is not None:
            stream.seen += count

    @property
    def asked(self) -> tuple[int, ...]:
        return tuple(self._streams)

    def restart(self) -> None:
        """Immediately request missing messages again: a restarted vehicle has lost the requests."""
        for stream in self._streams.values():
            stream.tries = min(stream.tries, 1)
        self.quiet_until_s = -math.inf

    def step(self, now_s: float) -> list[Message]:
        """Return the commands to send now; called only after the first message of the vehicle."""
        if now_s < self.quiet_until_s:
            return []
        messages = []
        for stream in self._streams.values():
            elapsed_s = now_s - stream.since_s
            if stream.tries and elapsed_s < _CHECK_S:
                continue
            if stream.tries and stream.seen >= _ENOUGH * stream.rate_hz * elapsed_s:
                stream.tries = 1  # the stream arrives; if it stops later, requests start again
            elif stream.tries < _REQUESTS or (not stream.seen and elapsed_s >= _AGAIN_S):
                stream.tries += 1
                messages.append(self._request(stream))
            elif not stream.seen:  # else accept that the vehicle or its line is slower than requested
                continue
            stream.seen, stream.since_s = 0, now_s
        since_s = min((stream.since_s for stream in self._streams.values()), default=now_s)
        self.quiet_until_s = since_s + _CHECK_S - _ROUNDING_S
        return messages

    def _request(self, stream: _Stream) -> Message:
        interval_us, rest = float(round(1e6 / stream.rate_hz)), (self._unset,) * 4
        return dialect.MAVLink_command_long_message(
            *self._target, _SET_MESSAGE_INTERVAL, 0, float(stream.message_id), interval_us, *rest, 0.0
        )


_NAV_TAKEOFF = dialect.MAV_CMD_NAV_TAKEOFF
_STREAM_GAP_S = 0.3  # maximum pause within a stream of set-points, s (PX4 itself allows 1.0 s)
_RESULTS: dict[int, str] = {
    value: entry.name.removeprefix("MAV_RESULT_") for value, entry in dialect.enums["MAV_RESULT"].items()
}
_TEXTS_KEPT = 4
_WORKING_S = 3.0  # time until the next try after MAV_RESULT_IN_PROGRESS, s (as in MAVSDK)
_DATUM_PERIOD_S = 1.0  # time between two requests for the message with the datum of the take-off, s
_DATUM_TRIES = 30
_FINALS = 2  # number of final rejections that end a request: the first may belong to an earlier try
# rejections that a repetition does not change; after any other result the command is sent again
_FINAL = frozenset(
    {dialect.MAV_RESULT_DENIED, dialect.MAV_RESULT_UNSUPPORTED, dialect.MAV_RESULT_COMMAND_INT_ONLY}
)


class CommandSequencer:
    """Computes the commands for the current request from the vehicle's status and the time; no I/O.

    A request is complete when a heartbeat newer than the request shows the requested status. After that this
    class sends nothing: the controller reacts to a later change of mode.
    """

    def __init__(self, profile: Profile, target: tuple[int, int], takeoff_height_m: float) -> None:
        self._profile, self._target, self._height_m = profile, target, takeoff_height_m
        self._stream_start_s = self._stream_last_s = -math.inf
        # height of home above sea level, m, if the take-off height has this datum; None: not received
        self.home_amsl_m: float | None = None
        # arrival time, s, and newest height above home, m, if the take-off height has this datum. Arming
        # moves home to the vehicle unless home is locked.
        self.above_home: tuple[float, float] | None = None
        self._offset_m = 0.0  # height that is added to the climb in the take-off command, m
        self.failed: str | None = None  # reason why the current request failed, or None
        self.reached = False  # whether a heartbeat has shown the requested status
        self.request = Request.NONE
        self._since_s = -math.inf
        self._begun = False  # whether a request has been made
        self._enter(None, -math.inf)

    def _enter(self, step: Step | None, now_s: float) -> None:
        self._step, self._entered_s = step, now_s
        self._tries, self._first_try_s, self._last_try_s = 0, -math.inf, -math.inf
        self._datum_tries, self._datum_s = 0, -math.inf
        self._last_result: str | None = None
        self._working, self._finals = False, 0
        self._texts: list[str] = []

    def idle(self, request: Request, status: VehicleStatus | None) -> bool:
        """Whether ``step`` sends no message for this request until the status changes."""
        if request is not self.request or self.failed is not None:
            return False
        return self.reached or (self._begun and self._step is None and self._next_step(status) is None)

    def note_setpoint(self, now_s: float) -> None:
        """Record that a set-point is sent now; some autopilots need a stream before a mode change."""
        if now_s - self._stream_last_s > _STREAM_GAP_S:
            self._stream_start_s = now_s
        self._stream_last_s = now_s

    def note_ack(self, command: int, result: int) -> None:
        """Record a COMMAND_ACK, which decides on a retry and can be the reason of a failure."""
        if self._step is None or command != self._step.command:
            return
        self._last_result = _RESULTS.get(result, f"result {result}")
        self._working = result == dialect.MAV_RESULT_IN_PROGRESS
        self._finals += result in _FINAL

    def note_text(self, text: str) -> None:
        if self._step is not None and text not in self._texts:
            self._texts = [*self._texts, text][-_TEXTS_KEPT:]

    def step(self, request: Request, status: VehicleStatus | None, now_s: float) -> list[Message]:
        """Return the commands to send now, at most one. A new request starts a new sequence."""
        if request is not self.request:
            self.request, self._since_s = request, now_s
            self.failed, self.reached, self._begun = None, False, True
            self._enter(None, now_s)
        if self.reached or self.failed is not None:
            return []
        step = self._next_step(status)
        if step is not self._step:
            self._enter(step, now_s)
        if step is None:
            # Preparation before the first request is never complete: the vehicle may leave the mode again.
            self.reached = self._begun and status is not None and status.arrival_s > self._since_s
            return []
        datum = self._lacking(step)
        if datum is not None:
            return self._ask_datum(datum, now_s)
        period_s = max(step.period_s, _WORKING_S) if self._working else step.period_s
        if (step.prestream and not self._streams(now_s)) or now_s - self._last_try_s < period_s:
            return []
        if self._tries >= step.tries or (self._finals >= _FINALS and not step.blind):
            self.failed = self._reason(step, now_s)
            return []
        if self._tries == 0:
            self._first_try_s = now_s
        self._tries += 1
        self._last_try_s, self._working = now_s, False
        return [self._message(step)]

    @property
    def _counts_from_sea_level(self) -> bool:
        own = any(step.command == _NAV_TAKEOFF for step in self._profile.sequences[Request.TAKEOFF])
        return own and not self._profile.takeoff_above_home

    def _lacking(self, step: Step) -> int | None:
        """Return the id of the message that is still missing to compute the take-off height, or None."""
        if self.request is not Request.TAKEOFF:
            return None
        if self._counts_from_sea_level:
            return dialect.MAVLINK_MSG_ID_HOME_POSITION if self.home_amsl_m is None else None
        if step.command != _NAV_TAKEOFF or self._tries > 0:  # a repetition has the same height
            return None
        newer = self.above_home is not None and self.above_home[0] > self._entered_s
        return None if newer else dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT

    def _ask_datum(self, message_id: int, now_s: float) -> list[Message]:
        if now_s - self._datum_s < _DATUM_PERIOD_S:
            return []
        if self._datum_tries >= _DATUM_TRIES:
            name = dialect.mavlink_map[message_id].msgname
            self.failed = f"the vehicle did not send {name} in {self._datum_tries} tries"
            return []
        self._datum_s = now_s
        self._datum_tries += 1
        return [request_message(self._target, message_id, self._profile.unset)]

    def _next_step(self, status: VehicleStatus | None) -> Step | None:
        steps = self._profile.sequences[self.request] if self._begun else self._profile.prepare
        return next((s for s in steps if (s.blind if status is None else not s.done(status))), None)

    def _streams(self, now_s: float) -> bool:
        """Whether set-points have been sent without a pause for the time that the mode change requires."""
        lasts_s = now_s - self._stream_start_s if now_s - self._stream_last_s <= _STREAM_GAP_S else -math.inf
        return lasts_s >= self._profile.prestream_s - 1e-9

    def _message(self, step: Step) -> Message:
        if self._tries == 1:
            stands_m = self.above_home[1] if self.above_home is not None else 0.0
            self._offset_m = (self.home_amsl_m or 0.0) if self._counts_from_sea_level else stands_m
        values = [*step.params, *(self._profile.unset,) * (7 - len(step.params))]
        if step.command == _NAV_TAKEOFF:
            values[6] = self._height_m + self._offset_m
        confirmation = min(self._tries - 1, 255)
        return dialect.MAVLink_command_long_message(*self._target, step.command, confirmation, *values)

    def _reason(self, step: Step, now_s: float) -> str:
        said = f"; its texts: {' | '.join(self._texts)}" if self._texts else ""
        return (
            f"{step.name} (command {step.command}) had no visible effect after {self._tries} tries in "
            f"{now_s - self._first_try_s:.1f} s; last answer: {self._last_result or 'none'}{said}"
        )
