"""Runs benchmarks. Numbers go to standard output; ``make bench`` runs those of ``BENCH``.

``python -m tests.benchmarks NAME [ARGUMENTS]`` runs one alone. NAME is the module's path below this folder,
with ``_`` between its parts: ``campaign_speed``, ``vehicle_figures``, ``px4_faults``.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

HERE = Path(__file__).parent
BENCH = (
    "campaign_speed",
    "codec",
    "control_step",
    "fuzz_vehicle",
    "lockstep",
    "loop_period",
    "qp_agreement",
    "vehicle_speed",
)


def modules() -> dict[str, str]:
    """Benchmark name -> dotted module, for every module below this folder that has a ``main``."""
    parts = [path.relative_to(HERE).with_suffix("").parts for path in sorted(HERE.rglob("[!_]*.py"))]
    return {
        "_".join(one): ".".join(("tests.benchmarks", *one))
        for one in parts
        if "def main(" in HERE.joinpath(*one).with_suffix(".py").read_text()
    }


def run(name: str) -> None:
    """Run the benchmark of this name; an unknown one ends with the list of those that exist."""
    known = modules()
    if name not in known:
        sys.exit(f"no benchmark is named {name!r}; choose one of {', '.join(known)}")
    import_module(known[name]).main()


if __name__ == "__main__":
    if len(sys.argv) > 1:
        run(sys.argv.pop(1))
        sys.exit()
    for each in BENCH:
        about = (import_module(modules()[each]).__doc__ or "").splitlines()[0]
        print(f"\n== {each}: {about}", flush=True)
        run(each)
