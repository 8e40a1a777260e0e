"""Command-line options: the dataclass that configures a process declares its command line.

An option is a field annotated with an ``Option`` or ``Argument``; the field has its type and default:
``rate_hz: Annotated[int, Option("--rate", "Ticks a second.", span=(10, 500))] = 100``. A command reads the
dataclass from a command line (``flightstack.cli.options``), and ``argv`` writes one for a child process.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields
from types import NoneType, UnionType
from typing import Any, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

T = TypeVar("T")


class BadOptionError(ValueError):
    """An option has a wrong value. The text names the value found and what is allowed."""


@dataclass(frozen=True)
class Argument:
    """A positional argument."""

    metavar: str | None = None
    path: str = "any"  # allowed kind of path: any, file or folder
    exists: bool = False  # whether the path has to exist


@dataclass(frozen=True)
class Option:
    """A named option: ``bool`` is a flag; ``tuple[T, ...]`` and ``Mapping`` may be given repeatedly."""

    name: str  # --name, or --name/--no-name for a flag that is on by default
    help: str
    metavar: str | None = None
    span: tuple[float | None, float | None] = (None, None)  # smallest and largest allowed number
    choices: tuple[str, ...] = ()  # allowed texts; empty: any text
    path: str = "any"  # allowed kind of path: any, file or folder
    exists: bool = False  # whether the path has to exist
    read: Callable[[Any], Any] | None = None  # function that converts the text, or all texts of a Mapping
    bare: str | None = None  # value if the name is given without a value
    variable: str | None = None  # environment variable that is read if the option is not given


class Declared(NamedTuple):
    """An option or argument of a dataclass."""

    name: str  # name of the field
    option: Option | Argument
    type: type  # type of one value
    many: bool  # whether the option may be given several times
    number: int  # number of values each time
    default: Any  # default; MISSING: the option is required


def declared(cls: type) -> tuple[Declared, ...]:
    """Return the options and arguments of a dataclass, in the order of its fields."""
    found: list[Declared] = []
    hints: dict[str, Any] = get_type_hints(cls, include_extras=True)
    for field in fields(cls):
        hint: Any
        hint, *notes = get_args(hints[field.name]) or [None]
        option = next((note for note in notes if isinstance(note, Option | Argument)), None)
        if option is None:
            continue
        if get_origin(hint) in (Union, UnionType):
            hint = next(one for one in get_args(hint) if one is not NoneType)
        many, number, parts = get_origin(hint) is not None, 1, get_args(hint)
        if get_origin(hint) is tuple:
            if parts[-1] is not Ellipsis:
                many, number = False, len(parts)
            hint = parts[0]
        elif many:
            hint = str  # an item of a Mapping is KEY=VALUE
        default = field.default if field.default_factory is MISSING else field.default_factory()
        found.append(Declared(field.name, option, hint, many, number, default))
    return tuple(found)


def shared(source: object, cls: type[T], **others: Any) -> T:
    """Return an object of ``cls`` with the fields of ``source`` that it also has, and with ``others``."""
    both = {f.name: getattr(source, f.name) for f in fields(cls) if hasattr(source, f.name)}  # type: ignore[arg-type]
    return cls(**{**both, **others})


def argv(options: Any) -> list[str]:
    """Return the command-line arguments of these options; default values are omitted."""
    words: list[str] = []
    for name, option, _, many, number, default in declared(type(options)):
        value = getattr(options, name)
        if isinstance(option, Argument):
            words += map(str, value) if many else [str(value)]
        elif value is None or (value == default and option.variable is None):
            continue
        elif isinstance(value, bool):
            words.append(option.name.split("/")[0 if value else -1])
        else:
            if isinstance(value, Mapping):
                value = [f"{key}={each}" for key, each in value.items()]
            for each in value if many else [value]:
                words += [option.name, *map(str, each if number > 1 else [each])]
    return words
