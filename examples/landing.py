"""Land the simulated Crazyflie on a moving robot, in this process, and print how it went.

python examples/landing.py [SCENARIO_NAME_OR_FILE [SEED]]
"""

import sys

from flightstack.common.pacing import Tick
from flightstack.core.controller import Outputs
from sim.runners.landing import land
from sim.scenarios.scenario import load

phases = []


def on_step(tick: Tick, outputs: Outputs) -> None:
    """Print each new phase; called after every controller step."""
    if not phases or outputs.phase is not phases[-1]:
        phases.append(outputs.phase)
        print(f"{tick.now_s:6.2f} s  {outputs.phase.name}")


scenario = load(sys.argv[1] if len(sys.argv) > 1 else "lab")
seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
verdict = land(scenario, seed, on_step=on_step).verdict
print(f"{verdict.outcome}: {verdict.reason}")
if verdict.h_min_outside_pad_m is not None:
    print(f"lowest h outside the pad: {1000.0 * verdict.h_min_outside_pad_m:+.0f} mm (below 0 is unsafe)")
