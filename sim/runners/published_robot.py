"""The ground robot on Zenoh: its odometry, and its true pose for a vehicle of another process.

Keys under the namespace of each robot (``cf1`` by default):

- ``target/odom``: measured odometry, as from a tracker, ``nav_msgs/msg/Odometry`` in CDR.
- ``sim/target/ticks``: in lockstep, the number of samples up to each tick (docs/how_it_works/lockstep.md).
- ``sim/credit`` (read): in lockstep, tick of the onboard process, and tick from which the robot may drive.
- ``sim/target/truth``: in real time, true pose and twist for a vehicle that another process simulates.
- ``controller/step`` (read): in real time, the mission phase, which shows the start of the landing.
"""

from __future__ import annotations

import contextlib
import math
import sys
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from typing import ClassVar, TypeVar

from msgspec import msgpack

from bridge.frames import quaternion_from_yaw, world_from_body, yaw_from_quaternion
from bridge.ros2.cdr import Odometry, OdometryError, decode_odometry
from bridge.ros2.ros2_names import Ros2Node, Ros2Publisher, open_network
from bridge.target.odometry import OdometryPublisher
from bridge.target.ros2_target import ROS_TYPES, TargetType
from bridge.zenoh import zenoh_link
from flightstack.common.hangup import Stop
from flightstack.common.pacing import (
    COMPANION_SILENT_S,
    EPOCH_NS,
    NO_GO,
    RUN_AHEAD_TICKS,
    wait_until,
)
from flightstack.core.types import ZERO, Phase, Vec3
from logs.recorder.feed import Feed
from logs.schema import Names
from logs.schema.events import Severity
from logs.schema.rows import ControllerStepRow
from sim.clock import TickGrid, await_subscriber
from sim.options import TargetOptions, WorldOptions
from sim.robot import MEASURED, Deck, Sample
from sim.runners.log import EventLog
from sim.runners.robot import Robot, Ticks, deck_of, deck_rows
from sim.scenarios.scenario import Scenario
from sim.vehicle.physics import Physics

NODE = "flightstack_target"  # name of the ROS 2 node
_LANDING = frozenset({Phase.APPROACH, Phase.LAND, Phase.TOUCHDOWN, Phase.LANDED})
_LEFT_MIN = RUN_AHEAD_TICKS // 2  # number of computed future ticks below which the robot computes more


class PublishedRobot(Robot):
    """A robot that publishes its odometry when it computes a tick.

    ``session``: Zenoh session, which the caller closes; ``stop``: ends every wait; ``namespace``: prefix of
    the robot's keys; ``log``: log of the robot's events.
    """

    lockstep: ClassVar[bool]

    def __init__(
        self,
        grid: TickGrid,
        session: zenoh_link.Session,
        stop: Stop,
        scenario: Scenario,
        seed: int,
        namespace: str,
        log: EventLog,
    ) -> None:
        super().__init__(scenario, seed, grid)
        self._session, self._stop, self.namespace, self.log = session, stop, namespace, log
        self.shown: Ros2Publisher | None = None  # publisher of the odometry to ROS 2
        self._odom = OdometryPublisher(session, f"{namespace}/target/odom", lossless=self.lockstep)
        self._poses: deque[tuple[Deck, bytes]] = deque()  # true poses at the computed ticks, and messages
        self._open()

    def _open(self) -> None:
        """Declare the keys in addition to that of the odometry."""

    def take(self, tick: int) -> Deck:
        """Advance to the next tick; return the true pose there."""
        self._drive(tick)
        deck, self.payload = self._poses.popleft()
        return deck

    def _keep(self, new: Ticks) -> None:
        """Publish the samples of the next ticks."""
        epoch_ns, done, samples = self.log.epoch_ns, 0, new.samples.tolist()
        decks, poses = deck_rows(new.pads).tolist(), new.pads[:, MEASURED].tolist()
        ticks = zip(new.come.tolist(), decks, poses, strict=True)
        for tick, (come, deck, pose) in enumerate(ticks, self.tick + 1 - len(decks)):
            now_ns = epoch_ns + self._grid.ns(tick)
            for sample in samples[done:come]:
                payload = odometry(epoch_ns + round(sample[0] * 1e9), sample[1:])
                self._odom.put(payload, now_ns)
                if self.shown is not None:
                    self.shown.put(payload, now_ns)
            self._poses.append((deck_of(deck), odometry(now_ns, pose)))
            done = come

    def _say(self, tick: int, level: Severity, text: str) -> None:
        self.log.event(self._grid.ns(tick), level, text)


def odometry(stamp_ns: int, values: Sample) -> bytes:
    """Return the message with a position, m, heading, velocity in the body frame, m/s, and turn rate."""
    x, y, z, yaw, vx, vy, vz, rate = values
    q = quaternion_from_yaw(yaw)
    return Odometry(stamp_ns, "map", "target", (x, y, z), q, (vx, vy, vz), (0.0, 0.0, rate)).pack()


class LockstepRobot(PublishedRobot):
    """A robot that computes its motion for future ticks, as far as the companion's credit allows."""

    lockstep = True

    def _open(self) -> None:
        self._ticks = zenoh_link.blocking_publisher(self._session, f"{self.namespace}/sim/target/ticks")
        self._credits = zenoh_link.fifo_subscriber(self._session, f"{self.namespace}/sim/credit")
        self._credit = self._published = 0  # newest tick announced by the companion; published samples
        self._silent = False  # whether the wait for credit timed out

    def begin(self) -> None:
        """Wait for subscribers, then publish tick 0; samples without a subscriber are lost.

        Raises NoAnswerError: time-out.
        """
        await_subscriber(lambda: self._odom.matched, f"{self.namespace}/target/odom", self._stop)
        ticks, key = self._ticks, f"{self.namespace}/sim/target/ticks"
        await_subscriber(lambda: zenoh_link.is_matched(ticks), key, self._stop)
        super().begin()

    def await_credit(self, tick: int) -> None:
        """Wait for the companion's credit; after a time-out, do not wait again.

        Only this credit shows whether the landing has started before this tick.
        """
        if tick > self.tick and not self._silent:
            stop, most_s = self._stop, COMPANION_SILENT_S
            self._silent = not wait_until(lambda: self._limit() >= tick, lambda: stop.is_set, most_s)
            if self._silent:
                waited = f"no credit from the onboard process for {most_s:g} s"
                self._say(tick, Severity.WARN, f"{waited}: the robot continues without")

    def run_ahead(self, tick: int) -> None:
        """Compute future ticks while the companion computes, so that the companion need not wait later."""
        if self.tick < tick + _LEFT_MIN:
            self._drive(min(tick + RUN_AHEAD_TICKS, self._limit()))

    def _limit(self) -> int:
        """Return the last tick for which the received credit shows whether the robot drives."""
        for sample in zenoh_link.drain(self._credits):
            reached, go_tick = msgpack.decode(sample.payload.to_bytes(), type=tuple[int, int])
            self._credit, self._silent = max(self._credit, reached), False
            if self._go_tick == NO_GO:
                self._go_tick = go_tick
        decided = not self.waits or self._go_tick > NO_GO
        return sys.maxsize if decided else self._credit + RUN_AHEAD_TICKS

    def _keep(self, new: Ticks) -> None:
        super()._keep(new)
        first, counts = self.tick + 1 - len(new.pads), self._published + new.come
        self._published += len(new.samples)
        self._ticks.put(msgpack.encode((first, counts.tolist())))


class RealTimeRobot(PublishedRobot):
    """A robot that detects the start of the landing in the published controller steps."""

    lockstep = False

    def _open(self) -> None:
        self._truth = OdometryPublisher(self._session, truth_key(self.namespace))
        self._steps = zenoh_link.ring_subscriber(self._session, f"{self.namespace}/controller/step")

    def take(self, tick: int) -> Deck:
        """Advance to the next tick; return the true pose there, and publish it for other processes."""
        deck = super().take(tick)
        self._truth.put(self.payload, self.log.epoch_ns + self._grid.ns(tick))
        if self.waits and self._go_tick == NO_GO and self._landing_began():
            self._go_tick = tick
        return deck

    def _landing_began(self) -> bool:
        for sample in zenoh_link.drain(self._steps):
            with contextlib.suppress(ValueError):  # ignore a payload that is not a ControllerStep
                if ControllerStepRow.unpack(sample.payload.to_bytes()).phase in _LANDING:
                    return True
        return False


R = TypeVar("R", bound=PublishedRobot)


def robots_of(
    team: Scenario,
    options: TargetOptions | WorldOptions,
    feed: Feed,
    make: Callable[[Scenario, int, str, EventLog], R],
    stack: ExitStack,
) -> dict[int, R]:
    """Create the robots of a scenario, by number; ``options`` may also publish their odometry to ROS 2.

    ``make``: class of the robots with their common arguments; ``stack``: closes the ROS 2 session.
    """
    shared, robots = team.target_seed(options.seed), {}
    for number, (scenario, seed) in enumerate(team.singles(options.seed), 1):
        namespace = team.namespaces(options.namespace)[number]
        log = EventLog(feed, Names(namespace, number).logger("target"), EPOCH_NS)
        robots[number] = make(scenario, seed if shared is None else shared, namespace, log)
    if options.ros2_where is None:
        return robots
    session = open_network(options.ros2_where, options.ros_domain)
    stack.callback(session.close)
    node = Ros2Node(session, NODE, domain=options.ros_domain, namespace=f"/{options.namespace}")
    for number, namespace in team.namespaces(options.namespace).items():
        robots[number].shown = node.publisher(f"/{namespace}/target/odom", *ROS_TYPES[TargetType.ODOMETRY])
    return robots


STALE_S = 0.5  # age of the newest true pose after which the deck stops, s
_PULL_1_S = 5.0  # correcting velocity divided by position error, 1/s; a jump would throw off the vehicle
_SNAP_M = 0.3  # position error above which the deck jumps, m; timing cannot cause a larger error


def deck_state(payload: bytes) -> Deck:
    """Decode a true pose. Raises OdometryError: malformed message, or a number is not finite."""
    found = decode_odometry(payload)
    position, q, velocity, rate = (
        found.position_m, found.orientation_wxyz, found.linear_m_s, found.angular_rad_s[2]
    )  # fmt: skip
    if not math.isfinite(sum((*position, *q, *velocity, rate))):
        raise OdometryError("true pose of the robot holds a number that is not finite")
    return Deck(position, yaw_from_quaternion(q), world_from_body(q, velocity), rate)


class RealTimeDeck:
    """A deck that follows received true poses: a smooth correction is added to the last received twist."""

    def __init__(self, session: zenoh_link.Session, namespace: str) -> None:
        self._subscriber = zenoh_link.ring_subscriber(session, truth_key(namespace))
        self._last_s = math.inf  # arrival time of the newest pose, s; infinite: none yet, or deck stopped

    def move(
        self, vehicle: Physics, now_s: float, log: Callable[[bytes], None], warn: Callable[[str], None]
    ) -> None:
        """Read new poses and set the motion of the vehicle's deck, which lasts until the next pose.

        ``log``: called with each message.
        """
        payloads = [sample.payload.to_bytes() for sample in zenoh_link.drain(self._subscriber)]
        for payload in payloads:
            log(payload)
        for payload in reversed(payloads):
            with contextlib.suppress(OdometryError):
                vehicle.set_deck(*follow(deck_state(payload), *vehicle.deck_pose))
                self._last_s = now_s
                return
        if now_s - self._last_s > STALE_S:
            self._last_s = math.inf
            vehicle.set_deck(*vehicle.deck_pose, ZERO, 0.0)
            warn("Robot's pose too old: deck stopped")


def follow(robot: Deck, position_enu_m: Vec3, yaw_rad: float) -> Deck:
    """Return the state to set for the simulated deck, so that the deck follows the robot.

    The velocity of this state reduces the position error. If the error is large, the state is ``robot``.

    ``robot``: the newest true pose; ``position_enu_m``, ``yaw_rad``: pose of the simulated deck.
    """
    (x, y, z), (rx, ry, rz) = position_enu_m, robot.position_enu_m
    ex, ey, ez = rx - x, ry - y, rz - z
    if math.hypot(ex, ey, ez) > _SNAP_M:
        return robot
    vx, vy, vz = robot.velocity_enu_m_s
    pulled = (vx + _PULL_1_S * ex, vy + _PULL_1_S * ey, vz + _PULL_1_S * ez)
    turn = _PULL_1_S * math.remainder(robot.yaw_rad - yaw_rad, math.tau)
    return Deck(position_enu_m, yaw_rad, pulled, robot.yaw_rate_rad_s + turn)


def truth_key(namespace: str) -> str:
    """Return the Zenoh key of the robot's true pose."""
    return f"{namespace}/sim/target/truth"
