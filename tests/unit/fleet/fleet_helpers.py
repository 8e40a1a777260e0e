"""Teams that several test modules share."""

from dataclasses import fields, replace

import numpy as np

from sim.scenarios.scenario import Scenario, load

FIELD = load("field")


def at(x: float, y: float, offset=(-0.8, 0.3, 0.9), **target) -> Scenario:
    """Return a member of ``field`` with its robot at this position, m; ``offset``: vehicle minus robot, m."""
    robot = replace(FIELD.target, position_m=(x, y), **target)
    return replace(FIELD, target=robot, start=replace(FIELD.start, offset_m=offset))


def team_of(*members: Scenario) -> Scenario:
    return replace(Scenario.of(members), name="test", description="")


def same(one, other) -> bool:
    """Whether two landings are equal bit for bit, except for wall time."""
    parts = ((one.seen.truth, other.seen.truth), (one.seen.steps, other.seen.steps))
    numbers = all(
        np.array_equal(getattr(a, f.name), getattr(b, f.name), equal_nan=True)
        for a, b in parts
        for f in fields(a)
    )
    return numbers and (one.seen.events, one.verdict, one.retries, one.seed) == (
        other.seen.events, other.verdict, other.retries, other.seed,
    )  # fmt: skip
