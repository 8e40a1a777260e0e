"""Command line: all mutants, a sample of them, one of them, or the branch coverage."""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tests.mutation.mutants import ROOT, TARGETS, Mutant, mutants, source_file

SCORE_MIN = 0.9
USUAL_MAX_S = 10.0  # of one module's tests, where it is not measured


def _warm() -> None:
    """Imports that every child would pay for; none of the modules that mutants stand in for."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy: a fork and threads do not go together
    import hypothesis  # noqa: F401
    import numpy as np  # noqa: F401
    import osqp  # noqa: F401
    import scipy.linalg
    import scipy.sparse  # noqa: F401
    from osqp import ext_builtin  # noqa: F401

    assert not any(module in sys.modules for module in TARGETS)


def _all(modules: list[str]) -> list[tuple[str, Mutant]]:
    return [(m, mutant) for m in modules for mutant in mutants(source_file(m).read_text())]


def _modules(asked: list[str] | None) -> list[str]:
    names = [name if name.startswith("flightstack.") else f"flightstack.{name}" for name in asked or TARGETS]
    unknown = [name for name in names if name not in TARGETS]
    if unknown:
        raise SystemExit(f"found {unknown}, allowed are {', '.join(TARGETS)}")
    return names


def full(arguments: argparse.Namespace) -> int:
    """Every mutant; writes the table when all modules were asked for."""
    _warm()
    from tests.mutation import report, run

    modules, results = _modules(arguments.module), []
    for module in modules:
        usual_s, started_s = run.baseline(module), time.monotonic()
        asked = ((m, mutant, usual_s) for m, mutant in _all([module]))
        results += run.run(arguments.jobs, asked)
        print(report.tally(module, [r for r in results if r.module == module]), flush=True)
        print(f"  {time.monotonic() - started_s:.0f} s; the tests alone {usual_s:.1f} s", flush=True)
    told = report.surprises(results)
    if modules == list(TARGETS):
        told += report.stale(results)
        report.write(results)
    print("\n".join([report.table(results), *told]))
    score = report.tally("all", results).score
    return int(score < SCORE_MIN or any(not t.startswith("survived") for t in told))


def sample(arguments: argparse.Namespace) -> int:
    """Mutants by chance until the time is over; none may survive but those that are listed.

    That the tests pass without a mutant is not checked here: it is what the test suite does.
    """
    _warm()
    from tests.mutation import report, run

    end_s = time.monotonic() + arguments.seconds
    chance = random.Random(arguments.seed)

    def asked() -> Iterator[tuple[str, Mutant, float]]:
        """The modules in turn, so that a short sample has some of each."""
        piles, count = {m: _all([m]) for m in TARGETS}, 0
        for pile in piles.values():
            chance.shuffle(pile)
        while any(piles.values()):
            for pile in piles.values():
                if count >= arguments.least and time.monotonic() > end_s:
                    return
                if pile:
                    count += 1
                    yield *pile.pop(), USUAL_MAX_S

    results = list(run.run(arguments.jobs, asked()))
    told = report.surprises(results)
    print("\n".join([report.table(results), *told]))
    return int(bool(told))


def show(arguments: argparse.Namespace) -> int:
    """List mutants, or print the changed source of one."""
    (module,) = _modules([arguments.name])
    source = source_file(module).read_text()
    if arguments.number is None:
        print("\n".join(f"{m.number:4d} line {m.line:3d}  {m.key}" for m in mutants(source)))
        return 0
    from tests.mutation.mutants import changed_tree

    print(ast.unparse(changed_tree(source, arguments.number)))
    return 0


class Covered(NamedTuple):
    """One module's coverage."""

    per_cent: float
    missing_lines: list[int]
    missing_branches: list[list[int]]  # from line, to line; negative: out of the function


def measure() -> tuple[int, dict[str, Covered]]:
    """Run the tests once, in this process, which must not have imported the core before.

    Returns:
        pytest's exit code, and the coverage of each module.
    """
    import coverage
    import pytest

    from tests.mutation.run import FewExamples

    files = sorted({file for tests in TARGETS.values() for file in tests})
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "coverage.json"
        watch = coverage.Coverage(
            data_file=str(Path(folder) / "coverage"),
            branch=True,
            include=[str(source_file(module)) for module in TARGETS],
            config_file=False,
        )
        watch.start()
        options = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-o", "addopts=--import-mode=importlib"]
        exit_code = pytest.main(
            [*options, f"--rootdir={ROOT}", *(str(ROOT / file) for file in files)], [FewExamples()]
        )
        watch.stop()
        watch.json_report(outfile=str(report))
        measured = {Path(name).name: m for name, m in json.loads(report.read_text())["files"].items()}
    found = {}
    for module in TARGETS:
        m = measured[source_file(module).name]
        found[module] = Covered(m["summary"]["percent_covered"], m["missing_lines"], m["missing_branches"])
    return int(exit_code), found


def covered(_: argparse.Namespace) -> int:
    """Branch coverage; every branch of every module has to be taken."""
    exit_code, found = measure()
    for module, c in found.items():
        missing = f"  lines {c.missing_lines}, branches {c.missing_branches}" if c.per_cent < 100.0 else ""
        print(f"{module:32s} {c.per_cent:6.2f} %{missing}")
    return exit_code or int(any(c.per_cent < 100.0 for c in found.values()))


def main() -> int:
    """Exit code 0: the tests notice what they must."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.set_defaults(call=full, module=None, jobs=os.cpu_count() or 1)
    parser.add_argument("--jobs", type=int, help="mutants at a time")
    parser.add_argument("--module", action="append", help="only this module; may be repeated")
    verbs = parser.add_subparsers()
    one = verbs.add_parser("sample", help=sample.__doc__)
    one.add_argument("--seed", type=int, default=1)
    one.add_argument("--seconds", type=float, default=30.0, help="no new mutant after that")
    one.add_argument("--least", type=int, default=10, help="but so many at least")
    one.set_defaults(call=sample)
    one = verbs.add_parser("show", help=show.__doc__)
    one.add_argument("name")
    one.add_argument("number", type=int, nargs="?")
    one.set_defaults(call=show)
    verbs.add_parser("coverage", help=covered.__doc__).set_defaults(call=covered)
    arguments = parser.parse_args()
    return int(arguments.call(arguments))


if __name__ == "__main__":
    sys.exit(main())
