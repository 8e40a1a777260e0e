"""Conversion of external text (names, paths, vehicle messages, log records) to text that is safe to print."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager

# C0 and C1 except tab and line feed, marks of writing direction, line separators, and surrogates (bytes of a
# path that are not UTF-8)
_HIDDEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


ROBOT_FAILED, FILTER_FAILED = "the robot's function", "the filter returned no velocity"


def pip_install(extras: str) -> str:
    """Return the pip command that installs extras for the running Python, from an index or a checkout."""
    return f"{shlex.quote(sys.executable)} -m pip install 'crazyflie-flightstack[{extras}]'"


# extra that installs a module, by module
_EXTRAS = {
    "mujoco": "sim", "numba": "sim", "llvmlite": "sim", "plotly": "report", "jinja2": "report",
    "markupsafe": "report", "pyarrow": "export", "gymnasium": "env", "greenlet": "env",
    "rerun": "view", "cflib": "crazyflie",
}  # fmt: skip


class MissingExtraError(ModuleNotFoundError, ValueError):
    """A package is not installed; the text names the extra that contains it."""


@contextmanager
def needed_by(what: str) -> Iterator[None]:
    """Raise MissingExtraError if an import in the context fails because ``what`` needs a missing extra."""
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in _EXTRAS:
            raise
        text = f"{what} needs {package}, which is not installed: {pip_install(_EXTRAS[package])}"
        raise MissingExtraError(text, name=error.name) from error


def failed_code(reason: str) -> str:
    """Return the part of a reason that describes failed user code; empty: no user code failed."""
    found = [at for what in (ROBOT_FAILED, FILTER_FAILED) if (at := reason.find(what)) >= 0]
    return reason[min(found) :] if found else ""


def plain(text: object) -> str:
    """Return a text in which control characters are visible and have no effect on the terminal."""
    return _HIDDEN.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), str(text))


def one_line(text: object) -> str:
    """Return ``plain`` text without line breaks, so that a text cannot imitate other lines."""
    return plain(text).replace("\n", "\\n").replace("\t", "\\t")
