"""Control step: inputs to packed set-point, microseconds, median of five rounds.

The peer in the same run is the closed form without a solver: the least that any filter could cost.
"""

import gc
import math
import statistics
import time

from bridge.frames import ned_from_enu, yaw_ned_from_enu
from bridge.mavlink.endpoint import dialect
from flightstack.common.strict_toml import from_table
from flightstack.core.controller import Controller
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.projection import project
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
)

ROUNDS, TICKS = 5, 4000
APPROACHES, STEPS_MAX, WARM_STEPS = 8, 3000, 50


def inputs(tick: int, position_enu_m: Vec3 = (1.1, 0.0, 0.76), velocity_enu_m_s: Vec3 = ZERO) -> Inputs:
    """A vehicle, and a robot that drives away from the origin."""
    t = tick * 0.01
    own = OwnState(t, t, position_enu_m, velocity_enu_m_s, 0.1)
    sample = TargetSample(t, t, "map", "target", (0.1 * t, 0.02 * t, 0.2), (0.1, 0.02, 0.0), 0.0, 0.1)
    return Inputs(own, VehicleStatus(t, True, Mode.EXTERNAL, Landed.IN_AIR, True), (sample,))


def approach(config: FlightConfig, azimuth_rad: float) -> list[float]:
    """Microseconds of each step from near the boundary to above the pad: the barrier acts in most of them."""
    controller = Controller(config)
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=191)
    p, v = (1.6 * math.cos(azimuth_rad), 1.6 * math.sin(azimuth_rad), 1.0), ZERO
    took = []
    for tick in range(STEPS_MAX):
        given = inputs(tick, p, v)
        started = time.perf_counter_ns()
        out = controller.step(given, tick * 0.01)
        if out.setpoint is not None:
            n, e, d = ned_from_enu(out.setpoint.velocity_enu_m_s)
            yaw = yaw_ned_from_enu(out.setpoint.yaw_rad)
            dialect.MAVLink_set_position_target_local_ned_message(
                tick * 10, 1, 1, 1, 2503, 0, 0, 0, n, e, d, 0, 0, 0, yaw, 0
            ).pack(mav)
        took.append((time.perf_counter_ns() - started) / 1e3)
        if out.phase is Phase.LAND:
            return took[WARM_STEPS:]
        assert out.phase in (Phase.WAIT, Phase.TAKEOFF, Phase.APPROACH), controller.memory.reason
        if out.setpoint is not None:  # flies at once what it is told
            v = out.setpoint.velocity_enu_m_s
            p = (p[0] + 0.01 * v[0], p[1] + 0.01 * v[1], p[2] + 0.01 * v[2])
    raise AssertionError(f"not above the pad after {STEPS_MAX} steps")


def one_round() -> list[float]:
    """Microseconds of each step of some approaches from all sides."""
    config = from_table(FlightConfig, {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5}})
    took: list[float] = []
    gc.collect()
    gc.disable()
    for k in range(APPROACHES):
        took += approach(config, 2.0 * math.pi * k / APPROACHES)
    gc.enable()
    return took


def closed_form() -> float:
    """Median microseconds of the exact projection alone."""
    took = []
    for k in range(TICKS):
        a = k * 0.003
        started = time.perf_counter_ns()
        project((0.1, 0.2, -0.5), (math.cos(a), math.sin(a), 1.0), 0.05, (-0.2, -0.2, -0.5), (0.2, 0.2, 0.5))
        took.append((time.perf_counter_ns() - started) / 1e3)
    return statistics.median(took)


def main() -> None:
    """Run and print."""
    one_round()
    medians, tails = [], []
    for _ in range(ROUNDS):
        took = sorted(one_round())
        medians.append(took[len(took) // 2])
        tails.append(took[int(len(took) * 0.99)])
    p50, p99 = statistics.median(medians), statistics.median(tails)
    print(f"p50 {p50:.1f} us (limit 60)   p99 {p99:.1f} us (limit 150)")
    print(f"closed form alone {closed_form():.1f} us")


if __name__ == "__main__":
    main()
