"""Options of the commands: an annotated dataclass field or function argument declares a whole option.

``seed: Annotated[int, Option("--seed", "Random seed.", span=(0, 2**31))] = 0`` has name, help, range,
type and default. ``takes`` passes a command line to a function as one dataclass, ``arguments`` as separate
arguments; ``argv`` writes a child's command line; ``shared`` copies equally named fields to other options.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from importlib import import_module
from inspect import Parameter, signature
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

import click

T = TypeVar("T")


class BadOptionError(ValueError):
    """An option has a wrong value. The text names the value found and what is allowed."""


@dataclass(frozen=True)
class Option:
    """Option of a command: a ``bool`` is a flag; a ``tuple[T, ...]`` or ``Mapping`` is repeatable."""

    # --name, or --name/--no-name for a flag that is on by default; a name without dashes is the name of a
    # positional argument in the help
    name: str
    help: str = ""
    metavar: str | None = None
    span: tuple[float | None, float | None] = (None, None)  # minimum and maximum number; None: no limit
    # allowed texts, or MODULE:NAME of a tuple of them in another package; empty: any text
    choices: tuple[str, ...] | str = ()
    path: str = "any"  # allowed kind of path: any, file or folder
    exists: bool = False  # whether the path has to exist
    read: Callable[[Any], Any] | None = None  # function that converts the text, or all texts of a Mapping
    bare: str | None = None  # value of the option if only its name is given
    variable: str | None = None  # environment variable that is read if the option is not given

    @property
    def positional(self) -> bool:
        return not self.name.startswith("-")

    @property
    def allowed(self) -> tuple[str, ...]:
        """Allowed texts; empty: any text."""
        if not isinstance(self.choices, str):
            return self.choices
        module, _, name = self.choices.partition(":")
        return tuple(getattr(import_module(module), name))


class Declared(NamedTuple):
    """A field of a dataclass, or an argument of a function, with its option."""

    name: str  # name of the field or argument
    option: Option
    type: type  # type of one value
    many: bool  # whether the option can be given several times
    number: int  # number of values that follow the option each time
    default: Any  # default; MISSING: the option is required


def declared(source: Callable[..., Any]) -> tuple[Declared, ...]:
    """Return the options of a dataclass or function, in the order of its fields or arguments."""
    found: list[Declared] = []
    hints: dict[str, Any] = get_type_hints(source, include_extras=True)
    for name, argument in signature(source).parameters.items():
        hint: Any
        hint, *notes = get_args(hints[name]) or [None]
        option = next((note for note in notes if isinstance(note, Option)), None)
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
        default = MISSING if argument.default is Parameter.empty else argument.default
        found.append(Declared(name, option, hint, many, number, default))
    return tuple(found)


def shared(source: object, cls: type[T], **others: Any) -> T:
    """Return an object of ``cls`` with the equally named fields of ``source`` and the values ``others``."""
    both = {f.name: getattr(source, f.name) for f in fields(cls) if hasattr(source, f.name)}  # type: ignore[arg-type]
    return cls(**{**both, **others})


def argv(options: Any) -> list[str]:
    """Return the command-line arguments of these options; default values are omitted."""
    words: list[str] = []
    for name, option, _, many, number, default in declared(type(options)):
        value = getattr(options, name)
        if option.positional:
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


def takes(cls: type[T]) -> Callable[[Callable[[T], None]], Callable[..., None]]:
    """Return a decorator that passes a command's options as one object of ``cls``."""

    def decorate(verb: Callable[[T], None]) -> Callable[..., None]:
        def run(**given: Any) -> None:
            verb(cls(**given))

        run.__doc__, run.__name__ = verb.__doc__, verb.__name__
        return _optioned(run, declared(cls))

    return decorate


def arguments(verb: Callable[..., None]) -> Callable[..., None]:
    """Declare the arguments of a command as its options."""
    return _optioned(verb, declared(verb))


def _optioned(verb: Callable[..., None], options: Sequence[Declared]) -> Callable[..., None]:
    """Add the options to a command; its help lists the required ones first."""
    for each in sorted(options, key=lambda each: each.default is not MISSING)[::-1]:
        verb = _clicked(each)(verb)
    return verb


def _clicked(each: Declared) -> Callable[..., Any]:
    name, option, kind, many, number, default = each
    required = default is MISSING
    if option.positional:
        return click.argument(
            name, type=_type(each), nargs=-1 if many else 1, required=required, metavar=option.name
        )
    settings: dict[str, Any] = {
        "help": option.help, "metavar": option.metavar, "required": required, "envvar": option.variable,
        "callback": option.read and _callback(option.read),
    }  # fmt: skip
    if option.bare is not None:
        settings |= {"is_flag": False, "flag_value": option.bare}
    if kind is bool:
        settings["is_flag"] = True
    else:
        settings |= {"type": _type(each), "multiple": many, "nargs": number}
    if not required and not many:
        settings["default"] = default
    return click.option(option.name, name, show_default=True, show_envvar=True, **settings)


def _type(each: Declared) -> Any:
    option, (low, high) = each.option, each.option.span
    if option.read is not None:
        return str
    if each.type is Path:
        file, folder = option.path != "folder", option.path != "file"
        return click.Path(exists=option.exists, file_okay=file, dir_okay=folder, path_type=Path)
    if each.type is float:
        return _Number(low, high)
    if each.type is int:
        return click.IntRange(low, high) if (low, high) != (None, None) else int  # type: ignore[arg-type]
    return click.Choice(option.allowed) if option.choices else str


class _Number(click.FloatRange):
    """Finite number in an optional range; NaN, which would pass comparisons, is rejected."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        found: float = super().convert(value, param, ctx)
        if not math.isfinite(found):
            self.fail(f"found {value}, a finite number is needed", param, ctx)
        return found

    def _describe_range(self) -> str:
        return super()._describe_range() if self.min is not None or self.max is not None else ""


def _callback(read: Callable[[Any], Any]) -> Callable[..., Any]:
    def call(context: click.Context, parameter: click.Parameter, given: Any) -> Any:
        del context, parameter
        try:
            return None if given is None else read(given)
        except BadOptionError as error:
            raise click.BadParameter(str(error)) from None

    return call
