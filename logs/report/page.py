"""HTML pages of reports: parts with their texts escaped, one drawing library, no network needed.

For other pages of this look, as a campaign's: ``page("Title", body)`` with a body of the parts made here. The
parts are macros of ``parts.html``; what they return counts as HTML, any other text is escaped.
"""

from __future__ import annotations

import base64
import gzip
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

_LEVEL = 9  # of gzip; the library is packed once a process


class ReportError(RuntimeError):
    """The page cannot be made: a library is missing."""


def page(title: str, body: str) -> str:
    """Return a whole page."""
    template = _templates().get_template("report_template.html")
    text: str = template.render(title=title, body=body, plotly=plotly_source())
    return text


def header(title: str, badge: str, style: str, sub: str) -> str:
    """Title with a badge (``style`` good, fair or bad) and a line below."""
    return _part("header", title, badge, style, sub)


def numbers(values: Sequence[tuple[str, str, str]]) -> str:
    """The most important numbers in large type: name, value and unit of each."""
    return _part("numbers", values)


def section(key: str, title: str, paper: str, note: str, figure: Any | None) -> str:
    """One figure with its title and note; without data a note that nothing is drawn."""
    # a "<" in a name could end the script element
    data = html(figure.to_json().replace("<", "\\u003c")) if figure is not None else None
    return _part("section", key, title, paper, note, data)


def block(key: str, title: str, note: str, content: str, style: str = "wide") -> str:
    """A section with any content and a note above it."""
    return _part("block", key, title, note, content, style)


def details(title: str, text: str, name: str = "") -> str:
    """Long text that opens on demand; with a file ``name`` it can be saved."""
    return _part("details", title, text, name, base64.b64encode(text.encode()).decode("ascii"))


def warnings_box(texts: Sequence[str]) -> str:
    """Warnings about the page; empty without texts."""
    return _part("warnings", texts)


def table(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    numbers: Sequence[int] = (),
    row_class: int | None = None,
) -> str:
    """Rows of text; columns ``numbers`` are set to the right, column ``row_class`` is the style of a row."""
    return _part("table", head, rows, numbers, row_class)


def time_bar(*, events: bool) -> str:
    """Buttons for the range of all time axes; with a hint if there are links to events."""
    return _part("bar", events)


def time_link(t_s: float, text: str) -> str:
    """A time that links to itself in the figures."""
    return _part("at_link", f"{t_s:.2f}", text)


def repeat_box(**values: Any) -> str:
    """Commands that repeat a flight; the names are those of the macro ``repeat``."""
    return _part("repeat", **values)


def html(text: str) -> str:
    """Text that is HTML already and is not escaped."""
    from markupsafe import Markup

    return Markup(text)


def paragraph(text: str) -> str:
    return html("<p>{}</p>").format(text)


def need_libraries() -> None:
    """Check that pages can be made."""
    try:
        import jinja2  # noqa: F401
        import plotly.graph_objects  # noqa: F401
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing not in ("plotly", "jinja2"):
            raise
        raise ReportError(
            f'the page needs {missing}, which is not installed: pip install "crazyflie-flightstack[report]"'
        ) from error


@cache
def plotly_source() -> str:
    """The drawing library, packed: gzip in base64, a third of its size; the page unpacks it."""
    packed = gzip.compress((files("plotly") / "package_data" / "plotly.min.js").read_bytes(), _LEVEL, mtime=0)
    return base64.b64encode(packed).decode("ascii")


@cache
def _templates() -> Any:
    from jinja2 import Environment, FileSystemLoader

    return Environment(loader=FileSystemLoader(Path(__file__).parent), autoescape=True)


def _part(macro: str, *values: Any, **named: Any) -> str:
    made: str = getattr(_templates().get_template("parts.html").module, macro)(*values, **named)
    return made
