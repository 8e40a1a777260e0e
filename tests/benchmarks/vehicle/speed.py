"""The simulated vehicle alone in lockstep on one core: how much faster than real time, and what limits it.

First in one process: a companion's frames come through a real loopback socket, one datagram a tick, and the
telemetry goes there. Only the vehicle's share is counted, in processor time, so that other programs disturb
little. Then the real process, see ``process_speed``.
"""

from __future__ import annotations

import gc
import statistics
import time
from collections import Counter
from contextlib import closing
from dataclasses import replace

from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.server.profile import FlightMode
from sim.autopilot.autopilot import COMPONENT_ID, SYSTEM_ID, Autopilot
from sim.scenarios.scenario import Scenario, VelocityLoop, load
from sim.vehicle.vehicle import VehicleSim, warm_up
from tests.benchmarks.vehicle import process_speed
from tests.benchmarks.vehicle.kernels import kernel_us_per_ms
from tests.benchmarks.vehicle.process_speed import ASKED, RATE_HZ, heartbeat, plan

TICK_S, TICK_MS = 1.0 / RATE_HZ, 1000 // RATE_HZ
SETTLE_TICKS = 400  # until the vehicle is in OFFBOARD, or stands
TICKS = 1500
SEEDS = range(5)
ADVANCE, IN, AUTOPILOT, MADE, OUT, TRUTH = (
    "advance", "MAVLink in: socket, checksum, decoding", "autopilot: messages, modes, set-points",
    "MAVLink out: messages made", "MAVLink out: packed, socket", "true state for the log",
)  # fmt: skip


class Meter:
    """Processor time by name; the cost of the clock itself is taken out."""

    def __init__(self) -> None:
        self.spent_ns: Counter[str] = Counter()
        laps = [time.process_time_ns() for _ in range(1001)]
        self._own_ns = (laps[-1] - laps[0]) / 1000.0
        self._last_ns = 0

    def start(self) -> None:
        """What comes now counts."""
        self._last_ns = time.process_time_ns()

    def lap(self, name: str) -> None:
        """What came since the last lap was ``name``."""
        now_ns = time.process_time_ns()
        self.spent_ns[name] += max(0, now_ns - self._last_ns - self._own_ns)
        self._last_ns = time.process_time_ns()


def run(scenario: Scenario, seed: int, flying: bool) -> tuple[Meter, VehicleSim]:
    """Fly, or stand, ``TICKS`` ticks after settling; returns what the vehicle's part cost, and it."""
    meter = Meter()
    vehicle = VehicleSim(scenario, seed)
    autopilot = Autopilot(vehicle, RATE_HZ, trim_enu_m_s=vehicle.trim_velocity_enu_m_s)
    with (
        closing(Endpoint("udpin:127.0.0.1:0", SYSTEM_ID, COMPONENT_ID)) as endpoint,
        closing(Endpoint(f"udpout:127.0.0.1:{endpoint.local_port}", 1, 191)) as companion,
    ):
        companion.send([heartbeat()])
        for tick in range(SETTLE_TICKS + TICKS):
            if tick == SETTLE_TICKS:
                meter.spent_ns.clear()
                assert not flying or autopilot.flight.mode is FlightMode.OFFBOARD, autopilot.flight.mode
            companion.send(plan(tick, flying))
            now_s = tick * TICK_S
            assert endpoint.wait(5.0)
            meter.start()
            received = endpoint.receive()
            meter.lap(IN)
            replies = []
            for r in received:
                header = r.message.get_header()
                replies += autopilot.handle(r.message, (header.srcSystem, header.srcComponent), now_s)
            autopilot.control(now_s)
            meter.lap(AUTOPILOT)
            messages = autopilot.telemetry(now_s)
            meter.lap(MADE)
            endpoint.send([*messages, *replies])
            meter.lap(OUT)
            vehicle.advance(TICK_MS)
            meter.lap(ADVANCE)
            truth = vehicle.truth()
            meter.lap(TRUTH)
            assert companion.receive()
        assert bool(truth.contacts) is not flying
    return meter, vehicle


def with_loop(loop: VelocityLoop) -> Scenario:
    """The scenario flown, with this velocity loop."""
    scenario = load("paper_moving_1")
    return replace(scenario, vehicle=replace(scenario.vehicle, velocity_loop=loop))


def table(loop: VelocityLoop, flying: bool) -> None:
    """Measure one loop and print where its time goes."""
    scenario = with_loop(loop)
    warm_up(scenario)
    runs = [run(scenario, seed, flying) for seed in SEEDS]
    factors = [TICKS * TICK_S * 1e9 / meter.spent_ns.total() for meter, _ in runs]
    us_per_ms = {
        name: statistics.median(meter.spent_ns[name] for meter, _ in runs) / TICKS / TICK_MS / 1e3
        for name in (IN, AUTOPILOT, MADE, OUT, TRUTH)
    }
    parts = kernel_us_per_ms(runs[0][1])
    whole = statistics.median(meter.spent_ns[ADVANCE] for meter, _ in runs) / TICKS / TICK_MS / 1e3
    us_per_ms |= parts | {"rest of the steps: wind, battery, judge, events": whole - sum(parts.values())}
    total = sum(us_per_ms.values())
    state = "flying" if flying else "standing"
    each = ", ".join(f"{factor:.0f}" for factor in factors)
    median = statistics.median(factors)
    print(f"{loop.value}, {state}: {median:.0f} x real time (asked {ASKED:.0f}); seeds {each}")
    for name, cost in sorted(us_per_ms.items(), key=lambda item: -item[1]):
        print(f"  {cost:6.2f} us per ms {100.0 * cost / total:5.1f} %  {name}")


def main() -> None:
    """Run and print."""
    gc.freeze()
    for flying in (True, False):
        for loop in VelocityLoop:
            table(loop, flying)
    process_speed.main()


if __name__ == "__main__":
    main()
