"""Measures the speed of a control step, a lockstep run, a campaign and the environment.

``paper_runs`` flies the paper's four runs for docs/reference/paper_runs.md.
"""

from __future__ import annotations

import gc
import math
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.companion import velocity_setpoint
from bridge.mavlink.client.link import COMPONENT_ID
from flightstack.common.pacing import quiet_garbage_collector
from flightstack.common.strict_toml import from_table
from flightstack.compiled.core import compiled
from flightstack.core.controller import Controller
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.types import (
    ZERO,
    Inputs,
    Landed,
    Mode,
    OwnState,
    Phase,
    TargetSample,
    Vec3,
    VehicleStatus,
)  # fmt: skip
from sim.runners.landing import land, warm_up
from sim.scenarios.scenario import Scenario, load
from tests.integration.runs import flightstack

ROUNDS = 5
COMPANION = dialect.MAVLink(None, 1, COMPONENT_ID)
APPROACHES, STEPS_MAX, WARM_STEPS = 8, 3000, 50


def inputs(tick: int, position_enu_m: Vec3 = (1.1, 0.0, 0.76), velocity_enu_m_s: Vec3 = ZERO) -> Inputs:
    """Return inputs with the state of a vehicle and of a robot that drives away from the origin."""
    t = tick * 0.01
    own = OwnState(t, t, position_enu_m, velocity_enu_m_s, 0.1)
    sample = TargetSample(t, t, "map", "target", (0.1 * t, 0.02 * t, 0.2), (0.1, 0.02, 0.0), 0.0, 0.1)
    return Inputs(own, VehicleStatus(t, True, Mode.EXTERNAL, Landed.IN_AIR, True), (sample,))


def approach(controller: Controller, azimuth_rad: float) -> list[float]:
    """Fly from near the boundary to above the pad; return the durations of the steps after warm-up, us."""
    p, v = (1.6 * math.cos(azimuth_rad), 1.6 * math.sin(azimuth_rad), 1.0), ZERO
    took = []
    for tick in range(STEPS_MAX):
        given = inputs(tick, p, v)
        started = time.perf_counter_ns()
        out = controller.step(given, tick * 0.01)
        if out.setpoint is not None:
            velocity_setpoint(out.setpoint, (1, 1), tick * 0.01).pack(COMPANION)
        took.append((time.perf_counter_ns() - started) / 1e3)
        if out.phase is Phase.LAND:
            return took[WARM_STEPS:]
        assert out.phase in (Phase.WAIT, Phase.TAKEOFF, Phase.APPROACH), controller.memory.reason
        if out.setpoint is not None:
            # the vehicle follows every set-point without delay
            v = out.setpoint.velocity_enu_m_s
            p = (p[0] + 0.01 * v[0], p[1] + 0.01 * v[1], p[2] + 0.01 * v[2])
    raise AssertionError(f"not above the pad after {STEPS_MAX} steps")


def one_round(make: Callable[[FlightConfig], Controller]) -> list[float]:
    """Return the durations of the steps of approaches from ``APPROACHES`` directions, us."""
    config = from_table(FlightConfig, {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5}})
    took: list[float] = []
    gc.collect()
    gc.disable()
    for k in range(APPROACHES):
        took += approach(make(config), 2.0 * math.pi * k / APPROACHES)
    gc.enable()
    return took


def control_step() -> None:
    """Print the time from inputs to set-point, us, of interpreted and of compiled code."""
    for name, make, asked in (("plain", Controller, (68, 144)), ("compiled", compiled, (20, 60))):
        one_round(make)
        medians, tails = [], []
        for _ in range(ROUNDS):
            took = sorted(one_round(make))
            medians.append(took[len(took) // 2])
            tails.append(took[int(len(took) * 0.99)])
        p50, p99 = statistics.median(medians), statistics.median(tails)
        print(f"{name:8}  p50 {p50:.1f} us (asked {asked[0]})   p99 {p99:.1f} us (asked {asked[1]})")


def sitl(folder: str | Path, scenario: str, seed: int = 0, *more: str) -> dict:
    """Run ``flightstack sitl`` once; return its JSON result."""
    words = ["sitl", "--json", "--no-report", "--out", folder, "--scenario", scenario, "--seed", seed, *more]
    done = flightstack(*words)
    return done.json


def lockstep() -> None:
    """Print the speed of whole recorded lockstep runs over MAVLink and Zenoh as a multiple of real time."""
    factors = []
    for seed in range(3):
        with tempfile.TemporaryDirectory() as folder:
            factors.append(sitl(folder, "paper_moving_1", seed, "--lockstep")["realtime_factor"])
    runs = ", ".join(f"{f:.1f}" for f in factors)
    print(f"{statistics.median(factors):.1f} x real time (asked 30); runs {runs}")


CRAZYFLOW = """
import time
import gymnasium, numpy as np
import crazyflow.envs
for worlds in (1, 64, 1024):
    env = gymnasium.make_vec("DroneReachVel-v0", num_envs=worlds, freq=100)
    env.reset(seed=1)
    action = np.zeros(env.action_space.shape, np.float32)
    env.step(action)  # compiles
    steps, began_s, cpu_s = 200 if worlds < 1000 else 40, time.perf_counter(), time.process_time()
    for _ in range(steps):
        np.asarray(env.step(action)[1])
    wall_s, cpu_s = time.perf_counter() - began_s, time.process_time() - cpu_s
    rates = [steps * worlds / took_s for took_s in (cpu_s, wall_s)]
    print("crazyflow, {} worlds: {:,.0f} steps/s of CPU time, {:,.0f} of wall time".format(worlds, *rates))
"""


def environment() -> None:
    """Print steps per second of the Gymnasium environment, of Pendulum-v1 and, if requested, of crazyflow.

    Argument: path of a Python interpreter with crazyflow installed; steps of crazyflow are 0.01 s long, too.
    """
    import gymnasium

    import flightstack as fs

    def flown(env: Any, seeds: range, act: Callable[[], Any]) -> float:
        steps, began_s = 0, time.process_time()
        for seed in seeds:
            env.reset(seed=seed)
            over = False
            while not over:
                _, _, terminated, truncated, _ = env.step(act())
                steps, over = steps + 1, terminated or truncated
        return steps / (time.process_time() - began_s)

    for name in (None, "paper", "robust"):
        env = fs.make_env("lab", filter=name)
        flown(env, range(2), env.builtin_action)
        rates = [flown(env, range(seed, seed + 8), env.builtin_action) for seed in (2, 10, 18)]
        print(f"landing, filter {name}: {statistics.median(rates):,.0f} steps/s of CPU time")
    pendulum = gymnasium.make("Pendulum-v1")
    print(f"Pendulum-v1: {flown(pendulum, range(20), pendulum.action_space.sample):,.0f} steps/s of CPU time")
    for python in sys.argv[1:]:
        subprocess.run([python, "-W", "ignore", "-c", CRAZYFLOW], check=True, timeout=600)


PAPER_RUNS = ("paper_static_1", "paper_static_2", "paper_moving_1", "paper_moving_2")


def paper_row(scenario: str, seeds: int, filter_name: str) -> str:
    runs = []
    for seed in range(seeds):
        with tempfile.TemporaryDirectory() as folder:
            runs.append(sitl(folder, scenario, seed, "--lockstep", "--filter", filter_name))
    landed = sum(run["outcome"] == "landed" for run in runs)
    violations = sum(run["violation"] is not False for run in runs)  # an unknown result counts as a violation
    median = {
        key: statistics.median(run[key] for run in runs if run[key] is not None)
        for key in ("touchdown_error_m", "touchdown_speed_vertical_m_s", "time_to_land_s")
    }
    lowest, outside = (1e3 * min(run[k] for run in runs) for k in ("h_min_m", "h_min_outside_pad_m"))
    return (
        f"| `{scenario}` | {landed} of {seeds} | {violations} | {outside:+.1f} mm | {lowest:+.0f} mm "
        f"| {1e3 * median['touchdown_error_m']:.0f} mm | {median['touchdown_speed_vertical_m_s']:.2f} m/s "
        f"| {median['time_to_land_s']:.1f} s |"
    )


def paper_runs() -> None:
    """Fly the paper's four runs for docs/reference/paper_runs.md; arguments: [SEEDS [FILTER ...]]."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    for filter_name in sys.argv[2:] or ("paper", "robust"):
        print(f"filter {filter_name}")
        for scenario in PAPER_RUNS:
            print(paper_row(scenario, seeds, filter_name), flush=True)


def flown_s(scenario: Scenario, seed: int) -> float:
    """Fly a landing or a team; return the sum of the simulated times of its vehicles, s."""
    return sum(each.simulated_s for each in land(scenario, seed).members)


def campaign_speed(scenario_name: str = "lab") -> None:
    """Print the speed of campaign flights; arguments: scenario, and filter instead of the scenario's."""
    if len(sys.argv) > 1:
        scenario_name = sys.argv[1]
    scenario = load(scenario_name)
    if len(sys.argv) > 2:
        scenario = scenario.with_filter(sys.argv[2])
        scenario_name += f", {sys.argv[2]}"
    warm_up(scenario)
    flown_s(scenario, 0)
    quiet_garbage_collector()
    factors, spent = [], []
    for seed in range(APPROACHES):
        began_s = time.process_time()
        simulated_s = flown_s(scenario, seed)
        spent.append(time.process_time() - began_s)
        factors.append(simulated_s / spent[-1])
        gc.collect()
    print(
        f"{scenario_name}: {statistics.median(factors):.0f} x real time on one core (asked 300), "
        f"{min(factors):.0f} to {max(factors):.0f} in {APPROACHES} flights of one seed, vehicle by vehicle; "
        f"{statistics.median(spent):.3f} s of processor time a flight"
    )
