"""Conversion of the options of a dataclass (``flightstack.common.options``) to click options."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import MISSING
from pathlib import Path
from typing import Any, TypeVar

import click

from flightstack.common.options import Argument, BadOptionError, Declared, Option, declared
from flightstack.common.text import pip_install

T = TypeVar("T")


class Number(click.FloatRange):
    """Finite number in an optional range; NaN, which would pass comparisons, is rejected."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Convert a text to a number."""
        found: float = super().convert(value, param, ctx)
        if not math.isfinite(found):
            self.fail(f"found {value}, a finite number is needed", param, ctx)
        return found

    def _describe_range(self) -> str:
        return super()._describe_range() if self.min is not None or self.max is not None else ""


class File(click.Path):
    """Path of an ordinary file; devices and pipes, which may never end, are rejected."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Convert a text to the path."""
        found: Any = super().convert(value, param, ctx)
        if not found.is_file():
            self.fail(f"{found} is a pipe, socket or device; an ordinary file is needed", param, ctx)
        return found


def takes(cls: type[T]) -> Callable[[Callable[[T], None]], Callable[..., None]]:
    """Return a decorator that passes options (required ones first) and arguments as one object of ``cls``."""
    parameters = sorted(declared(cls), key=lambda each: each.default is not MISSING)

    def decorate(verb: Callable[[T], None]) -> Callable[..., None]:
        def run(**given: Any) -> None:
            verb(cls(**given))

        run.__doc__, run.__name__ = verb.__doc__, verb.__name__
        decorated: Callable[..., None] = run
        for each in reversed(parameters):
            decorated = _clicked(each)(decorated)
        return decorated

    return decorate


def _clicked(each: Declared) -> Callable[..., Any]:
    name, option, _, many, number, default = each
    required = default is MISSING
    if isinstance(option, Argument):
        return click.argument(
            name, type=_type(each), nargs=-1 if many else 1, required=required, metavar=option.metavar
        )
    settings: dict[str, Any] = {"help": option.help, "metavar": option.metavar, "required": required}
    if option.variable is not None:
        settings |= {"envvar": option.variable, "show_envvar": True}
    if option.bare is not None:
        settings |= {"is_flag": False, "flag_value": option.bare}
    if each.type is bool:
        settings["is_flag"] = True
    else:
        settings |= {"type": _type(each), "multiple": many, "nargs": number}
    if not required and not many:
        settings["default"] = default
    if option.read is not None:
        settings["callback"] = _callback(option.read)
    return click.option(option.name, name, show_default=True, **settings)


def _type(each: Declared) -> Any:
    option = each.option
    if isinstance(option, Option) and option.read is not None:
        return str
    if each.type is Path:
        kind = File if option.path == "file" and option.exists else click.Path
        return kind(
            exists=option.exists, file_okay=option.path != "folder", dir_okay=option.path != "file",
            path_type=Path,
        )  # fmt: skip
    if isinstance(option, Argument) or each.type not in (int, float):
        return click.Choice(option.choices) if isinstance(option, Option) and option.choices else str
    low, high = option.span
    if each.type is float:
        return Number(low, high)
    return click.IntRange(low, high) if (low, high) != (None, None) else int  # type: ignore[arg-type]


def _callback(read: Callable[[Any], Any]) -> Callable[..., Any]:
    def call(context: click.Context, parameter: click.Parameter, given: Any) -> Any:
        del context, parameter
        try:
            return None if given is None else read(given)
        except BadOptionError as error:
            raise click.BadParameter(str(error)) from None

    return call


def without(error: ModuleNotFoundError, text: str, *packages: str) -> Exception:
    """Return an error with this text if one of the packages is missing, else the given error."""
    package = (error.name or "").partition(".")[0]
    return ValueError(text.format(package)) if package in packages else error


def without_rerun(error: ModuleNotFoundError, what: str) -> Exception:
    """Return the error for a command or option ``what`` that cannot import Rerun."""
    text = f"`{what}` needs Rerun: {pip_install('view')}; "
    return without(error, text + "or open the log itself in another viewer (docs/how_to/viewing.md)", "rerun")
