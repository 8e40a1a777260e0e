"""Campaign landings as a multiple of real time on one core, and where the time goes."""

import cProfile
import pstats
import statistics
import sys
import time
from pathlib import Path

from flightstack.pacing import quiet_garbage_collector
from sim.landing import land
from sim.scenario import load
from sim.vehicle import warm_up

LANDINGS = 8
# function to share: its own time and that of all it calls; the first one that a function is below counts
SHARES = {
    ("flight.py", "fly"): "physics and firmware, compiled",
    ("vehicle.py", "advance"): "physics, events in Python",
    ("controller.py", "step"): "controller with its filter",
    ("landing_target.py", "take"): "robot",
    ("autopilot.py", "telemetry"): "autopilot, telemetry",
    ("autopilot.py", "handle"): "autopilot, commands",
    ("autopilot_flight.py", "control"): "autopilot, flying",
    ("vehicle.py", "truth"): "true states",
    ("vehicle.py", "poll"): "companion's link in",
    ("exchange.py", "answer"): "companion's link out",
    ("landing_wire.py", "send"): "wire",
    ("verdict_truth.py", "judge_truth"): "judging",
}


def shares(profile: cProfile.Profile) -> dict[str, float]:
    """Time in each of the parts above, s; parts inside of others are taken out of these."""
    stats = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    found = dict.fromkeys(SHARES.values(), 0.0)
    for (file, _, name), (_, _, _, total_s, callers) in stats.items():
        part = SHARES.get((Path(file).name, name))
        if part is None:
            continue
        found[part] += total_s
        for (caller_file, _, caller), values in callers.items():
            outer = SHARES.get((Path(caller_file).name, caller))
            if outer is not None:
                found[outer] -= values[3]
    return found


def main(scenario_name: str = "lab") -> None:
    """Fly, measure, print."""
    if len(sys.argv) > 1:
        scenario_name = sys.argv[1]
    scenario = load(scenario_name)
    warm_up(scenario)
    land(scenario, 0)
    quiet_garbage_collector()
    factors = []
    for seed in range(LANDINGS):
        began_s = time.process_time()
        landing = land(scenario, seed)
        factors.append(landing.simulated_s / (time.process_time() - began_s))
    print(
        f"{scenario_name}: {statistics.median(factors):.0f} x real time on one core (asked 100), "
        f"{min(factors):.0f} to {max(factors):.0f} in {LANDINGS} landings"
    )
    profile = cProfile.Profile()
    profile.enable()
    for seed in range(LANDINGS):
        land(scenario, seed)
    profile.disable()
    parts = shares(profile)
    whole_s = pstats.Stats(profile).total_tt  # type: ignore[attr-defined]
    parts["rest"] = whole_s - sum(parts.values())
    print("shares under the profiler, which makes short functions look longer than they are:")
    for name, part_s in sorted(parts.items(), key=lambda part: -part[1]):
        print(f"  {100.0 * part_s / whole_s:5.1f} %  {name}")


if __name__ == "__main__":
    main()
