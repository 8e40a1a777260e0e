"""The robots of a scenario without its vehicles, in real time, for vehicles of other processes."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from functools import partial

from bridge.zenoh import zenoh_link
from flightstack.common.hangup import Stop
from flightstack.common.pacing import RealTimePacer, quiet_garbage_collector, run_promptly
from flightstack.common.simulation_clock import Follower, chosen_clock
from logs.recorder.feed import Feed, FeedError
from sim.clock import TickGrid
from sim.options import TargetOptions
from sim.runners.published_robot import RealTimeRobot, robots_of
from sim.scenarios.team import TeamScenario


def target_main(team: TeamScenario, options: TargetOptions) -> int:
    """Run the robots until SIGTERM, SIGINT or ``duration_s``; print ``ready`` when they can be reached.

    Returns the exit status: 0 if ended in order, 1 after a time-out, 2 for bad input.
    """
    stop = Stop()
    try:
        with ExitStack() as stack:
            _drive(team, options, stop, stack)
    except ValueError as error:
        print(f"target: {error}", file=sys.stderr)
        return 2
    except (zenoh_link.ZenohLinkError, FeedError) as error:
        print(f"target: {error}", file=sys.stderr)
        return 1
    return 0


def _drive(team: TeamScenario, options: TargetOptions, stop: Stop, stack: ExitStack) -> None:
    clock = chosen_clock(options.speed, options.clock, Follower.TARGET, lambda: stop.is_set)
    grid = TickGrid(options.rate_hz)
    session = zenoh_link.open_session(
        options.listen, options.connect, config_file=options.zenoh_config, prompt=True
    )
    stack.callback(session.close)
    feed = Feed.connect(options.recorder, "target", lossless=False, vehicles=len(team.member))
    stack.callback(feed.close)
    make = partial(RealTimeRobot, grid, session, stop)
    robots = list(robots_of(team, options, feed, make, stack).values())
    epoch_ns = clock.unix_ns()  # now, because the set-up has taken time
    for robot in robots:
        robot.be_followed()
        robot.log.epoch_ns = epoch_ns
        robot.begin()
    stop.install()
    print("ready", flush=True)
    quiet_garbage_collector()
    run_promptly()  # a late pose counts as lost
    ticks, tick = grid.count(options.duration_s), 0
    pacer = RealTimePacer(grid.rate_hz, monotonic=clock.monotonic, sleep=clock.sleep, unix_ns=clock.unix_ns)
    while not stop.is_set and tick != ticks:
        due = round(pacer.wait().now_s * grid.rate_hz)  # after a pause the robots jump ahead
        while tick <= due and tick != ticks:
            for robot in robots:
                robot.take(tick)
            tick += 1
        feed.flush()
