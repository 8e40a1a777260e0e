"""All keys of a scenario with unit, default, range and meaning, read from the declarations.

The comment at a field is the meaning of its key. ``flightstack new scenario`` writes a file with these texts,
and ``python -m tests.scenario_keys`` the tables of docs/reference/scenario_keys.md.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields
from typing import Any, NamedTuple

from msgspec import inspect as types

from flightstack.common.strict_toml import ConfigError, allowed, stem, to_table, type_info
from sim.scenarios.scenario import IN_FILES, Scenario, load

_NOT_LISTED = ("name", "description", "fault", "member")  # keys that a new file does not list
_MEMBERS = "keys of one vehicle, see [teams](../how_to/campaign.md#teams)"
_TABLES = {"Fault": "see [faults](faults.md)", "Scenario": _MEMBERS}  # arrays of tables on other pages
_UNITS = {"m_s": "m/s", "m_s2": "m/s²", "m_s3": "m/s³", "rad_s": "rad/s", "rad_s2": "rad/s²", "1_s": "1/s",
          "1_m": "1/m", "hz": "Hz", "v": "V", "n": "N"}  # fmt: skip
_FIELD = re.compile(r"    (\w+): (?:[^#]*# (?!fmt|noqa)(.*))?")


class Key(NamedTuple):
    """A key; ``default`` is written in TOML, and empty for a required key."""

    table: str  # table of the key; empty: top level
    name: str
    unit: str
    default: str
    allowed: str
    meaning: str


def keys(cls: type[Any] = Scenario, table: str = "") -> Iterator[Key]:
    """Yield the keys of a dataclass and of its nested tables, in the order of declaration."""
    kinds = {each.name: each.type for each in type_info(cls).fields}  # type: ignore[arg-type, attr-defined]
    texts, below = _meanings(cls), list[tuple[type[Any], str]]()
    for each in fields(cls):
        kind, (what, unit) = _single(kinds[each.name]), stem(each.name)
        if isinstance(kind, types.DataclassType):
            below.append((kind.cls, f"{table}.{each.name}" if table else each.name))
            continue
        meaning = texts.get(each.name) or what.replace("_", " ")
        if isinstance(kind, types.VarTupleType) and isinstance(kind.item_type, types.DataclassType):
            meaning = _TABLES.get(kind.item_type.cls.__name__, meaning)
        name = IN_FILES.get(each.name, each.name)
        yield Key(table, name, _UNITS.get(unit, unit), _default(each), _range(kind, name), meaning)
    for inner, name in below:
        yield from keys(inner, name)


def commented(name: str, base: str = "lab") -> str:
    """Return the text of a scenario with base ``base``; all other keys are comments with the base's values.

    Raises ConfigError: the base does not exist, or the name is not a valid identifier.
    """
    if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
        raise ConfigError(f"scenario {name!r}: letters, digits and _ are allowed, a letter first")
    values = to_table(load(base))
    lines = [
        f"# Fly it: flightstack sitl --scenario {name}.toml --lockstep",
        "# Prove it: flightstack check FILE; many seeds: flightstack campaign FILE --runs 100",
        f"# To change a key, remove the # before it and before its table; all else is as in {base}.",
        "# The tables [onboard.…], such as [onboard.limits], configure the onboard process. They are not",
        "# in this list; docs/reference/scenario_keys.md has all of them, and this prints those of the base:",
        f"# flightstack scenarios {base}",
        f'base = "{base}"', f'name = "{name}"', 'description = "What this scenario is for"',
    ]  # fmt: skip
    table = ""
    for key in keys():
        if key.name in _NOT_LISTED or key.table.startswith("onboard") or key.table.count(".") > 1:
            continue
        if key.table != table:
            table = key.table
            lines += ["", f"# [{table}]"]
        unit = f"{key.unit}; " if key.unit else ""
        value = _at(values, f"{table}.{key.name}" if table else key.name, key.default)
        value = "..." if value in ("", "none") else value
        lines.append(f"# {key.name} = {value}  # {unit}{key.allowed}; {key.meaning}")
    return "\n".join(lines) + "\n"


def _at(values: dict[str, Any], path: str, default: str) -> str:
    found: Any = values
    for step in path.split("."):
        if not isinstance(found, dict) or step not in found:
            return default
        found = found[step]
    return _toml(found)


def _single(kind: types.Type) -> types.Type:
    """Return the type of a key, without None if the key is optional."""
    if isinstance(kind, types.UnionType):
        some = [each for each in kind.types if not isinstance(each, types.NoneType)]
        return some[0] if len(some) == 1 else kind
    return kind


def _range(kind: types.Type, name: str) -> str:
    if isinstance(kind, types.TupleType):
        inner = dict.fromkeys(_range(_single(each), name) for each in kind.item_types)
        return f"{len(kind.item_types)} of: {', '.join(inner)}"
    return allowed(kind, name)


def _default(field: Field[Any]) -> str:
    if field.default is not MISSING:
        return "none" if field.default is None else _toml(to_table(field.default))
    return "" if field.default_factory is MISSING else _toml(to_table(field.default_factory()))


def _toml(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return (
        f'"{value}"' if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else str(value)
    )


def _meanings(cls: type[Any]) -> dict[str, str]:
    """Return the comment at each field: at the end of its line, else in the lines before it."""
    found: dict[str, str] = {}
    before: list[str] = []
    for line in "\n".join(map(inspect.getsource, cls.__mro__[-2::-1])).splitlines():
        if line.startswith("    # "):
            before.append(line.removeprefix("    # "))
        elif field := _FIELD.match(line):
            found[field[1]] = field[2] or " ".join(before)
            before = []
    return found
