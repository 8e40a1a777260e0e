"""The ground robot, or those of a team, as a process: drives in lockstep, or in real time.

What it publishes stands in ``robots``. With ``--ros2`` the samples go to the ROS 2 topic ``/cf1/target/odom``
as well. The robots of a team have a name space each: ``cf1``, ``cf2`` and so on.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from functools import partial

from bridge.ros2.ros2_names import Ros2Network, network
from bridge.ros2.ros2_node import Ros2Node, Ros2Publisher
from bridge.target.ros2_target import ROS_TYPES, TargetType
from bridge.zenoh import zenoh_link
from flightstack.common.hangup import Stop
from flightstack.common.pacing import (
    EPOCH_NS,
    RealTimePacer,
    quiet_garbage_collector,
    run_promptly,
)
from flightstack.common.simulation_clock import Clock, Follower, chosen_clock
from logs.recorder.feed import Feed, FeedError
from logs.schema.names import OWN, Names, member_name
from sim.clock import STARTUP_S, NoAnswerError, wait_until
from sim.runners.log import EventLog
from sim.runners.options import TargetOptions
from sim.runners.robots import LockstepRobot, RealTimeRobot, Robot
from sim.scenarios.scenario import Scenario
from sim.scenarios.team import AnyScenario, TeamScenario

_CREDIT_PAUSE_S = 0.002  # s between two looks for credit; far less than the run-ahead lasts
_MATCH_PAUSE_S = 0.002  # s between two looks for subscribers
NAME = "target"  # of the process, in the log
NODE = "flightstack_target"  # name of the ROS 2 node


def target_main(scenario: AnyScenario, options: TargetOptions) -> int:
    """Run the robots until SIGTERM, SIGINT or ``duration_s``; prints ``ready`` when they can be reached.

    Returns:
        Exit status: 0 in order, 1 when something it needs did not come, 2 for wrong input.
    """
    lockstep = options.lockstep
    stop = Stop()
    try:
        paced = chosen_clock(
            options.speed, options.clock, Follower.TARGET, lambda: stop.is_set, lockstep=lockstep
        )
        if isinstance(scenario, TeamScenario) and options.ros2_where is not None:
            raise ValueError("--ros2 is for one robot: those of a team are not shown to ROS 2")
        with ExitStack() as stack:
            session = zenoh_link.open_session(
                options.listen, options.connect, config_file=options.zenoh_config, prompt=not lockstep
            )
            stack.callback(session.close)
            flights = list(_flights(scenario, options))
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


def _flights(scenario: AnyScenario, options: TargetOptions) -> Iterator[tuple[Scenario, int, Names]]:
    """Scenario, seed, and names in the log, of each robot."""
    if not isinstance(scenario, TeamScenario):
        yield scenario, options.seed, OWN
        return
    shared = scenario.target_seed(options.seed)
    for number, (single, seed) in enumerate(scenario.singles(options.seed), 1):
        yield single, seed if shared is None else shared, Names(member_name(number), number)


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
        """Drive until the end.

        Raises:
            NoAnswerError: no subscribers, or no credit.
        """
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
