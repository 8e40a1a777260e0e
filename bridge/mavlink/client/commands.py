"""Turns a request, held as a level, into MAVLink commands until the heartbeat shows what was wanted.

Telemetry is the truth: no acknowledgement proves that anything was done (PX4 answers a mode change twice, the
first time always with ACCEPTED, and one can be lost). A refusal only says whether trying again makes sense.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.companion import request_message
from bridge.mavlink.codec.decoding import Message
from bridge.mavlink.profiles.profile import Profile, Reading, Step, TakeoffAltitude
from flightstack.core.types import Request, VehicleStatus

_NAV_TAKEOFF = dialect.MAV_CMD_NAV_TAKEOFF
_STREAM_GAP_S = 0.3  # s; a longer pause between two set-points ends a stream (PX4 itself allows 1.0 s)
_RESULTS: dict[int, str] = {
    value: entry.name.removeprefix("MAV_RESULT_") for value, entry in dialect.enums["MAV_RESULT"].items()
}
_TEXTS_KEPT = 4
_WORKING_S = 3.0  # s until the next try of what the vehicle says it is working on (as MAVSDK waits)
_HOME_PERIOD_S = 1.0  # s between two questions for HOME_POSITION; PX4 sends it every 2 s by itself
_HOME_TRIES = 30
_FINALS = 2  # final refusals until a request is given up: one may be of an earlier try


class CommandSequencer:
    """Pure: time and status come in, messages go out; nothing is sent or waited for here.

    Once a heartbeat newer than the request has shown what was wanted, nothing more is sent for that request:
    when the mode changes afterwards somebody changed it, and the controller decides, not a retry.

    Attributes:
        failed: why the present request was given up, None while it is not.
        reached: a heartbeat has shown what the present request wants.
        home_amsl_m: height of home above sea level, for autopilots that count from there; None: not told yet,
            and then it is asked for before anything is armed.
    """

    def __init__(
        self, profile: Profile, target_system: int, target_component: int, takeoff_height_m: float
    ) -> None:
        """Set up for one vehicle. ``takeoff_height_m`` is the height above home that TAKEOFF climbs to.

        Raises:
            ValueError: the height is not a positive number.
        """
        if not (takeoff_height_m > 0.0 and math.isfinite(takeoff_height_m)):
            raise ValueError(f"take-off height is {takeoff_height_m} m: a positive number is needed")
        self._profile = profile
        self._target = (target_system, target_component)
        self._height_m = takeoff_height_m
        self._stream_start_s: float | None = None
        self._stream_last_s = -math.inf
        self.home_amsl_m: float | None = None
        self._home_tries = 0
        self._home_s = -math.inf
        self.failed: str | None = None
        self.reached = False
        self._request = Request.NONE
        self._since_s = -math.inf
        self._step: Step | None = None
        self._tries = 0
        self._first_try_s = -math.inf
        self._last_try_s = -math.inf
        self._last_result: str | None = None
        self._working = False
        self._finals = 0
        self._begun = False  # something has been asked for
        self._texts: list[str] = []

    @property
    def request(self) -> Request:
        """The request being worked on."""
        return self._request

    def idle(self, request: Request, status: VehicleStatus | None) -> bool:
        """Whether ``step`` sends nothing for this request as long as the status does not change.

        Args:
            request: that ``step`` would get.
            status: of the vehicle.
        """
        if request is not self._request or self.failed is not None:
            return False
        return self.reached or (self._begun and self._step is None and self._next_step(status) is None)

    def note_setpoint(self, now_s: float) -> None:
        """Take note that a set-point goes out now; some autopilots want a stream before they switch."""
        if self._stream_start_s is None or now_s - self._stream_last_s > _STREAM_GAP_S:
            self._stream_start_s = now_s
        self._stream_last_s = now_s

    def note_ack(self, command: int, result: int) -> None:
        """Take note of a COMMAND_ACK: for the reason of a failure, and whether to try again."""
        if self._step is None or command != self._step.command:
            return
        self._last_result = _RESULTS.get(result, f"result {result}")
        reading = self._profile.answers.get(result, Reading.AGAIN)
        self._working = reading is Reading.WORKING
        self._finals += reading is Reading.FINAL

    def note_text(self, text: str) -> None:
        """Take note of what the vehicle says, for the reason of a failure."""
        if self._step is not None and text not in self._texts:
            self._texts = [*self._texts, text][-_TEXTS_KEPT:]

    def step(self, request: Request, status: VehicleStatus | None, now_s: float) -> list[Message]:
        """Return the commands to send now, at most one. A change of the request starts over."""
        if request is not self._request:
            self._request, self._since_s = request, now_s
            self.failed, self.reached = None, False
            self._begun = True
            self._enter(None)
        if self.reached or self.failed is not None:
            return []
        step = self._next_step(status)
        if step is not self._step:
            self._enter(step)
        if step is None:
            # Before the first request nothing counts as reached: the vehicle may leave the prepared mode.
            self.reached = self._begun and status is not None and status.arrival_s > self._since_s
            return []
        if self._request is Request.TAKEOFF and self.home_amsl_m is None and self._counts_from_sea_level:
            return self._ask_home(now_s)
        period_s = max(step.period_s, _WORKING_S) if self._working else step.period_s
        if (step.prestream and not self._streaming(now_s)) or now_s - self._last_try_s < period_s:
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
        return own and self._profile.takeoff_altitude is TakeoffAltitude.AMSL

    def _ask_home(self, now_s: float) -> list[Message]:
        """Without its height above sea level no height above home can be told."""
        if now_s - self._home_s < _HOME_PERIOD_S:
            return []
        if self._home_tries >= _HOME_TRIES:
            self.failed = f"the vehicle did not tell its home (HOME_POSITION) in {self._home_tries} tries"
            return []
        self._home_s = now_s
        self._home_tries += 1
        wanted = dialect.MAVLINK_MSG_ID_HOME_POSITION
        return [request_message(self._target, wanted, self._profile.unset)]

    def _enter(self, step: Step | None) -> None:
        self._step, self._tries, self._last_try_s = step, 0, -math.inf
        self._last_result, self._working, self._finals, self._texts = None, False, 0, []

    def _next_step(self, status: VehicleStatus | None) -> Step | None:
        steps = self._profile.sequences[self._request] if self._begun else self._profile.prepare
        needed: Callable[[Step], bool] = (
            (lambda step: step.blind) if status is None else (lambda step: not step.done(status))
        )
        return next(filter(needed, steps), None)

    def _streaming(self, now_s: float) -> bool:
        start_s = self._stream_start_s
        if start_s is None or now_s - self._stream_last_s > _STREAM_GAP_S:
            return False
        return now_s - start_s >= self._profile.prestream_s - 1e-9

    def _message(self, step: Step) -> Message:
        offset_m = self.home_amsl_m if self._counts_from_sea_level else None
        params = step.params(self._height_m + (offset_m or 0.0))
        values = [self._profile.unset if value is None else value for value in params]
        confirmation = min(self._tries - 1, 255)
        return dialect.MAVLink_command_long_message(*self._target, step.command, confirmation, *values)

    def _reason(self, step: Step, now_s: float) -> str:
        said = f"; it said: {' | '.join(self._texts)}" if self._texts else ""
        return (
            f"{step.name} (command {step.command}) was not shown by the vehicle after {self._tries} tries in "
            f"{now_s - self._first_try_s:.1f} s; last answer: {self._last_result or 'none'}{said}"
        )
