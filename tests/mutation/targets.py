"""The safety core: each source file, and the fast tests that guard it."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]
UNIT = "tests/unit"

TARGETS: dict[str, tuple[str, ...]] = {
    "flightstack.core.safety.barrier": (f"{UNIT}/core/test_barrier.py",),
    "flightstack.core.safety.robust_barrier": (f"{UNIT}/core/test_robust_barrier.py",),
    "flightstack.core.safety.qp_filter": (f"{UNIT}/core/test_safety_filter.py",),
    "flightstack.core.safety.projection": (f"{UNIT}/core/test_safety_filter.py",),
    "flightstack.core.safety.gate": (f"{UNIT}/core/test_gate.py", f"{UNIT}/core/test_gate_maker.py"),
    "flightstack.core.mission.phases": (
        f"{UNIT}/core/mission/test_phases_exhaustive.py",
        f"{UNIT}/core/mission/test_phases.py",
    ),
}


def source_file(module: str) -> Path:
    """Where the module's source is."""
    return ROOT / (module.replace(".", "/") + ".py")
