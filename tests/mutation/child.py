"""One mutant in a process of its own: stands in for the real module while its tests run."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import os
import sys
from collections.abc import Sequence
from types import CodeType, ModuleType

import hypothesis
import pytest

from tests.mutation.mutants import mutated
from tests.mutation.targets import ROOT, TARGETS, source_file

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


def run(module: str, number: int | None) -> int:
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
