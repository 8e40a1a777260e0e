"""Conversion of external text (names, paths, vehicle messages, log records) to text that is safe to print."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

# C0 and C1 except tab and line feed, marks of writing direction, line separators, and surrogates (bytes of a
# path that are not UTF-8)
_HIDDEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


ROBOT_FAILED, FILTER_FAILED = "the robot's function", "the filter returned no velocity"


def labels(names: Sequence[str]) -> list[str]:
    """Return the names to print beside the members of a fleet; a single member is printed without a name."""
    return list(names) if len(names) > 1 else [""] * len(names)


def named(name: str, text: str, between: str = ": ") -> str:
    """Return a text after the name of its vehicle; the only vehicle has no printed name."""
    return f"{name}{between}{text}" if name else text


def outline(shared: Mapping[str, object], key: str, entries: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JSON object of a fleet: shared values, and each member's values under the key ``key``.

    For a single member, return the object of this member.
    """
    (only, *others) = entries.values()
    return {**shared, key: entries} if others else only


def pip_install(extras: str) -> str:
    """Return the pip command that installs extras for the running Python, from an index or a checkout."""
    return f"{shlex.quote(sys.executable)} -m pip install 'crazyflie-flightstack[{extras}]'"


# extra that installs a module, by module
_EXTRAS = {
    "mujoco": "sim", "numba": "sim", "llvmlite": "sim", "plotly": "report", "jinja2": "report",
    "markupsafe": "report", "pyarrow": "export", "gymnasium": "env", "greenlet": "env", "rerun": "view",
    "cflib": "crazyflie",
}  # fmt: skip


class MissingExtraError(ModuleNotFoundError, ValueError):
    """A package is not installed; the text names the extra that contains it."""


@contextmanager
def needed_by(what: str) -> Iterator[None]:
    """Raise MissingExtraError if an import inside fails because an extra is missing, which ``what`` needs."""
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in _EXTRAS:
            raise
        text = f"{what} needs {package}, which is not installed: {pip_install(_EXTRAS[package])}"
        raise MissingExtraError(text, name=error.name) from error


def failed_code(reason: str) -> str:
    """Return the part of a reason that names failed code of the user; empty: no such code failed."""
    found = [at for what in (ROBOT_FAILED, FILTER_FAILED) if (at := reason.find(what)) >= 0]
    return reason[min(found) :] if found else ""


def plain(text: object) -> str:
    """Return a text in which control characters are visible and have no effect on the terminal."""
    return _HIDDEN.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), str(text))


def one_line(text: object) -> str:
    """Return ``plain`` text without line breaks, so that a text cannot imitate other lines."""
    return plain(text).replace("\n", "\\n").replace("\t", "\\t")
