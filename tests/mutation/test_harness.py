"""The mutation harness itself, a sample of mutants, and the branch coverage of the safety core."""

import ast
import json
import subprocess
import sys
import textwrap

import pytest

from tests.mutation.mutants import ROOT, TARGETS, changed_tree, mutants, source_file
from tests.mutation.report import EQUIVALENT

SOURCE = textwrap.dedent('''
    """Text 1 < 2 stays."""
    LIMIT: float = 2.0

    @check(3)
    def f(x: int, on: bool = True) -> float:
        """Stays."""
        if x < 3 and not on:
            return -x * 2 if x >= 1 else min(x, LIMIT)
        x += 1
        return None
''')


def python(*arguments, timeout_s=600.0):
    return subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=timeout_s, check=False
    )  # fmt: skip


def test_each_kind_of_change_is_made_once_where_code_runs():
    found = {m.key for m in mutants(SOURCE)}
    assert found == {
        "module: constant: 2.0 -> 2.2", "module: constant: 2.0 -> 0.0",
        "f: constant: True -> False",
        "f: negation: if x < 3 and (not on): -> if not (x < 3 and (not on)):",
        "f: boolean: x < 3 and (not on) -> x < 3 or not on",
        "f: boundary: x < 3 -> x <= 3", "f: comparison: x < 3 -> x >= 3",
        "f: constant: 3 -> 4", "f: constant: 3 -> 2",
        "f: negation: not on -> on",
        "f: return: return -x * 2 if x >= 1 else min(x, LIMIT) -> return None",
        "f: negation: -x * 2 if x >= 1 else min(x, LIMIT) -> -x * 2 if not x >= 1 else min(x, LIMIT)",
        "f: boundary: x >= 1 -> x > 1", "f: comparison: x >= 1 -> x < 1",
        "f: constant: 1 -> 2", "f: constant: 1 -> 0",
        "f: arithmetic: -x * 2 -> -x / 2", "f: negation: -x -> x",
        "f: constant: 2 -> 3", "f: constant: 2 -> 1",
        "f: extreme: min(x, LIMIT) -> max(x, LIMIT)",
        "f: arithmetic: x += 1 -> x -= 1",
        "f: constant: 1 -> 2 #2", "f: constant: 1 -> 0 #2",
    }  # fmt: skip


@pytest.mark.parametrize("module", TARGETS)
def test_every_mutant_is_another_program(module):
    source = source_file(module).read_text()
    found = mutants(source)
    assert len(found) > 50
    assert len({m.key for m in found}) == len(found)
    assert [m.number for m in found] == list(range(len(found)))
    original = ast.dump(ast.parse(source))
    texts = {ast.unparse(changed_tree(source, m.number)) for m in found[::7]}
    assert len(texts) == len(found[::7])
    assert all(ast.dump(changed_tree(source, m.number)) != original for m in found[::7])
    with pytest.raises(IndexError, match="asked for number"):
        changed_tree(source, len(found))


def test_every_equivalent_mutant_exists():
    for entry in EQUIVALENT:
        keys = [m.key for m in mutants(source_file(entry.module).read_text())]
        assert any(entry.names(entry.module, key) for key in keys), entry
        assert entry.reason


OUTCOMES = """
import json, os, sys, time
from tests.mutation import run
from tests.mutation.mutants import Mutant

def stub(module, number):
    if number == 2:
        while True:
            time.sleep(0.1)
    if number == 4:
        raise RuntimeError("broken")
    if number == 5:
        os.abort()
    return {0: 0, 1: 1, 3: 2, 6: 3, 7: run.NOT_LOADED}[number]

run.judge, run.TIMEOUT_LEAST_S = stub, 1.0
asked = [("any", Mutant(n, 1, "kind", "key"), 0.0) for n in range(8)]
found = {r.mutant.number: r.outcome.name for r in run.run(3, asked)}
print(json.dumps(found))
"""


def test_outcomes_are_told_apart():
    """Passed, failed, endless, no import, raised, died, pytest broke, mutant never loaded."""
    done = python("-c", OUTCOMES)
    assert done.returncode == 0, done.stderr
    infra = "INFRA_ERROR"
    assert json.loads(done.stdout) == {
        "0": "SURVIVED", "1": "KILLED", "2": "TIMEOUT", "3": "KILLED", "4": infra, "5": infra, "6": infra,
        "7": infra,
    }  # fmt: skip


REAL = """
from tests.mutation import run
from tests.mutation.mutants import mutants
from tests.mutation.mutants import source_file

module = "flightstack.core.safety.gate"
keys = ("Gate._keeps_promise: return: return False -> return None", "Gate.stop: constant: 0.0 -> 1.0")
chosen = [m for m in mutants(source_file(module).read_text()) if m.key in keys]
usual_s = run.baseline(module)
print(sorted(r.outcome.name for r in run.run(2, [(module, m, usual_s) for m in chosen])))
"""


def test_a_change_without_effect_survives_and_another_is_killed():
    done = python("-c", REAL)
    assert done.stdout.splitlines()[-1] == "['KILLED', 'SURVIVED']", done.stdout + done.stderr


def test_a_sample_of_mutants_is_noticed():
    done = python("-m", "tests.mutation", "--jobs", "2", "sample", "--seed", "1", "--seconds", "10")
    assert done.returncode == 0, done.stdout + done.stderr
    assert all(f"| {module.removeprefix('flightstack.')} |" in done.stdout for module in TARGETS)


def test_every_branch_of_the_safety_core_is_taken():
    done = python("-m", "tests.mutation", "coverage")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("100.00 %") == len(TARGETS)


def test_an_unknown_module_is_refused_with_those_there_are():
    done = python("-m", "tests.mutation", "show", "gates")
    assert done.returncode != 0
    assert "found ['flightstack.gates']" in done.stderr
    assert "flightstack.core.safety.gate" in done.stderr
