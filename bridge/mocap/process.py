"""Process of the mocap bridge: receives poses from Zenoh, sends them to a MAVLink vehicle.

The profile of the vehicle's autopilot selects the message: ODOMETRY or VISION_POSITION_ESTIMATE.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import euler_from_quaternion, ned_covariance_from_enu, ned_frd_from_enu_flu, ned_from_enu
from bridge.mavlink.client.companion import Origin, OriginSender, companion_heartbeat
from bridge.mavlink.client.senders import Senders
from bridge.mavlink.codec.messages import Message
from bridge.mavlink.endpoint import Endpoint, open_endpoint
from bridge.mavlink.profiles import Profile, found, refusal
from bridge.mocap.checks import Limits, MocapOptions, Passed, PoseChecks, PoseOptions
from bridge.ros2.cdr import OdometryError, Pose
from bridge.target.ros2_target import KeySearch, TargetSpec, TargetType
from bridge.zenoh import zenoh_link
from flightstack.common.hangup import Stop
from flightstack.common.pacing import run_promptly
from flightstack.core.parameters.flight import check_origin

SAY_S = 2.0  # time between two texts on the same topic, s
CAPACITY = 256  # maximum number of samples between two polls; the oldest are dropped


class MocapSource:
    """Receives the poses of motion capture from Zenoh and checks each of them."""

    def __init__(
        self, session: zenoh_link.Session, spec: TargetSpec, checks: PoseChecks, where: Sequence[str] = ()
    ) -> None:
        """``where``: Zenoh endpoints, for the text about missing poses."""
        self._subscriber = zenoh_link.ring_subscriber(session, spec.key, CAPACITY)
        self._spec, self.checks = spec, checks
        at = f" at {', '.join(where)}" if where else ""
        self._search, self._waits = KeySearch(session), f"mocap: no pose on {spec.text}{at} yet"
        self._arrived = False  # whether a sample has arrived since the start
        self.problem: str | None = self._waits  # reason why there is no good pose, or None
        self._unreadable: str | None = None  # reason why the newest sample is unreadable, or None

    @classmethod
    @contextmanager
    def opened(cls, key: str, options: PoseOptions, rate_max_hz: float = 100.0) -> Iterator[MocapSource]:
        """Open a session for the poses on a key, and close it at the end. Raises ValueError: bad key."""
        spec = TargetSpec.parse(key, TargetType(options.pose_type), options.ros_domain, options.offset_flu_m)
        limits = Limits(options.frame_id, rate_max_hz=rate_max_hz, speed_max_m_s=options.pose_speed_m_s)
        with closing(
            zenoh_link.open_session(
                options.listen, options.connect, config_file=options.zenoh_config, prompt=True
            )
        ) as session:
            yield cls(session, spec, PoseChecks(limits), options.connect or options.listen)

    def poll(self, now_s: float, *, armed: bool) -> tuple[Passed, ...]:
        """Return the good poses since the last call, oldest first; never blocks."""
        poses = [self._pose(sample) for sample in zenoh_link.drain(self._subscriber)]
        passed, self.problem = self.checks.step(poses, now_s, armed=armed), self.checks.problem(now_s)
        self._arrived = self._arrived or bool(poses)
        if self._arrived or armed:
            # the search stops before flight, because a search receives all poses and odometry
            self._search.stop()
        if not self._arrived:
            keys = () if armed else self._search.keys()
            self.problem = self._waits + (f"; there are {', '.join(keys)}" if keys else "")
        if self.problem is not None and self._unreadable is not None:
            self.problem = f"mocap: {self._unreadable}"
        return passed

    def _pose(self, sample: zenoh_link.Sample) -> Pose | None:
        self._unreadable = None
        try:
            self._spec.check_key(str(sample.key_expr))
            return self._spec.pose(sample.payload.to_bytes())
        except OdometryError as error:
            self._unreadable = str(error)
            return None


COMPONENT_ID = dialect.MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY
RATE_MAX_HZ = 50.0  # maximum rate of poses for PX4 and ArduPilot, Hz
SILENT_S = 3.0  # time without a heartbeat after which the vehicle counts as absent, s
_HEARTBEAT_S = 1.0
_HELLO_S = 0.2  # time between heartbeats before the first message of the vehicle, s
_UNKNOWN = (math.nan, *([0.0] * 20))  # unknown covariance: its first entry is NaN (MAVLink)


def _covariance(covariance: tuple[float, ...]) -> list[float]:
    known = any(covariance)  # in ROS a covariance of zeros is unknown
    return ned_covariance_from_enu(covariance) if known else list(_UNKNOWN)


def vision_position_estimate(passed: Passed, time_us: int) -> Message:
    """Build VISION_POSITION_ESTIMATE: position in NED; roll, pitch and yaw of FRD in NED."""
    pose = passed.pose
    return dialect.MAVLink_vision_position_estimate_message(
        time_us,
        *ned_from_enu(pose.position_m),
        *euler_from_quaternion(ned_frd_from_enu_flu(pose.orientation_wxyz)),
        _covariance(pose.covariance),
        passed.resets % 256,
    )


def odometry(passed: Passed, time_us: int) -> Message:
    """Build ODOMETRY of type VISION: pose of FRD in NED as a quaternion; velocities are unknown."""
    pose = passed.pose
    return dialect.MAVLink_odometry_message(
        time_us,
        dialect.MAV_FRAME_LOCAL_NED,
        dialect.MAV_FRAME_BODY_FRD,
        *ned_from_enu(pose.position_m),
        list(ned_frd_from_enu_flu(pose.orientation_wxyz)),
        *([math.nan] * 6),
        _covariance(pose.covariance),
        list(_UNKNOWN),
        passed.resets % 256,
        dialect.MAV_ESTIMATOR_TYPE_VISION,
    )


POSES: Mapping[int, Callable[[Passed, int], Message]] = {  # by message id
    dialect.MAVLINK_MSG_ID_ODOMETRY: odometry,
    dialect.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE: vision_position_estimate,
}


class MocapVehicle:
    """Sends poses to a vehicle: call ``handle`` for each of its messages, then ``step``."""

    def __init__(self, system_id: int, origin: Origin | None) -> None:
        """``origin``: position of the room's origin on earth, for an autopilot that needs this position."""
        self.profile: Profile | None = (
            None  # profile of the vehicle's autopilot; None: unknown or unsupported
        )
        self._origin, self._origin_sender = origin, OriginSender(origin, system_id)
        self._autopilot = -1  # MAV_AUTOPILOT number of the newest heartbeat; -1: no heartbeat yet
        self._origin_known = self._armed = False
        self._heard_s = self._beat_s = -math.inf

    def problem(self, now_s: float, url: str) -> str | None:
        """Return the reason why the vehicle does not use the poses, or None."""
        if not self.heard(now_s):
            return f"no message from the vehicle at {url}"
        if self.profile is None:
            return refusal(self._autopilot, dialect.MAV_TYPE_QUADROTOR, None)
        if self.profile.needs_origin and self._origin is None and not self._origin_known:
            return "this vehicle has no position without an origin: give --origin LAT LON ALT"
        return None

    def heard(self, now_s: float) -> bool:
        return now_s - self._heard_s <= SILENT_S

    def flies(self, now_s: float) -> bool:
        """Whether the vehicle is armed and sends heartbeats, so that it needs the poses."""
        return self._armed and self.heard(now_s)

    def handle(self, message: Message, now_s: float) -> list[Message]:
        """Handle a message of the vehicle's autopilot; return the reply."""
        id_ = message.get_msgId()
        if id_ == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            self._armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
            if message.autopilot != self._autopilot or not self.heard(now_s):  # may be another vehicle
                self._autopilot, self._origin_known = message.autopilot, False
                self.profile = found(message.autopilot)
                self._origin_sender.restart()
            self._heard_s = now_s
        elif id_ == dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN:
            self._origin_known = True
        elif id_ == dialect.MAVLINK_MSG_ID_TIMESYNC and message.tc1 == 0:
            # PX4 uses our time stamps once these replies have synchronised the clocks (Timesync.cpp)
            return [dialect.MAVLink_timesync_message(max(1, round(now_s * 1e9)), message.ts1)]
        return []

    def step(self, poses: Sequence[Passed], now_s: float) -> list[Message]:
        """Return the messages to send now; without a supported vehicle the poses are dropped."""
        messages: list[Message] = []
        if now_s - self._beat_s >= (_HEARTBEAT_S if self.heard(now_s) else _HELLO_S) - 1e-9:
            self._beat_s = now_s
            messages.append(companion_heartbeat())
        profile = self.profile
        if profile is None or not self.heard(now_s):
            return messages
        messages += [POSES[profile.pose_message](p, round(p.measured_s * 1e6)) for p in poses]
        lacks_origin = profile.needs_origin and not (self._armed or self._origin_known)
        return messages + self._origin_sender.step(lacks_origin, now_s)


TICK_S = 0.002  # maximum delay that the loop adds to a pose, s


class Bridge:
    def __init__(
        self, source: MocapSource, endpoint: Endpoint, options: MocapOptions, say: Callable[[str], None]
    ) -> None:
        self._source, self._endpoint, self._options, self._say = source, endpoint, options, say
        self._vehicle = MocapVehicle(options.system_id, Origin(*options.origin) if options.origin else None)
        self._senders = Senders()
        self._told: dict[str, tuple[str | None, float]] = {}  # last text and its time, s, by topic
        self._start_s = time.monotonic()

    def run(self, stop: Stop, duration_s: float | None) -> None:
        """Run until a signal or ``duration_s``; with an armed vehicle, until disarm or a second signal."""
        told = False
        while stop.count < 2:
            now_s = self._turn()
            if stop.count or (duration_s is not None and now_s >= duration_s):
                if not self._vehicle.flies(now_s):
                    return
                if not told:
                    self._say("mocap: the vehicle is armed: ends when it is disarmed, or on a second signal")
                    told = True

    def _turn(self) -> float:
        """Wait for a tick or a message, then forward the poses; return the time, s."""
        self._endpoint.wait(TICK_S)
        for notice in (*self._endpoint.take_notices(), *self._senders.take_notices()):
            self._say(f"mocap: {notice}")
        now_s, vehicle, options = time.monotonic() - self._start_s, self._vehicle, self._options
        for received in self._endpoint.receive():
            message, peer = received.message, received.peer
            ours = received.sender == (options.system_id, dialect.MAV_COMP_ID_AUTOPILOT1)
            if ours and self._senders.admits(message, peer, now_s, armed=vehicle.flies(now_s)):
                self._endpoint.send(vehicle.handle(message, now_s), peer)
        passed = self._source.poll(now_s, armed=vehicle.flies(now_s))
        self._endpoint.send(vehicle.step(passed, now_s))
        self._tell("poses", self._source.problem, now_s, good="mocap: poses are good")
        problem, profile = vehicle.problem(now_s, options.vehicle_url), vehicle.profile
        good = f"mocap: {profile.name} receives poses, needs {profile.pose_settings}" if profile else ""
        self._tell("vehicle", f"mocap: {problem}" if problem else None, now_s, good=good)
        return now_s

    def _tell(self, topic: str, text: str | None, now_s: float, *, good: str) -> None:
        """Print a problem when it begins and at most every two seconds; print ``good`` when it ends."""
        before, said_s = self._told.get(topic, (None, 0.0))
        if (text is None) == (before is None) and (text is None or now_s - said_s < SAY_S):
            return
        self._told[topic] = (text, now_s)
        self._say(good if text is None else text)


def run(options: MocapOptions, say: Callable[[str], None] = print) -> int:
    """Run until a signal arrives; with an armed vehicle, until disarm or a second signal."""
    if options.origin is not None:
        check_origin("--origin", options.origin)
    with ExitStack() as stack:
        endpoint = open_endpoint("mocap", options.vehicle_url, options.system_id, COMPONENT_ID, options)
        stack.callback(endpoint.close)
        source = stack.enter_context(MocapSource.opened(options.pose_key, options, RATE_MAX_HZ))
        bridge = Bridge(source, endpoint, options, say)
        run_promptly()  # request a high priority: a delayed pose is useless
        stop = Stop().install()
        say("ready")
        sys.stdout.flush()
        bridge.run(stop, options.duration_s)
    say(summary(source.checks))
    return 0


def summary(checks: PoseChecks) -> str:
    refused = ", ".join(f"{reason.name.lower()} {n}" for reason, n in checks.counts.items() if n)
    passed = f"{checks.passed} poses passed on, {checks.thinned} omitted to limit the rate"
    return f"mocap: {passed}; refused: {refused or 'none'}"
