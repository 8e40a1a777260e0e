"""A test pilot that flies one step at a time over the companion's link, within limits of place and time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType

from bridge.mavlink.client.companion import Origin
from bridge.mavlink.client.link import COMPONENT_ID, VehicleLink
from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.profiles import profile
from bridge.mavlink.signing import load_key
from flightstack.common.pacing import FastClock, RealTimePacer
from flightstack.config import load
from flightstack.core.types import ZERO, Landed, Mode, OwnState, Request, Vec3, VehicleStatus
from tests.flight_suite.room import LIMITS, Limits, Room

RATE_HZ = 50
STATE_AGE_MAX_S = 2.0  # maximum state age, s; large, because the vehicle holds position by its own estimate
WALL_FACTOR = 5.0  # ratio of wall time to time-out; a simulated vehicle's clock stops if the machine pauses
HEARTBEAT_AGE_MAX_S = 3.5
CONNECT_MAX_S = 60.0  # time-out from the start to a valid position estimate, s
DOWN_MAX_S = 30.0  # time-out from the end of a step to motors off, s
KILL_AFTER_S = 20.0  # duration of a landing after which the motors are stopped below LOW_M, s
LOW_M = 0.1
CLIMB_M_S = 0.5


@dataclass(frozen=True)
class Setpoint:
    velocity_enu_m_s: Vec3
    yaw_rad: float


class Pilot:
    """Context manager of a test pilot; at the end, an armed vehicle is landed in every case."""

    def __init__(self, room: Room) -> None:
        self._room = room
        place = load(room.config).vehicle.origin_wgs84
        # the pilot connects like the companion: same class, component id and signing key
        key = load_key(room.signing_key) if room.signing_key else None
        self.link = VehicleLink(
            Endpoint(room.url, room.system_id, COMPONENT_ID, signing_key=key),
            takeoff_height_m=room.takeoff_height_m, rate_hz=float(RATE_HZ),
            profile=profile(room.autopilot), system_id=room.system_id,
            origin=Origin(*place) if place is not None else None,
        )  # fmt: skip
        self._pacer = RealTimePacer(RATE_HZ, FastClock(room.speed))
        self.now_s = 0.0
        self.texts: list[str] = []  # texts that the vehicle sent
        self.start_enu_m: Vec3 | None = None
        self.max_height_m = 0.0  # largest height above the start so far, m

    def __enter__(self) -> Pilot:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self.link.state.status is not None and self.link.state.status.armed:
                self.bring_down()
        finally:
            self.link.close()

    @property
    def own(self) -> OwnState:
        assert self.link.state.own is not None, "no own state"
        return self.link.state.own

    @property
    def vehicle_s(self) -> float:
        """Time on the vehicle's clock, s; the time limits use this clock."""
        return self.own.source_time_s

    @property
    def status(self) -> VehicleStatus:
        assert self.link.state.status is not None, "no status"
        return self.link.state.status

    @property
    def limits(self) -> Limits:
        if self._room.limits is not None:
            return self._room.limits
        assert self.link.state.profile is not None, "not connected"
        return LIMITS[self.link.state.profile.name]

    @property
    def height_m(self) -> float:
        """Height of the vehicle above the start, m."""
        assert self.start_enu_m is not None, "not connected"
        return self.own.position_enu_m[2] - self.start_enu_m[2]

    def connect(self) -> None:
        """Wait for heartbeat, state and landed state; store the position as the start."""
        self.watch("connect", self._known, CONNECT_MAX_S)
        self.start_enu_m = self.own.position_enu_m

    def _known(self) -> bool:
        status = self.link.state.status
        return status is not None and self.link.state.own is not None and status.landed is not Landed.UNKNOWN

    def watch(self, step: str, done: Callable[[], bool], limit_s: float) -> float:
        """Send neither request nor set-point until the condition holds; return the duration, s."""
        return self.ask(step, Request.NONE, done, limit_s)

    def ask(self, step: str, request: Request, done: Callable[[], bool], limit_s: float) -> float:
        """Send the MAVLink commands of a request until the condition holds; return the duration, s."""
        return self._run(step, lambda: self.link.command(request, self.now_s), done, limit_s)

    def fly(self, step: str, velocity_enu_m_s: Vec3, done: Callable[[], bool], limit_s: float) -> float:
        """Send a velocity set-point in external mode until the condition holds."""
        yaw_rad = self.own.yaw_rad

        def work() -> None:
            self.link.command(Request.EXTERNAL, self.now_s)
            assert self.link.send_setpoint(Setpoint(velocity_enu_m_s, yaw_rad), self.now_s), "refused"

        return self._run(step, work, done, limit_s)

    def fly_for(self, step: str, velocity_enu_m_s: Vec3, time_s: float) -> None:
        """Send a velocity set-point for ``time_s``."""
        until_s = self.vehicle_s + time_s
        self.fly(step, velocity_enu_m_s, lambda: self.vehicle_s >= until_s, time_s + 1.0)

    def listen(self, step: str, done: Callable[[], bool], limit_s: float) -> float:
        """Send nothing, as after the loss of the companion, until the condition holds."""
        return self._run(step, lambda: None, done, limit_s, silent=True)

    def rise(self, step: str, done: Callable[[], bool], limit_s: float) -> float:
        """Request the take-off until the condition holds; send set-points if the autopilot needs them."""
        yaw_rad = self.own.yaw_rad

        def work() -> None:
            self.link.command(Request.TAKEOFF, self.now_s)
            profile = self.link.state.profile
            if profile is not None and profile.stream_in_takeoff:
                up = Setpoint((0.0, 0.0, CLIMB_M_S), yaw_rad)
                assert self.link.send_setpoint(up, self.now_s), "refused"

        return self._run(step, work, done, limit_s)

    def take_off(self) -> None:
        enough_m = 0.8 * self._room.takeoff_height_m
        self.rise("take off", lambda: self.height_m > enough_m, 40.0)
        self.fly("hand over", ZERO, lambda: self.status.mode is Mode.EXTERNAL, 10.0)

    def bring_down(self) -> None:
        """Land at the current position; if the landing does not end, stop the motors close to the ground."""
        began_s = self.now_s

        def work() -> None:
            stuck = self.now_s - began_s > KILL_AFTER_S and self.height_m < LOW_M
            self.link.command(Request.MOTORS_OFF if stuck else Request.LAND, self.now_s)

        self._run("bring down", work, lambda: not self.status.armed, DOWN_MAX_S, fenced=False)

    def _run(
        self, step: str, work: Callable[[], None], done: Callable[[], bool], limit_s: float, *,
        silent: bool = False, fenced: bool = True,
    ) -> float:  # fmt: skip
        began_s, began_wall_s = None, self.now_s
        while True:
            self.now_s = self._pacer.wait().now_s
            self.link.poll(self.now_s)
            took_s = self.now_s - began_wall_s
            if self.link.state.own is not None:
                began_s = self.vehicle_s if began_s is None else began_s
                took_s = max(self.vehicle_s - began_s, took_s / WALL_FACTOR)
            self.texts += [text for _, text in self.link.take_texts()]
            if self.start_enu_m is not None:
                self.max_height_m = max(self.max_height_m, self.height_m)
            if done():
                return took_s
            why = self._trouble(took_s, limit_s) if fenced else None
            if why is None and not fenced and took_s > limit_s:
                raise AssertionError(f"{step}: not done within {limit_s:g} s; {self.texts[-5:]}")
            if why is not None:
                if self.start_enu_m is not None and not silent and self.status.armed:
                    self.bring_down()
                raise AssertionError(f"{step}: {why}; the vehicle said {self.texts[-5:]}")
            work()
            if not silent:
                self.link.flush()

    def _trouble(self, took_s: float, limit_s: float) -> str | None:
        if took_s > limit_s:
            return f"not done within {limit_s:g} s ({self.link.failed or 'nothing refused'})"
        if self.start_enu_m is None:
            return None
        if self.link.failed:
            return self.link.failed
        if self.now_s - self.own.arrival_s > STATE_AGE_MAX_S:
            return "no own state"
        if self.now_s - self.status.arrival_s > HEARTBEAT_AGE_MAX_S:
            return "no heartbeat"
        x, y, _ = (a - b for a, b in zip(self.own.position_enu_m, self.start_enu_m, strict=True))
        fence = self._room.fence
        if self.height_m > fence.height_m:
            return f"{self.height_m:.2f} m high, {fence.height_m:g} m allowed"
        if math.hypot(x, y) > fence.distance_m:
            return f"{math.hypot(x, y):.2f} m away, {fence.distance_m:g} m allowed"
        return None
