"""Land the simulated Crazyflie on a moving robot in this process, and print phases and verdict.

python examples/landing.py [SCENARIO_NAME_OR_FILE [SEED [PLOT.html]]]
"""

import sys

import flightstack as fs

scenario = sys.argv[1] if len(sys.argv) > 1 else "lab"
seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
landing = fs.land(scenario, seed)
for phase, begin_s, end_s in landing.flight.phase_spans():
    print(f"{begin_s:6.2f} to {end_s:6.2f} s  {phase.name}")
verdict = landing.verdict
print(f"{verdict.outcome}: {verdict.reason}")
if verdict.h_min_outside_pad_m is not None:
    print(f"lowest h outside the pad: {1000.0 * verdict.h_min_outside_pad_m:+.0f} mm (below 0 is unsafe)")
if len(sys.argv) > 3:
    landing.plot().write_html(sys.argv[3])  # draws the flown path and the boundary of the barrier
