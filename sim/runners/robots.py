"""A simulated ground robot on its wires: publishes odometry and true state on Zenoh.

Keys under the name space (``cf1`` by default):

- ``target/odom``: measured odometry as the tracker would send it, ``nav_msgs/msg/Odometry`` in CDR.
- ``sim/target/truth``: true pose and twist at every tick, same type; attachment (tick, 0) as two int64.
- ``sim/target/tick``: in lockstep, after everything of a tick: (tick, samples put so far) as two int64.
- ``sim/credit`` (read): in lockstep, how far the reader is and from which tick on to drive (-1: not yet).
- ``controller/step`` (read): in real time, its phase tells when the landing begins.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

from bridge.frames import quaternion_from_yaw
from bridge.ros2.ros2_node import Ros2Publisher
from bridge.target.odometry import OdometryPublisher
from bridge.zenoh import zenoh_link
from flightstack.common.pacing import EPOCH_NS, NO_GO, PAIR, RUN_AHEAD_TICKS, Tick
from flightstack.core.types import Phase
from logs.schema.events import Severity
from logs.schema.rows import ControllerStepRow
from sim.clock import TickGrid
from sim.robot.target import TargetMeasurement
from sim.robot.target_motion import TargetMotion
from sim.runners.log import EventLog
from sim.scenarios.scenario import Scenario

_LANDING = frozenset({Phase.APPROACH, Phase.LAND, Phase.TOUCHDOWN, Phase.LANDED})


class Robot:
    """Model, odometry and publishers; the same in lockstep and in real time.

    Attributes:
        namespace: first part of its keys.
        driving: whether it has set off.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        session: zenoh_link.Session,
        namespace: str,
        rate_hz: int,
        *,
        lossless: bool,
    ) -> None:
        self.namespace, self.grid = namespace, TickGrid(rate_hz)
        self.epoch_ns = EPOCH_NS  # Unix time of tick 0
        self.samples = 0
        self._motion = TargetMotion(scenario, seed, self.grid)
        self.faults = self._motion.faults
        self.driving = self._motion.drives_at_once
        key = f"{namespace}/sim/target/truth"
        self.truth = OdometryPublisher(session, key, child_frame_id="target", lossless=lossless)
        key = f"{namespace}/target/odom"
        self.odom = OdometryPublisher(session, key, child_frame_id="target", lossless=lossless)
        self.shown: Ros2Publisher | None = None  # the same to ROS 2

    @property
    def tick(self) -> int:
        """Where it is."""
        return self._motion.tick

    def step(self) -> None:
        """Go on to the next tick."""
        self._motion.step(self.driving)

    def publish(self, sent_ns: int) -> None:
        """Publish the true state of this tick, and the samples released since the last.

        Args:
            sent_ns: time of sending, Unix time or simulated.
        """
        model = self._motion.model
        stamp_ns = self.epoch_ns + self.grid.ns(self.tick)
        payload = self.truth.encode(
            stamp_ns,
            model.pose.position_enu_m,
            quaternion_from_yaw(model.pose.yaw_rad),
            model.velocity_body_m_s,
            (0.0, 0.0, model.yaw_rate_rad_s),
        )
        self.truth.put(payload, sent_ns, PAIR.pack(self.tick, 0))
        due, self._motion.due = self._motion.due, []
        for sample in due:
            payload = self._encode(sample)
            self.odom.put(payload, sent_ns)
            if self.shown is not None:
                self.shown.put(payload, sent_ns)
            self.samples += 1

    def _encode(self, sample: TargetMeasurement) -> bytes:
        return self.odom.encode(
            self.epoch_ns + round(sample.time_s * 1e9),
            sample.position_enu_m,
            quaternion_from_yaw(sample.yaw_rad),
            sample.velocity_body_m_s,
            (0.0, 0.0, sample.yaw_rate_rad_s),
        )


class Credit:
    """How far the reader of the odometry has come."""

    def __init__(self, session: zenoh_link.Session, namespace: str) -> None:
        self._subscriber = zenoh_link.fifo_subscriber(session, f"{namespace}/sim/credit")
        self.tick = 0  # before the first credit the run-ahead counts from the start
        self.go_tick = NO_GO

    def poll(self) -> None:
        """Take what has come; credit never goes back, and the first go-tick stands."""
        for sample in zenoh_link.drain(self._subscriber):
            data = sample.payload.to_bytes()
            if len(data) != PAIR.size:
                continue
            tick, go_tick = PAIR.unpack(data)
            self.tick = max(self.tick, tick)
            if self.go_tick == NO_GO and go_tick >= 0:
                self.go_tick = go_tick

    def covers(self, tick: int) -> bool:
        """Whether this tick may be made by now."""
        self.poll()
        return tick <= self.tick + RUN_AHEAD_TICKS


class LockstepRobot:
    """A robot with its reader's credit.

    Args:
        robot: the robot.
        log: of its events.
        session: on which it publishes.
    """

    def __init__(self, robot: Robot, log: EventLog, session: zenoh_link.Session) -> None:
        self.robot, self._log = robot, log
        self.credit = Credit(session, robot.namespace)
        self._marker = zenoh_link.blocking_publisher(session, f"{robot.namespace}/sim/target/tick")

    def matched(self) -> dict[str, Callable[[], bool]]:
        """What somebody has to read, and whether it is read."""
        return {
            "sim/target/truth (read by the vehicle)": lambda: self.robot.truth.matched,
            "target/odom (read by the onboard process)": lambda: self.robot.odom.matched,
            "sim/target/tick (read by the onboard process)": lambda: zenoh_link.is_matched(self._marker),
        }

    def publish(self) -> None:
        """Publish all of its tick, and write what there is to tell."""
        robot = self.robot
        robot.publish(robot.epoch_ns + robot.grid.ns(robot.tick))
        self._marker.put(PAIR.pack(robot.tick, robot.samples))
        log_faults(robot, self._log)

    def step(self) -> None:
        """Go on to the next tick, for which there is credit."""
        robot, tick, go_tick = self.robot, self.robot.tick + 1, self.credit.go_tick
        if NO_GO < go_tick <= tick:
            robot.faults.landing_began(robot.grid.ns(go_tick))
        if not robot.driving and NO_GO < go_tick <= tick:
            robot.driving = True
            self._report_start(tick, go_tick)
        robot.step()

    def _report_start(self, tick: int, go_tick: int) -> None:
        now_ns = self.robot.grid.ns(tick)
        self._log.event(now_ns, Severity.INFO, f"the robot drives from tick {tick} on")
        if go_tick < tick:
            text = f"the go-tick {go_tick} came when the robot was at {tick} already: not repeatable"
            self._log.event(now_ns, Severity.ERROR, text)
            print(f"target: {text}; it must lie more than {RUN_AHEAD_TICKS} ticks ahead", file=sys.stderr)

    def flush(self) -> None:
        """Send what was written."""
        self._log.feed.flush()


class RealTimeRobot:
    """A robot that sees in the controller's steps when the landing begins.

    Args:
        robot: the robot.
        log: of its events.
        session: on which it publishes.
    """

    def __init__(self, robot: Robot, log: EventLog, session: zenoh_link.Session) -> None:
        self.robot, self._log = robot, log
        self._steps = zenoh_link.ring_subscriber(session, f"{robot.namespace}/controller/step")

    def tick(self, now: Tick) -> None:
        """Drive to where it is now, and publish that."""
        robot = self.robot
        due = round(now.now_s * robot.grid.rate_hz)
        while robot.tick < due:
            robot.step()
        robot.publish(now.unix_ns)
        log_faults(robot, self._log)
        landing = (not robot.driving or robot.faults.waits_for_landing) and self._landing_began()
        if landing:
            robot.faults.landing_began(robot.grid.ns(robot.tick))
        if landing and not robot.driving:
            robot.driving = True
            self._log.event(robot.grid.ns(robot.tick), Severity.INFO, "the landing began: the robot drives")
        self._log.feed.flush()

    def _landing_began(self) -> bool:
        return any(
            (phase := phase_of(sample.payload.to_bytes())) is not None and phase in _LANDING
            for sample in zenoh_link.drain(self._steps)
        )


def log_faults(robot: Robot, log: EventLog) -> None:
    """Write which faults have begun and ended."""
    for fault in robot.faults.take_texts():
        level = Severity.WARN if fault.begins else Severity.INFO
        log.event(robot.grid.ns(robot.tick), level, str(fault))


def phase_of(payload: bytes) -> int | None:
    """Phase in a serialised ControllerStep, None if it is something else."""
    try:
        return ControllerStepRow.unpack(payload).phase
    except ValueError:
        return None
