"""Table of all keys of a scenario with unit, default, range and meaning, read from the declarations.

``python -m sim.scenarios.keys`` writes the table of docs/reference/scenario_keys.md; ``flightstack new
scenario`` writes a file with the same texts. The comment at a field is the meaning of its key.
"""

from __future__ import annotations

import inspect
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import Any, NamedTuple

from msgspec import inspect as types

from flightstack.common.strict_toml import ConfigError, allowed, stem, to_table, type_info
from sim.scenarios.scenario import IN_FILES, Scenario, load

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "scenario_keys.md"
_NOT_LISTED = ("name", "description", "fault", "member")  # keys that a new file does not list
_MEMBERS = "keys of one vehicle, see [teams](../how_to/campaign.md#teams)"
_TABLES = {"Fault": "see [faults](faults.md)", "Scenario": _MEMBERS}  # arrays of tables on their own pages


class Key(NamedTuple):
    """Row of the table of scenario keys."""

    table: str  # table of the key; empty: top level
    name: str
    unit: str
    default: str  # default in TOML; empty: the key is required
    allowed: str
    meaning: str


def keys(cls: type[Any] = Scenario, table: str = "") -> Iterator[Key]:
    """Yield the keys of a dataclass and of its nested tables, in the order of declaration."""
    kinds = {each.name: each.type for each in type_info(cls).fields}  # type: ignore[arg-type, attr-defined]
    below: list[tuple[type[Any], str]] = []
    for each in fields(cls):
        kind, meaning = _single(kinds[each.name]), _meanings(cls).get(each.name, "")
        if isinstance(kind, types.DataclassType):
            below.append((kind.cls, f"{table}.{each.name}" if table else each.name))
            continue
        what, unit = stem(each.name)
        if isinstance(kind, types.VarTupleType) and isinstance(kind.item_type, types.DataclassType):
            meaning = _TABLES.get(kind.item_type.cls.__name__, meaning)
        name = IN_FILES.get(each.name, each.name)
        text = _range(kind, name)
        yield Key(table, name, _written(unit), _default(each), text, meaning or what.replace("_", " "))
    for inner, name in below:
        yield from keys(inner, name)


def page() -> str:
    """Return the documentation page of all keys."""
    lines = [_INTRODUCTION]
    table = None
    for key in sorted(keys(), key=lambda each: each.table.startswith("onboard")):
        if key.table != table:
            table = key.table
            lines += ["", f"## `[{table}]`" if table else "## At the top", "", _HEAD]
        cells = (
            f"`{key.name}`",
            key.unit,
            f"`{key.default}`" if key.default else "required",
            key.allowed,
            key.meaning,
        )
        lines.append(f"| {' | '.join(each.replace('|', chr(92) + '|') for each in cells)} |")
    return "\n".join(lines) + "\n"


_INTRODUCTION = """# Keys of a scenario

A scenario is a TOML file that describes a simulated run. `flightstack new scenario NAME` writes such a file with
comments. With `base = "lab"` (a name or a file) it contains only the differences from that scenario. An unknown key, a
wrong unit and a value out of range are refused. Positions are east, north, up. The tables `[onboard.…]` are the
configuration of the onboard process (`flightstack config`).

The tables `judge`, `vehicle.own`, `odometry.error`, `onboard.reserve` and `onboard.fleet` are optional. Without `judge`
the verdict uses the barrier of the configuration. If one of the other tables is missing, that feature is not used.

`python -m sim.scenarios.keys` writes this page from the declarations."""  # noqa: E501
_HEAD = "| key | unit | default | allowed | meaning |\n|---|---|---|---|---|"


def commented(name: str, base: str = "lab") -> str:
    """Return the text of a scenario with base ``base``; each other key is a comment with the base's value.

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


def _written(unit: str) -> str:
    """Return a unit as printed: ``m_s2`` becomes m/s²."""
    known = {"m_s": "m/s", "m_s2": "m/s²", "m_s3": "m/s³", "rad_s": "rad/s", "rad_s2": "rad/s²", "1_s": "1/s",
             "1_m": "1/m", "hz": "Hz", "v": "V", "n": "N"}  # fmt: skip
    return known.get(unit, unit)


def _meanings(cls: type[Any]) -> dict[str, str]:
    """Return the comment at each field, including inherited fields."""
    return {name: text for each in reversed(cls.__mro__[:-1]) for name, text in _comments(each).items()}


def _comments(cls: type[Any]) -> dict[str, str]:
    """Return the comment at each field: at the end of its line, else in the lines before it."""
    found: dict[str, str] = {}
    before: list[str] = []
    name, depth = "", 0
    for token in tokenize.generate_tokens(io.StringIO(inspect.cleandoc(inspect.getsource(cls))).readline):
        depth += {"(": 1, "[": 1, ")": -1, "]": -1}.get(token.string, 0) if token.type == tokenize.OP else 0
        if token.type == tokenize.COMMENT and not token.string.startswith(("# fmt", "# noqa")):
            text = token.string.lstrip("# ")
            if name:
                found[name] = text
            else:
                before.append(text)
        elif token.type == tokenize.NAME and not name and re.match(rf"\s*{token.string}\s*:", token.line):
            name = token.string
            if before:
                found[name] = " ".join(before)
            before = []
        elif token.type == tokenize.NEWLINE:
            name = ""
    return found


if __name__ == "__main__":
    PAGE.write_text(page())
    sys.stdout.write(f"{PAGE}\n")
