"""Compilation of functions with numba, and storage of the machine code on disk.

With ``NUMBA_DISABLE_JIT=1`` all functions run as plain Python, and numba is not loaded. Fast-math is not
used: operations keep their written order, so that each run gives the same bits.

To decide whether stored machine code is valid, numba checks only the file of the compiled function, not the
files of the functions that it calls. Therefore the name of the cache directory has a hash of all sources.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import select
import signal
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., object])

HERE = Path(__file__).parent
# source files with compiled functions, in addition to this folder
SOURCES = (
    "flightstack/core/**/*.py",
    "bridge/frames.py",
    "sim/autopilot/flight.py",
    "sim/robot.py",
    *(f"sim/{room}/*.py" for room in ("plant", "world", "firmware", "vehicle", "validation")),
    *(f"sim/runners/{name}.py" for name in ("ticks", "robot", "room")),
)
OFF = "NUMBA_DISABLE_JIT"  # environment variable of numba that disables compilation
_APART_MAX_S = 120.0  # maximum wait for a part that a second process compiles, s
_NEEDLESS = ("scipy.linalg", "coverage")  # optional imports of numba that compiled code does not use


def is_off() -> bool:
    """Whether this process runs all functions as plain Python."""
    return os.environ.get(OFF, "0") not in ("", "0")


def _fingerprint() -> str:
    """Return a hash over all source files that contain compiled functions."""
    digest, top = hashlib.sha256(), Path(__file__).parents[2]
    for path in [*sorted(HERE.glob("*.py")), *(each for one in SOURCES for each in sorted(top.glob(one)))]:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _usable(directory: Path) -> bool:
    if str(directory).startswith("~"):  # the user has no home directory
        return False
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(directory, os.W_OK | os.X_OK)


@cache
def cache_directory() -> Path | None:
    """Return the first writable directory for machine code; None: no directory is writable."""
    name = f"jit-{_fingerprint()}"
    return next((root / name for root in _roots() if _usable(root / name)), None)


def _roots() -> Iterator[Path]:
    """Yield the folders for machine code, the preferred one first; the last one is created only if needed."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        yield Path(chosen)
    yield HERE / "__pycache__"
    yield Path(os.path.expanduser("~/.cache/flightstack"))  # noqa: PTH111
    with contextlib.suppress(OSError):  # raised also by ``gettempdir`` if no temporary folder is writable
        folder = Path(tempfile.gettempdir()) / f"flightstack-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
        # only this user may write to the folder, because its files are executed
        if stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o077:
            yield folder


def jitted(function: F) -> F:
    """Compile ``function`` at its first call; the machine code is stored on disk if possible."""
    if is_off():
        return function
    numba, directory = load_numba(), cache_directory()
    if directory is None:
        return cast(F, numba.njit(function))
    numba.config.CACHE_DIR = str(directory)
    return cast(F, _guarded(numba.njit(cache=True)(function)))


def _guarded(machine: Any) -> Any:
    """Compile a function again if its stored code is damaged, and run it without storage if the disk is full.

    Files are damaged by a loss of power or a full disk; numba does not catch the exceptions of unpickling.
    """
    cached = machine._cache
    load, save = cached.load_overload, cached.save_overload

    def loaded(*given: Any) -> Any:
        try:
            return load(*given)
        except Exception:  # damaged pickles raise errors of any class; the code is compiled again
            with contextlib.suppress(OSError):
                cached.flush()  # an unreadable index could not be extended
            return None

    def saved(*given: Any) -> None:
        with contextlib.suppress(OSError):
            save(*given)

    cached.load_overload, cached.save_overload = loaded, saved
    return machine


def is_kept(what: str) -> bool:
    """Whether the machine code of ``what`` is on disk, so that it loads in some tenths of a second."""
    folder = cache_directory()
    return folder is not None and (folder / what).exists()


@contextlib.contextmanager
def compiling(what: str, about: str) -> Iterator[bool]:
    """Announce on standard error that functions are compiled in this block, unless ``what`` is on disk.

    The value of the block is False if ``what`` is on disk. After the block, all machine code of ``what`` is
    on disk. ``about``: description and time of the compilation; a slow computer takes longer.
    """
    if is_off() or is_kept(what):
        yield False
        return
    _say(f"compiling {about}")
    yield True
    _say("compiled")
    folder = cache_directory()
    if folder is not None:
        with contextlib.suppress(OSError):  # the disk may be full
            (folder / what).touch()


def at_once(here: Callable[[], object], apart: Callable[[], object]) -> None:
    """Compile two parts of the code at the same time, ``apart`` in a forked process.

    The forked process leaves only machine code on disk. If this process fails, or takes longer than
    ``_APART_MAX_S`` after ``here``, the part ``apart`` is compiled at its first call.
    """
    if cache_directory() is None:
        here()
        return
    ended, ends = os.pipe()  # the read end becomes readable when the forked process ends
    child = -1
    with contextlib.suppress(OSError):  # the fork fails if too many processes run
        child = os.fork()
    if child == 0:
        with contextlib.suppress(BaseException):
            apart()
        os._exit(0)
    os.close(ends)
    try:
        here()
        end = select.poll()
        end.register(ended, select.POLLIN)
        end.poll(1e3 * _APART_MAX_S)
    finally:
        os.close(ended)
        if child > 0:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)


def _say(text: str) -> None:
    with contextlib.suppress(OSError, ValueError):  # standard error may be closed
        print(f"flightstack: {text}", file=sys.stderr, flush=True)


@cache
def load_numba() -> Any:
    """Return numba, loaded without optional imports that this package does not use.

    Without these imports numba loads 0.5 s (a sixth) faster, and the first machine code another 0.5 s faster.
    Without scipy.linalg compiled code cannot multiply matrices.
    """
    absent = [name for name in _NEEDLESS if name not in sys.modules]
    sys.modules.update(dict.fromkeys(absent))  # type: ignore[arg-type]  # with None, an import fails
    try:
        import numba
        import numba.np.arraymath  # this import tries to import scipy.linalg

        return numba
    finally:
        for name in absent:
            del sys.modules[name]
