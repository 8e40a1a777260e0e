"""Names of the safety filters: those of the files in ``strategies/packaged``, ``MODULE:NAME`` for others.

A filter is a class with the interface of ``strategies/strategy.py``. An external filter is imported only to
fly or check it, never to read a configuration or a log.
"""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from flightstack.common.strict_toml import ConfigError, meant
from flightstack.common.text import FILTER_FAILED

_PACKAGED = Path(__file__).parents[1] / "strategies" / "packaged"
# class of each filter of the package: ``NameFilter`` in ``name.py``
FILTERS: Mapping[str, str] = MappingProxyType(
    {
        name: f"flightstack.core.strategies.packaged.{name}:{name.title().replace('_', '')}Filter"
        for name in sorted(file.stem for file in _PACKAGED.glob("[a-z]*.py"))
    }
)
ALLOWED = f"{', '.join(FILTERS)}, or MODULE:NAME of a filter from outside the package"
_GIVEN: dict[str, Any] = {}  # filter classes that ``give`` registered in this process, by name
_REFERENCE = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)


def check_name(name: str) -> None:
    """Reject a text that cannot be the name of a filter; do not import anything."""
    if name not in FILTERS and (".py:" in name or not _REFERENCE.fullmatch(name)):
        module = name.replace(".py:", ":").replace("/", ".")
        close = f"did you mean {module}?" if module != name else meant(name, FILTERS)
        raise ConfigError(f"filter: found {name!r}, allowed: {ALLOWED}{close and f'; {close}'}")


def look_here(name: str) -> None:
    """Append the working folder to the import path, so that an external filter can be imported from it.

    Call this function only for names from the command line or a configuration, not for names from a log.
    """
    here = str(Path.cwd())
    if name not in FILTERS and here not in sys.path:
        sys.path.append(here)


def file_of(reference: str) -> str:
    """Return an imported ``MODULE:NAME`` as FILE:NAME."""
    module, _, name = reference.rpartition(":")
    file = getattr(sys.modules.get(module), "__file__", None)
    return f"{Path(file).name if file else module}:{name}"


def failed_in(name: str, error: BaseException) -> str:
    """Return a text for an exception from an external filter's module; empty: it was raised elsewhere."""
    module, frame = name.rpartition(":")[0], error.__traceback__
    while module and frame is not None:
        if frame.tb_frame.f_globals.get("__name__") == module:
            return f"{FILTER_FAILED}: {file_of(name)} raised {type(error).__name__}: {error}"
        frame = frame.tb_next
    return ""


def give(found: Any) -> str:
    """Register a class, also one that cannot be imported, such as one of a notebook; return its name."""
    place = f"{getattr(found, '__module__', '')}:{getattr(found, '__name__', found)}"
    name = next((short for short, long in FILTERS.items() if long == place), place)
    if name not in FILTERS:
        check_name(name)
        _GIVEN[name] = found
    return name


def given(name: str) -> Any:
    """Return the class that this process registered under this name; None: no class is registered."""
    return _GIVEN.get(name)


def named(name: str) -> Any:
    """Return the object with this name: registered, or imported."""
    check_name(name)
    return _GIVEN[name] if name in _GIVEN else referred(FILTERS.get(name, name))


def referred(reference: str, key: str = "filter") -> Any:
    """Import ``MODULE:NAME``, the value of a configuration key."""
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
        where = getattr(found, "__file__", "built in")
        raise ConfigError(
            f"{key}: found {reference!r}, but module {module} ({where}) has no {attribute}"
        ) from None
