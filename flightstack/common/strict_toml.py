"""Strict TOML into typed dataclasses: an unknown key, a wrong unit or a value out of range is refused.

A field's range is written beside it, ``Annotated[float, Range(0.1, 10.0)]``; its unit ends its name.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import tomllib
import types
import typing
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

T = TypeVar("T")

UNITS = (
    "m_s2", "m_s3", "rad_s", "rad_s2", "m_s", "1_s", "1_m", "s", "ms", "us", "m", "cm", "mm", "km_h", "cm_s",
    "mm_s", "rad", "deg", "deg_s", "hz", "khz", "kg", "g", "n", "v",
)  # fmt: skip


class ConfigError(ValueError):
    """A configuration that must not fly: says where, what was found, what is allowed."""


@dataclass(frozen=True)
class Range:
    """Allowed interval of a number, both ends included; unit as in the field's name."""

    low: float
    high: float


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file.

    Raises:
        ConfigError: the file is missing or not TOML.
    """
    try:
        return tomllib.loads(path.read_text())
    except OSError as error:
        raise ConfigError(f"{path}: can't be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not TOML: {error}") from error


def from_table(cls: type[T], table: object, where: str = "") -> T:
    """Build dataclass ``cls`` from a TOML table, checking every key, type and range.

    Raises:
        ConfigError: unknown key, wrong unit, wrong type, out of range, or refused by ``__post_init__``.
    """
    if not isinstance(table, dict):
        raise ConfigError(f"{where or cls.__name__}: found {table!r}, a table [{where}] is needed")
    hints = get_type_hints(cls, include_extras=True)
    fields = {f.name: f for f in dataclasses.fields(cls) if f.init}  # type: ignore[arg-type]
    for key in table:
        if key not in fields:
            raise ConfigError(_unknown(key, list(fields), where))
    values: dict[str, Any] = {}
    for name, field in fields.items():
        at = f"{where}.{name}" if where else name
        if name in table:
            values[name] = _convert(hints[name], table[name], at)
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            raise ConfigError(f"{at}: missing; it has no default")
    try:
        return cls(**values)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}" if where else str(error)) from None


def _stem(key: str) -> tuple[str, str]:
    for unit in sorted(UNITS, key=len, reverse=True):
        if key.endswith("_" + unit):
            return key[: -len(unit) - 1], unit
    return key, ""


def _unknown(key: str, allowed: list[str], where: str) -> str:
    at = f"{where}.{key}" if where else key
    stem, unit = _stem(key)
    for name in allowed:
        wanted_stem, wanted = _stem(name)
        if wanted_stem == stem and wanted != unit:
            return f"{at}: wrong unit: found [{unit or 'none'}], the key is {name} [{wanted or 'none'}]"
    close = difflib.get_close_matches(key, allowed, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    return f"{at}: unknown key; {hint}allowed: {', '.join(sorted(allowed))}"


def _convert(hint: Any, value: Any, at: str) -> Any:
    bounds: Range | None = None
    if get_origin(hint) is Annotated:
        hint, *extras = get_args(hint)
        bounds = next((e for e in extras if isinstance(e, Range)), None)
    origin = get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        options = [a for a in get_args(hint) if a is not type(None)]
        return _convert(Annotated[options[0], bounds] if bounds else options[0], value, at)
    if origin is tuple:
        inner = get_args(hint)
        if not isinstance(value, list):
            needed = f"an array of tables [[{at}]]" if dataclasses.is_dataclass(inner[0]) else "an array"
            raise ConfigError(f"{at}: found {value!r}, {needed} is needed")
        if len(inner) == 2 and inner[1] is Ellipsis:
            inner = (inner[0],) * len(value)
        if len(value) != len(inner):
            raise ConfigError(f"{at}: found {len(value)} values, exactly {len(inner)} are needed")
        wrap = [Annotated[i, bounds] if bounds else i for i in inner]
        return tuple(_convert(i, v, f"{at}[{n}]") for n, (i, v) in enumerate(zip(wrap, value, strict=True)))
    if dataclasses.is_dataclass(hint):
        return from_table(typing.cast(type, hint), value, at)
    if isinstance(hint, type) and issubclass(hint, Enum):
        names = [str(m.value) for m in hint]
        if value not in names:
            raise ConfigError(f"{at}: found {value!r}, allowed: {', '.join(names)}")
        return hint(value)
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not hint:
        raise ConfigError(f"{at}: found {value!r} ({type(value).__name__}), a {hint.__name__} is needed")
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{at}: found {value!r}, a finite number is needed")
    if bounds and not bounds.low <= value <= bounds.high:
        raise ConfigError(f"{at}: found {value!r}, allowed: {bounds.low:g} to {bounds.high:g}")
    return value


def to_table(value: Any) -> Any:
    """Turn a dataclass built by ``from_table`` back into plain TOML data; ``None`` fields are left out."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        items = ((f.name, getattr(value, f.name)) for f in dataclasses.fields(value) if f.init)
        return {name: to_table(v) for name, v in items if v is not None}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, tuple):
        return [to_table(v) for v in value]
    return value


def dumps(table: dict[str, Any]) -> str:
    """Write plain nested tables of scalars, arrays and arrays of tables as text readable by ``tomllib``."""
    lines: list[str] = []
    _write_table(table, "", lines)
    return "\n".join(lines) + "\n"


def _tables(value: Any) -> list[dict[str, Any]]:
    """Tables of an array of tables; empty for anything else."""
    is_array = isinstance(value, list) and all(isinstance(item, dict) for item in value)
    return value if is_array else []


def _write_table(table: dict[str, Any], prefix: str, lines: list[str]) -> None:
    for key, value in table.items():
        if not isinstance(value, dict) and not _tables(value):
            lines.append(f"{key} = {_scalar(value)}")
    for key, value in table.items():
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(value, dict):
            lines.extend(["", f"[{name}]"])
            _write_table(value, name, lines)
        for item in _tables(value):
            lines.extend(["", f"[[{name}]]"])
            _write_table(item, name, lines)


def _scalar(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
        return f'"{escaped}"'
    if isinstance(value, list):
        return "[" + ", ".join(_scalar(v) for v in value) + "]"
    return repr(value)
