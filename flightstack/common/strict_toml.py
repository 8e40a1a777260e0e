"""Conversion of TOML to dataclasses. msgspec checks types and ranges; errors name the allowed values.

The range of a number is in its annotation, ``Annotated[float, span(0.1, 10.0)]``; the name of a field ends
with its unit. msgspec ignores unknown keys of a dataclass and accepts NaN; this module rejects both.
"""

from __future__ import annotations

import codecs
import difflib
import json
import math
import re
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from importlib import resources
from itertools import repeat
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec
from msgspec import inspect

T = TypeVar("T")
Each = tuple[T, T, T]  # vector whose components have the same range

UNITS = (
    "m_s2", "m_s3", "rad_s", "rad_s2", "m_s", "1_s", "1_m", "s", "ms", "us", "m", "cm", "mm", "km_h", "cm_s",
    "mm_s", "rad", "deg", "deg_s", "hz", "khz", "kg", "g", "n", "v",
)  # fmt: skip


class ConfigError(ValueError):
    """A configuration or option is wrong or must not fly; the text gives place, value and allowed values."""


def span(low: float, high: float) -> msgspec.Meta:
    """Return the allowed interval of a number, including its ends, in the unit of the field's name."""
    return msgspec.Meta(ge=low, le=high)


class Files(Generic[T]):
    """Loader of TOML files with the keys of the dataclass ``cls``, by name in ``package`` or by path.

    ``kind``: name of the type in errors; ``hint``: text that is appended to the error for an unknown name.
    """

    def __init__(self, cls: type[T], package: str, kind: str, hint: str = "") -> None:
        self._cls, self._kind, self._hint = cls, kind, hint
        self._folder = resources.files(package)

    def names(self) -> list[str]:
        """Return the names of the files in the package."""
        files = (Path(file.name) for file in self._folder.iterdir())
        return sorted(file.stem for file in files if file.suffix == ".toml")

    def path_of(self, name_or_file: str | Path) -> Path:
        """Return the file of this name or path. Raises ConfigError: it is neither a known name nor a file."""
        if name_or_file in self.names():
            return Path(str(self._folder / f"{name_or_file}.toml"))
        path = Path(name_or_file)
        if path.is_file():
            return path
        raise not_found(self._kind, path, self.names(), self._hint)

    def load(self, name_or_file: str | Path) -> T:
        """Read the file of this name or path, and check its keys and values."""
        path = self.path_of(name_or_file)
        table = self.table(path)
        try:
            keys = (*(each.name for each in fields(self._cls)), "base")  # type: ignore[arg-type]
            return from_table(self._cls, table, keys=keys)
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from None

    def table(self, path: Path) -> dict[str, Any]:
        """Parse a file; missing keys are taken from the file that its key ``base`` names."""
        return self.over_base(path, read_toml(path))

    def over_base(self, path: Path, table: dict[str, Any], above: tuple[Path, ...] = ()) -> dict[str, Any]:
        """Merge a table over the file that its key ``base`` names; ``above``: files based on this file."""
        if "base" not in table:
            return table
        base = self.named(path, "base", name := table.pop("base"))
        if base.resolve() in (*above, path.resolve()):
            raise ConfigError(f"{path}: base: found {name!r}, which has this file as its base; remove one")
        return over(self.over_base(base, read_toml(base), (*above, path.resolve())), table)

    def named(self, path: Path, key: str, name: object) -> Path:
        """Return the file to which ``name``, the value of ``key`` in the file ``path``, refers.

        ``name``: file in the folder of ``path``, file of the package, or path.
        """
        if not isinstance(name, str):
            raise ConfigError(
                f"{path}: {key}: found {name!r}, the name of a {self._kind} or a file is needed"
            )
        try:
            return self.path_of(path.parent / name if (path.parent / name).is_file() else name)
        except ConfigError as error:
            raise ConfigError(f"{path}: {key}: {error}") from None


def not_found(kind: str, name_or_file: str | Path, names: Sequence[str], hint: str = "") -> ConfigError:
    """Return the error for a text that is neither a file nor one of ``names``."""
    what = f"{kind} {str(name_or_file)!r}"
    if Path(name_or_file).suffix == ".toml":
        return ConfigError(f"{what}: there is no file {Path(name_or_file).absolute()}")
    close = meant(str(name_or_file), names)
    return ConfigError(f"{what}: neither a file nor one of: {', '.join(names)}{hint}{close and f'; {close}'}")


def meant(word: str, known: Iterable[str]) -> str:
    """Return a "did you mean" text with the known word nearest to ``word``; empty: none is near."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f"did you mean {close[0]}?" if close else ""


def over(base: dict[str, Any], table: dict[str, Any]) -> dict[str, Any]:
    """Merge ``table`` over ``base``: sub-tables are merged, other values replaced. Return a new table."""
    joined = dict(base)
    for key, value in table.items():
        below = base.get(key)
        joined[key] = over(below, value) if isinstance(value, dict) and isinstance(below, dict) else value
    return joined


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file. Raises ConfigError: the file is missing or not TOML."""
    try:
        return parse_toml(path.read_bytes())
    except OSError as error:
        raise ConfigError(f"{path}: can't be read: {error.strerror}") from error
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def parse_toml(data: bytes) -> dict[str, Any]:
    """Parse TOML in UTF-8 or the encoding of its byte order mark. Raises ConfigError: not TOML, not text."""
    try:
        return tomllib.loads(decoded(data))
    except (ValueError, RecursionError) as error:  # raised by tomllib or by the decoding
        raise ConfigError(f"not TOML: {error}") from error


def decoded(data: bytes) -> str:
    """Return text in UTF-8, or in the encoding of its byte order mark. Raises ValueError: not text."""
    encoding = next((name for mark, name in _MARKS if data.startswith(mark)), "utf-8")
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        where = f"byte {error.start} is {data[error.start]:#04x}"
        raise ValueError(f"not text in the encoding {encoding} ({where}); save it as UTF-8") from None
    if "\0" in text:
        raise ValueError("it contains zero bytes: UTF-16 without a byte order mark? Save it as UTF-8")
    return text


_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),  # UTF-32 is before UTF-16, because its mark begins with that of UTF-16
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


def from_table(cls: type[T], table: object, where: str = "", keys: Sequence[str] = ()) -> T:
    """Build a dataclass from a TOML table, with checks of every key, type and range.

    ``keys``: allowed keys of the file, for the text of an error; empty: the fields of ``cls``.
    """
    places = dict(_places(type_info(cls), table, where, keys))  # type: ignore[arg-type]  # a class is hashable
    try:
        return msgspec.convert(table, cls)
    except msgspec.ValidationError as error:
        path = re.search(r" - at `\$\.?(.*)`$", str(error))
        at = ".".join(filter(None, (where, path and path[1])))
        if error.__cause__ is not None:  # a ``__post_init__`` raised the cause
            raise ConfigError(f"{at}: {error.__cause__}" if at else str(error.__cause__)) from None
        kind, found = places[at]
        raise ConfigError(f"{at or cls.__name__}: found {found!r}, allowed: {allowed(kind, at)}") from None


type_info = cache(inspect.type_info)


def _places(
    kind: inspect.Type, value: object, at: str, keys: Sequence[str] = ()
) -> Iterator[tuple[str, tuple[inspect.Type, object]]]:
    """Check the keys of a table; yield type and value at each place, such as ``fault[0].start_s``."""
    if isinstance(kind, inspect.UnionType):
        kinds = tuple(each for each in kind.types if not isinstance(each, inspect.NoneType))
        kind = kinds[0] if len(kinds) == 1 else inspect.UnionType(kinds)  # an optional type, or a union
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{at}: found {value!r}, a finite number is needed")
    yield at, (kind, value)
    if isinstance(kind, inspect.DataclassType) and isinstance(value, dict):
        if hasattr(kind.cls, "other_keys"):  # ``other_keys`` replaces alternative keys in the table
            try:
                kind.cls.other_keys(value)
            except ConfigError as error:
                raise ConfigError(f"{at}: {error}" if at else str(error)) from None
        known = {field.name: field for field in kind.fields}
        for key in value:
            if key not in known:
                tables = {n: f.type for n, f in known.items() if isinstance(f.type, inspect.DataclassType)}
                inside = [f"{n}.{key}" for n, kind in tables.items() if key in {f.name for f in kind.fields}]
                raise ConfigError(_unknown(key, keys or list(known), inside, at))
        for name, field in known.items():
            below = f"{at}.{name}" if at else name
            if name in value:
                yield from _places(field.type, value[name], below)
            elif field.required:
                raise ConfigError(f"{below}: missing; it has no default")
    elif isinstance(kind, inspect.VarTupleType | inspect.TupleType) and isinstance(value, list):
        types = repeat(kind.item_type) if isinstance(kind, inspect.VarTupleType) else kind.item_types
        for number, (inner, item) in enumerate(zip(types, value, strict=False)):
            yield from _places(inner, item, f"{at}[{number}]")


def allowed(kind: inspect.Type, at: str) -> str:
    """Return a text with the values that a type allows."""
    match kind:
        case inspect.IntType(ge=low, le=high):
            return "an integer" if low is None else f"an integer, {low:g} to {high:g}"
        case inspect.FloatType(ge=low, le=high):
            return "a finite number" if low is None else f"{low:g} to {high:g}"
        case inspect.EnumType(cls=cls):
            return ", ".join(str(member.value) for member in cls)
        case inspect.LiteralType(values=values):
            return ", ".join(map(str, values))
        case inspect.TupleType(item_types=items):
            return f"an array of {len(items)} values"
        case inspect.VarTupleType(item_type=inspect.DataclassType()):
            return f"an array of tables [[{at}]]"
        case inspect.DataclassType():
            return f"a table [{at}]"
        case inspect.UnionType(types=kinds):
            return " or ".join(allowed(each, at) for each in kinds)
    return {"StrType": "a string", "BoolType": "true or false"}.get(type(kind).__name__, "an array")


def _unknown(key: str, known: Sequence[str], inside: Sequence[str], where: str) -> str:
    """Return the error text for an unknown key; ``inside``: paths of equal keys in the sub-tables."""
    at = f"{where}.{key}" if where else key
    found, unit = stem(key)
    for name in known:
        wanted_stem, wanted = stem(name)
        if wanted_stem == found and wanted != unit:
            needed = f"the key is {f'{where}.{name}' if where else name}"
            return f"{at}: wrong unit: found [{unit}], {needed}" if unit else f"{at}: no unit; {needed}"
    hint = f"did you mean {inside[0]}?" if inside else meant(key, known)
    return f"{at}: unknown key; {hint}{' ' if hint else ''}allowed: {', '.join(sorted(known))}"


def stem(key: str) -> tuple[str, str]:
    """Return a key without its unit, and the unit."""
    for unit in sorted(UNITS, key=len, reverse=True):
        if key.endswith("_" + unit):
            return key[: -len(unit) - 1], unit
    return key, ""


def to_table(value: Any) -> Any:
    """Convert a dataclass to plain TOML data, without ``None`` and without tables equal to their defaults."""
    if is_dataclass(value):
        items = ((f.name, f.default, getattr(value, f.name)) for f in fields(value))
        return {
            name: to_table(v)
            for name, default, v in items
            if v is not None and not (is_dataclass(v) and v == default)
        }
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, tuple):
        return [to_table(v) for v in value]
    return value


def dumps(value: Any) -> str:
    """Return a dataclass, or plain nested tables, as text that ``tomllib`` reads."""
    return "\n".join(_lines(to_table(value))) + "\n"


def _lines(table: dict[str, Any], prefix: str = "") -> Iterator[str]:
    arrays = {
        key: value
        for key, value in table.items()
        if value and isinstance(value, list) and all(isinstance(item, dict) for item in value)
    }
    for key, value in table.items():
        if key not in arrays and not isinstance(value, dict):
            yield f"{key} = {json.dumps(value, ensure_ascii=False)}"  # a JSON text is also valid in TOML
    for key, value in table.items():
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(value, dict):
            yield from ("", f"[{name}]", *_lines(value, name))
        for item in arrays.get(key, []):
            yield from ("", f"[[{name}]]", *_lines(item, name))
