"""The ground robots of a team, mostly one, as a process: they drive in lockstep, or in real time.

With ``--ros2`` the samples go to the ROS 2 topic ``/cf1/target/odom`` as well.

Keys under the namespace of each robot (``cf1`` by default):

- ``target/odom``: measured odometry as the tracker would send it, ``nav_msgs/msg/Odometry`` in CDR.
- ``sim/target/truth``: true pose and twist at every tick, same type; attachment (tick, 0) as two int64.
- ``sim/target/tick``: in lockstep, after everything of a tick: (tick, samples put so far) as two int64.
- ``sim/credit`` (read): in lockstep, how far the reader is and from which tick on to drive (-1: not yet).
- ``controller/step`` (read): in real time, its phase shows when the landing begins.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial

from bridge.frames import quaternion_from_yaw
from bridge.ros2.ros2_names import Ros2Network, network
from bridge.ros2.ros2_node import Ros2Node, Ros2Publisher
from bridge.target.odometry import OdometryPublisher
from bridge.target.ros2_target import ROS_TYPES, TargetType
from bridge.zenoh import zenoh_link
from flightstack.common.hangup import Stop
from flightstack.common.pacing import (
    EPOCH_NS,
    NO_GO,
    PAIR,
    RUN_AHEAD_TICKS,
    RealTimePacer,
    Tick,
    quiet_garbage_collector,
    run_promptly,
)
from flightstack.common.simulation_clock import Clock, Follower, chosen_clock
from flightstack.core.types import Phase
from flightstack.onboard.lockstep import ALIVE
from logs.recorder.feed import Feed, FeedError
from logs.schema.events import Severity
from logs.schema.names import Names
from logs.schema.rows import ControllerStepRow
from sim.clock import STARTUP_S, NoAnswerError, TickGrid, wait_until
from sim.options import TargetOptions
from sim.robot.target import TargetMeasurement
from sim.robot.target_motion import TargetMotion
from sim.runners.log import EventLog
from sim.scenarios.scenario import Scenario
from sim.scenarios.team import TeamScenario

_LANDING = frozenset({Phase.APPROACH, Phase.LAND, Phase.TOUCHDOWN, Phase.LANDED})
_CREDIT_PAUSE_S = 0.002  # s between two looks for credit; far less than the run-ahead lasts
_MATCH_PAUSE_S = 0.002  # s between two looks for subscribers
NAME = "target"  # name of the process in the log
NODE = "flightstack_target"  # name of the ROS 2 node


class Robot:
    """Model, odometry and publishers; the same in lockstep and in real time."""

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
        self.namespace, self.grid = namespace, TickGrid(rate_hz)  # namespace: first part of its keys
        self.epoch_ns = EPOCH_NS  # Unix time of tick 0
        self.samples = 0
        self._motion = TargetMotion(scenario, seed, self.grid)
        self.faults = self._motion.faults
        self.driving = self._motion.drives_at_once  # whether the robot drives
        key = f"{namespace}/sim/target/truth"
        self.truth = OdometryPublisher(session, key, child_frame_id="target", lossless=lossless)
        key = f"{namespace}/target/odom"
        self.odom = OdometryPublisher(session, key, child_frame_id="target", lossless=lossless)
        self.shown: Ros2Publisher | None = None  # publisher of the odometry to ROS 2

    @property
    def tick(self) -> int:
        """Where it is."""
        return self._motion.tick

    def step(self) -> None:
        """Go on to the next tick."""
        self._motion.step(self.driving)

    def publish(self, sent_ns: int) -> None:
        """Publish the true state of this tick, and the samples released since the last.

        ``sent_ns``: time of sending, Unix time or simulated.
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
    """A robot with its reader's credit. ``log``: of its events; ``session``: on which it publishes."""

    def __init__(self, robot: Robot, log: EventLog, session: zenoh_link.Session) -> None:
        self.robot, self._log = robot, log
        self.credit = Credit(session, robot.namespace)
        self._marker = zenoh_link.blocking_publisher(session, f"{robot.namespace}/sim/target/tick")
        self._token = zenoh_link.liveliness_token(session, f"{robot.namespace}/{ALIVE}")

    def matched(self) -> dict[str, Callable[[], bool]]:
        """Keys that need a subscriber, and whether each has one."""
        return {
            "sim/target/truth (read by the vehicle)": lambda: self.robot.truth.matched,
            "target/odom (read by the onboard process)": lambda: self.robot.odom.matched,
            "sim/target/tick (read by the onboard process)": lambda: zenoh_link.is_matched(self._marker),
        }

    def publish(self) -> None:
        """Publish the data of its tick, and log its faults."""
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

    ``log``: of its events; ``session``: on which it publishes.
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


def target_main(team: TeamScenario, options: TargetOptions) -> int:
    """Run the robots until SIGTERM, SIGINT or ``duration_s``; prints ``ready`` when they can be reached.

    Returns exit status: 0 in order, 1 when something it needs did not come, 2 for wrong input.
    """
    lockstep = options.lockstep
    stop = Stop()
    try:
        paced = chosen_clock(
            options.speed, options.clock, Follower.TARGET, lambda: stop.is_set, lockstep=lockstep
        )
        if not team.is_alone and options.ros2_where is not None:
            raise ValueError("--ros2 is for one robot: those of a team are not shown to ROS 2")
        with ExitStack() as stack:
            session = zenoh_link.open_session(
                options.listen,
                options.connect,
                config_file=options.zenoh_config,
                prompt=not lockstep,
                lockstep=lockstep,
            )
            stack.callback(session.close)
            flights = list(_flights(team, options))
            robots = [
                Robot(
                    one, seed, session, names.member or options.namespace, options.rate_hz, lossless=lockstep
                )
                for one, seed, names in flights
            ]
            if (ros2 := network(options)) is not None:
                robots[0].shown = _shown(ros2, options.namespace, stack)
            epoch_ns = EPOCH_NS if lockstep else paced.unix_ns()  # once all that takes time is done
            feed = Feed.connect(options.recorder, NAME, lossless=lockstep, vehicles=len(robots))
            stack.callback(feed.close)
            logs = [EventLog(feed, names.logger(NAME), epoch_ns) for _, _, names in flights]
            for robot in robots:
                robot.epoch_ns = epoch_ns
            ticks = robots[0].grid.count(options.duration_s)
            both = list(zip(robots, logs, strict=True))
            if lockstep:
                _Lockstep([LockstepRobot(robot, log, session) for robot, log in both], stop).run(ticks)
            else:
                _RealTime([RealTimeRobot(robot, log, session) for robot, log in both], stop).run(ticks, paced)
    except ValueError as error:
        print(f"target: {error}", file=sys.stderr)
        return 2
    except (zenoh_link.ZenohLinkError, FeedError, NoAnswerError) as error:
        print(f"target: {error}", file=sys.stderr)
        return 1
    return 0


def _flights(team: TeamScenario, options: TargetOptions) -> Iterator[tuple[Scenario, int, Names]]:
    """Scenario, seed, and names in the log, of each robot."""
    shared = team.target_seed(options.seed)
    for number, (single, seed) in enumerate(team.singles(options.seed), 1):
        yield single, seed if shared is None else shared, team.names(number)


def _shown(ros2: Ros2Network, namespace: str, stack: ExitStack) -> Ros2Publisher:
    """The robot as a ROS 2 node, on a session of its own, that publishes its odometry."""
    session = ros2.open()
    stack.callback(session.close)
    node = Ros2Node(session, NODE, domain=ros2.domain, namespace=f"/{namespace}")
    stack.callback(node.close)
    return node.publisher(f"/{namespace}/target/odom", *ROS_TYPES[TargetType.ODOMETRY])


class _Lockstep:
    """Ticks as fast as the readers' credit allows."""

    def __init__(self, robots: Sequence[LockstepRobot], stop: Stop) -> None:
        self._robots, self._stop = robots, stop
        self._stop.install()
        print("ready", flush=True)

    def run(self, ticks: int | None) -> None:
        """Drive until the end. Raises NoAnswerError: no subscribers, or no credit."""
        robots = self._robots
        self._await_subscribers()
        quiet_garbage_collector()
        while not self._stop.is_set:
            for each in robots:
                each.publish()
            robots[0].flush()  # they share a feed
            tick = robots[0].robot.tick + 1
            if tick == ticks or not self._await_credit(tick):
                return
            for each in robots:
                each.step()

    def _await_subscribers(self) -> None:
        # What is put before a subscriber is known is lost, and a lost tick would never be made up for.
        for each in self._robots:
            for what, is_matched in each.matched().items():
                key = f"{each.robot.namespace}/{what}"
                if not wait_until(
                    is_matched, self._stop, STARTUP_S, pause_s=_MATCH_PAUSE_S, what=f"a subscriber to {key}"
                ):
                    raise NoAnswerError(
                        f"nobody subscribed to {key} within {STARTUP_S:g} s; is it "
                        "running, and connected to this process's endpoint?"
                    )

    def _await_credit(self, tick: int) -> bool:
        """True when the tick may be made, False when the process is to end."""
        for each in self._robots:
            if not wait_until(
                partial(each.credit.covers, tick), self._stop, STARTUP_S, pause_s=_CREDIT_PAUSE_S
            ):
                raise NoAnswerError(
                    f"no credit for tick {tick} on {each.robot.namespace}/sim/credit for {STARTUP_S:g} s: "
                    "the onboard process has stopped, or does not run in lockstep"
                )
        return not self._stop.is_set


class _RealTime:
    """Ticks by a clock; after a pause the robots are where they would have been."""

    def __init__(self, robots: Sequence[RealTimeRobot], stop: Stop) -> None:
        self._robots, self._stop = robots, stop
        self._stop.install()
        print("ready", flush=True)

    def run(self, ticks: int | None, clock: Clock) -> None:
        """Drive until the end."""
        first = self._robots[0].robot
        quiet_garbage_collector()
        run_promptly()  # a pose that comes late counts as lost
        pacer = RealTimePacer(
            first.grid.rate_hz, monotonic=clock.monotonic, sleep=clock.sleep, unix_ns=clock.unix_ns
        )
        while not self._stop.is_set:
            now = pacer.wait()
            for each in self._robots:
                each.tick(now)
            if ticks is not None and first.tick + 1 >= ticks:
                return
