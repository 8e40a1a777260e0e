"""Runs mutants side by side, each in a fork of a process that has the slow imports behind it."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import os
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from types import CodeType, ModuleType

import hypothesis
import pytest

from tests.mutation.mutants import ROOT, TARGETS, Mutant, mutated, source_file

NOT_LOADED = 100  # exit code: the tests never imported the mutant
EXAMPLES = 60  # of each property; the same ones every time


class Replaced(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Loads one module from other code."""

    def __init__(self, module: str, code: CodeType) -> None:
        self.module, self.code, self.loaded = module, code, False

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname != self.module:
            return None
        return importlib.machinery.ModuleSpec(fullname, self, origin=self.code.co_filename)

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = self.code.co_filename
        self.loaded = True
        exec(self.code, module.__dict__)


class FewExamples:
    """Settings of property tests, after those of the test suite and before any test file is read."""

    def pytest_collection(self) -> None:
        hypothesis.settings.register_profile(
            "mutation",
            derandomize=True,
            database=None,
            deadline=None,
            max_examples=EXAMPLES,
            phases=(hypothesis.Phase.explicit, hypothesis.Phase.generate),
        )
        hypothesis.settings.load_profile("mutation")


def judge(module: str, number: int | None) -> int:
    """Run the module's tests against its mutant; ``None``: against the module as it is.

    Returns:
        pytest's exit code, or ``NOT_LOADED``.
    """
    os.chdir(ROOT)
    source, name = source_file(module).read_text(), str(source_file(module))
    code = compile(source, name, "exec") if number is None else mutated(source, number, name)
    replaced = Replaced(module, code)
    sys.meta_path.insert(0, replaced)
    options = [
        "-x",
        "-q",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
        "-o",
        "addopts=--import-mode=importlib",
    ]
    exit_code = pytest.main([*options, *TARGETS[module]], plugins=[FewExamples()])
    return int(exit_code) if replaced.loaded else NOT_LOADED


FAILED, INTERRUPTED = 1, 2  # pytest's exit codes: a test failed; a test file could not be imported
TIMEOUT_FACTOR, TIMEOUT_LEAST_S = 8.0, 20.0  # of the unchanged module's time; machines are shared
POLL_S = 0.01


class Outcome(Enum):
    """What became of a mutant."""

    KILLED = "killed"  # a test failed, or the module could not even be imported
    SURVIVED = "survived"
    TIMEOUT = "timeout"  # endless or far too slow: noticed as well
    INFRA_ERROR = "infra error"  # says nothing about the tests


@dataclass(frozen=True)
class Result:
    """One mutant's end."""

    module: str
    mutant: Mutant
    outcome: Outcome
    seconds: float
    text: str  # what pytest said, for infra errors


@dataclass
class _Running:
    pid: int
    module: str
    mutant: Mutant | None
    started_s: float
    log: Path


OUTCOMES = {0: Outcome.SURVIVED, FAILED: Outcome.KILLED, INTERRUPTED: Outcome.KILLED}


def _start(module: str, mutant: Mutant | None, folder: Path) -> _Running:
    log = folder / f"{module}-{mutant.number if mutant else 'as it is'}.txt"
    pid = os.fork()
    if pid:
        return _Running(pid, module, mutant, time.monotonic(), log)
    try:
        os.setsid()  # so that whatever a mutant starts can be ended with it
        out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(out, 1)
        os.dup2(out, 2)
        code = judge(module, mutant.number if mutant else None)
    except BaseException:
        traceback.print_exc()
        code = NOT_LOADED
    finally:
        os._exit(code)


def _ended(running: _Running, timeout_s: float) -> tuple[Outcome, float] | None:
    pid, status = os.waitpid(running.pid, os.WNOHANG)
    seconds = time.monotonic() - running.started_s
    if pid:
        code = os.waitstatus_to_exitcode(status)
        return OUTCOMES.get(code, Outcome.INFRA_ERROR), seconds
    if seconds < timeout_s:
        return None
    os.killpg(running.pid, signal.SIGKILL)
    os.waitpid(running.pid, 0)
    return Outcome.TIMEOUT, seconds


def baseline(module: str) -> float:
    """Seconds the module's tests take on the module as it is.

    Raises:
        RuntimeError: they fail, so that they could judge no mutant.
    """
    with tempfile.TemporaryDirectory() as folder:
        running = _start(module, None, Path(folder))
        while (end := _ended(running, 600.0)) is None:
            time.sleep(POLL_S)
        if end[0] is not Outcome.SURVIVED:
            raise RuntimeError(f"the tests of {module} fail without any mutant:\n{running.log.read_text()}")
        return end[1]


def run(jobs: int, asked: Iterable[tuple[str, Mutant, float]]) -> Iterator[Result]:
    """Run mutants, ``jobs`` at a time.

    Args:
        jobs: processes at a time.
        asked: module, mutant, and seconds of the module's unchanged tests.
    """
    queue, running = iter(asked), {}
    with tempfile.TemporaryDirectory() as folder:
        more = True
        while more or running:
            while more and len(running) < jobs:
                item = next(queue, None)
                if item is None:
                    more = False
                    break
                module, mutant, usual_s = item
                started = _start(module, mutant, Path(folder))
                running[started.pid] = (started, max(TIMEOUT_LEAST_S, TIMEOUT_FACTOR * usual_s))
            for pid, (one, timeout_s) in list(running.items()):
                end = _ended(one, timeout_s)
                if end is not None:
                    del running[pid]
                    assert one.mutant is not None
                    text = one.log.read_text() if end[0] is Outcome.INFRA_ERROR and one.log.exists() else ""
                    one.log.unlink(missing_ok=True)
                    yield Result(one.module, one.mutant, *end, text)
            time.sleep(POLL_S)
