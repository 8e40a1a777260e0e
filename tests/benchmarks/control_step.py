"""Control step: inputs to packed set-point, microseconds, median of five rounds.

The peer in the same run is the closed form without a solver: the least that any filter could cost.
"""

import gc
import math
import statistics
import time

from bridge.frames import ned_from_enu, yaw_ned_from_enu
from bridge.mavlink import dialect
from flightstack.config import FlightConfig
from flightstack.controller import Controller
from flightstack.projection import project
from flightstack.strict_toml import from_table
from flightstack.types import Inputs, Landed, Mode, OwnState, Phase, TargetSample, VehicleStatus

ROUNDS, TICKS = 5, 4000


def inputs(tick: int) -> Inputs:
    """A vehicle that circles on the boundary, where the barrier acts in each tick."""
    t, a = tick * 0.01, tick * 0.003
    p = (1.1 * math.cos(a), 1.1 * math.sin(a), 0.2 + 0.56)
    own = OwnState(t, t, p, (0.0, 0.1, 0.0), 0.1)
    sample = TargetSample(t, t, "map", "target", (0.0, 0.0, 0.2), (0.1, 0.02, 0.0), 0.0, 0.1)
    return Inputs(own, VehicleStatus(t, True, Mode.EXTERNAL, Landed.IN_AIR, True), (sample,))


def one_round() -> list[float]:
    """Microseconds of each step."""
    config = from_table(FlightConfig, {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5}})
    controller = Controller(config)
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=191)
    prepared = [inputs(k) for k in range(TICKS)]
    took = []
    gc.collect()
    gc.disable()
    for tick, given in enumerate(prepared):
        started = time.perf_counter_ns()
        out = controller.step(given, tick * 0.01)
        if out.setpoint is not None:
            n, e, d = ned_from_enu(out.setpoint.velocity_enu_m_s)
            yaw = yaw_ned_from_enu(out.setpoint.yaw_rad)
            dialect.MAVLink_set_position_target_local_ned_message(
                tick * 10, 1, 1, 1, 2503, 0, 0, 0, n, e, d, 0, 0, 0, yaw, 0
            ).pack(mav)
        took.append((time.perf_counter_ns() - started) / 1e3)
    gc.enable()
    assert controller.memory.phase is Phase.APPROACH
    return took[100:]


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
