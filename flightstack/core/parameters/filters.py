"""Names of the safety filters: one line for each that comes with the package, ``MODULE:NAME`` for others.

A filter is a class with the interface of ``strategies/strategy.py``. A filter from outside the package is
imported where it flies or is checked, never by reading a configuration or a log.
"""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from flightstack.common.strict_toml import ConfigError

FILTERS: Mapping[str, str] = MappingProxyType(
    {
        "paper": "flightstack.core.strategies.paper:PaperFilter",  # eq. 11 as printed
        "robust": "flightstack.core.strategies.robust:RobustFilter",
    }
)
ALLOWED = f"{', '.join(FILTERS)}, or MODULE:NAME of a filter from outside the package"
_GIVEN: dict[str, Any] = {}  # classes of this process, by name
_REFERENCE = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)


def check_name(name: str) -> None:
    """Refuse what cannot be the name of a filter; nothing is imported."""
    if name not in FILTERS and not _REFERENCE.fullmatch(name):
        raise ConfigError(f"filter: found {name!r}, allowed: {ALLOWED}")


def look_here(name: str) -> None:
    """Let a filter from outside the package be found in the working folder, after all installed modules.

    For names that the user gave, on the command line or in a file of his own; not for names out of a log.
    """
    here = str(Path.cwd())
    if name not in FILTERS and here not in sys.path:
        sys.path.append(here)


def short_name(name: str) -> str:
    """The name without its module, for names of files."""
    return name.rpartition(":")[2]


def give(found: Any) -> str:
    """Name for a class of this process, which need not be importable (a notebook's, a function's)."""
    place = f"{getattr(found, '__module__', '')}:{getattr(found, '__name__', found)}"
    name = next((short for short, long in FILTERS.items() if long == place), place)
    if name not in FILTERS:
        check_name(name)
        _GIVEN[name] = found
        named.cache_clear()
    return name


def given(name: str) -> Any:
    """Class of this process with this name; None: it is found by importing its module."""
    return _GIVEN.get(name)


@lru_cache(maxsize=16)
def named(name: str) -> Any:
    """Import what a name stands for."""
    check_name(name)
    if name in _GIVEN:
        return _GIVEN[name]
    return referred(FILTERS.get(name, name))


def referred(reference: str, key: str = "filter") -> Any:
    """Import ``MODULE:NAME``, the value of this key."""
    module, _, attribute = reference.partition(":")
    try:
        found = importlib.import_module(module)
    except ImportError as error:
        raise ConfigError(
            f"{key}: found {reference!r}, but module {module} cannot be imported ({error}); install it, or "
            "run in the folder that it is in"
        ) from error
    try:
        return getattr(found, attribute)
    except AttributeError:
        raise ConfigError(
            f"{key}: found {reference!r}, but module {module} ({found.__file__}) has no {attribute}"
        ) from None
