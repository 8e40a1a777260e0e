"""One seeded landing in one process, noted and judged: ``land(scenario, seed)``, without sockets.

The same code as over the wires flies: the vehicle's lockstep loop with its autopilot and faults, the robot,
the companion's link and its runner of ticks. Only the wires are handed over directly, with their rounding;
so a landing equals ``flightstack sitl --lockstep`` of the same scenario and seed to the last bit.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from logs.verdict.truth import judge_truth
from logs.verdict.types import Verdict
from sim.runners.companion import Companion, OnStep
from sim.runners.notes import Seen
from sim.scenarios.scenario import Scenario


@dataclass(frozen=True)
class Landing:
    """What became of it.

    Attributes:
        seed: of all chance.
        verdict: judged from the true states, as a flight log is.
        seen: what a log of it would hold, as far as a verdict needs it.
        simulated_s: length.
        wall_s: time it took.
        retries: how often the landing was begun anew.
    """

    seed: int
    verdict: Verdict
    seen: Seen
    simulated_s: float
    wall_s: float
    retries: int


def land(scenario: Scenario, seed: int, *, on_step: OnStep | None = None) -> Landing:
    """Fly one landing and judge it.

    Args:
        scenario: everything that is not chance; its ``onboard`` part is flown.
        seed: chance.
        on_step: called after every controller step.

    Raises:
        RuntimeError: the simulation did not come to its end.
    """
    began_s = time.perf_counter()
    flight = Companion(scenario, seed, on_step)
    seen = flight.fly()
    verdict = judge_truth(seen, seen.truth)
    simulated_s = float(seen.steps.t_s[-1])
    wall_s = time.perf_counter() - began_s
    return Landing(seed, verdict, seen, simulated_s, wall_s, flight.controller.memory.retries)
