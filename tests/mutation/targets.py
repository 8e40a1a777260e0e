"""The safety core: each source file, and the fast tests that guard it."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]
UNIT = "tests/unit"

TARGETS: dict[str, tuple[str, ...]] = {
    "flightstack.barrier": (f"{UNIT}/test_barrier.py",),
    "flightstack.robust_barrier": (f"{UNIT}/test_robust_barrier.py",),
    "flightstack.safety_filter": (f"{UNIT}/test_safety_filter.py",),
    "flightstack.projection": (f"{UNIT}/test_safety_filter.py",),
    "flightstack.gate": (f"{UNIT}/test_gate.py", f"{UNIT}/test_gate_maker.py"),
    "flightstack.phases": (f"{UNIT}/test_phases_exhaustive.py", f"{UNIT}/test_phases.py"),
}


def source_file(module: str) -> Path:
    """Where the module's source is."""
    return ROOT / (module.replace(".", "/") + ".py")
