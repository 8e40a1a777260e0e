"""HTML pages of flights and campaigns: a page is a list of panels and needs no network.

``render(Page(...))`` makes a page of any figures and tables; it escapes texts, but not HTML made by ``part``.
"""

from __future__ import annotations

import base64
import gzip
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

from flightstack.common.text import needed_by

_LEVEL = 9  # gzip level; the library is compressed once per process


class ReportError(ValueError):
    """The page cannot be written."""


class Panel(NamedTuple):
    key: str  # name in links: ``page.html#key``
    title: str
    note: str
    content: Any  # plotly figure, HTML, or text; None: no data
    paper: str = ""  # number of the figure in the paper with the same content
    style: str = "wide"


class Page(NamedTuple):
    """A page: the first screen, and the panels below."""

    title: str
    badge: tuple[str, str]  # text of the outcome, and its style (good, fair or bad)
    sub: str  # text of the line below the title
    numbers: Sequence[tuple[str, str, str]]  # name, value and unit of each key number
    # panels in order; panels of a sequence are side by side; a string is HTML
    panels: Sequence[Panel | Sequence[Panel] | str]
    warnings: Sequence[str] = ()


def render(page: Page) -> str:
    """Return a page as HTML text. Raises like ``need_libraries``."""
    need_libraries()
    template = _templates().get_template("report_template.html")
    text: str = template.render(page=page, plotly=plotly_source())
    return text


def write(path: Path, page: Page) -> Path:
    """Write a page. Raises ReportError: the page cannot be written; or raises like ``need_libraries``."""
    text = render(page)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8", errors="backslashreplace")  # a path may not be UTF-8
    except OSError as error:
        if path.is_file():
            path.unlink()  # removes the incomplete file
        raise ReportError(f"{path}: cannot be written: {error.strerror}") from error
    return path


def need_libraries() -> None:
    """Raise MissingExtraError if a library for pages is not installed."""
    with needed_by("the page"):
        import jinja2  # noqa: F401
        import plotly.graph_objects  # noqa: F401


@cache
def plotly_source() -> str:
    """Return the plotting library as gzip in base64, a third of the size; the page unpacks the library."""
    packed = gzip.compress((files("plotly") / "package_data" / "plotly.min.js").read_bytes(), _LEVEL, mtime=0)
    return base64.b64encode(packed).decode("ascii")


@cache
def _templates() -> Any:
    from jinja2 import Environment, FileSystemLoader
    from markupsafe import Markup

    made = Environment(loader=FileSystemLoader(Path(__file__).parent), autoescape=True)
    made.filters["base64"] = lambda text: base64.b64encode(text.encode()).decode("ascii")
    # "<" is escaped, because a name could end the script element
    made.filters["json"] = lambda figure: Markup(figure.to_json().replace("<", "\\u003c"))
    return made


def part(macro: str, *values: Any, **named: Any) -> str:
    """Return the HTML of a macro of ``parts.html``."""
    made: str = getattr(_templates().get_template("parts.html").module, macro)(*values, **named)
    return made
