"""OSQP against the exact projection on 100,000 random programs: largest difference, and what each costs."""

import random
import statistics
import time

from flightstack.core.safety.projection import project
from flightstack.core.safety.qp_filter import SafetyFilter
from flightstack.core.types import FilterStatus

PROGRAMS = 100_000


def main() -> None:
    """Run and print; an assertion fails beyond 1e-6 m/s."""
    chance, solver = random.Random(1), SafetyFilter(0.7)
    worst, counts, solver_us, exact_us = 0.0, dict.fromkeys(FilterStatus, 0), [], []
    for _ in range(PROGRAMS):
        box = tuple(chance.choice((0.2, 0.5, 1.0, 2.0)) for _ in range(3))
        lower = tuple(-b for b in box)
        nominal = tuple(chance.uniform(-1, 1) * chance.choice((0.1, 1.0, 3.0)) for _ in range(3))
        gradient = (chance.uniform(-2, 2), chance.uniform(-2, 2), 1.0)
        h, dh_dt = chance.uniform(-0.5, 1.0), chance.uniform(-0.4, 0.4)
        result = solver.solve(nominal, h, gradient, dh_dt, lower, box)
        started = time.perf_counter_ns()
        exact = project(nominal, gradient, -0.7 * h - dh_dt, lower, box)
        exact_us.append((time.perf_counter_ns() - started) / 1e3)
        counts[result.status] += 1
        if result.status is FilterStatus.SOLVED:
            solver_us.append(result.solve_s * 1e6)
        assert (exact is None) == (result.status is FilterStatus.INFEASIBLE)
        if exact is not None:
            worst = max(worst, *(abs(a - b) for a, b in zip(exact, result.velocity_enu_m_s, strict=True)))
            assert all(abs(u) <= b for u, b in zip(result.velocity_enu_m_s, box, strict=True))
    assert worst < 1e-6, worst
    print(
        f"largest difference {worst:.1e} m/s (limit 1e-6); "
        + ", ".join(f"{s.name} {n}" for s, n in counts.items())
    )
    print(f"median solver {statistics.median(solver_us):.1f} us, exact {statistics.median(exact_us):.1f} us")


if __name__ == "__main__":
    main()
