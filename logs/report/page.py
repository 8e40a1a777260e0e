"""A page of ours around any content: look, drawing library, time axes that move together; no network needed.

For other pages of this look, as a campaign's: ``page("Title", body)`` with sections made by ``section`` and
tables by ``report_tables.table``.
"""

from __future__ import annotations

import base64
import gzip
from functools import cache
from html import escape
from importlib.resources import files

_LEVEL = 9  # of gzip; the library is packed once a process


class ReportError(RuntimeError):
    """The page cannot be made here; says what is missing."""


def page(title: str, body: str) -> str:
    """Return a whole page.

    Args:
        title: plain text.
        body: HTML, made of ``header``, ``section`` and the like.
    """
    parts = (files("logs.report") / "report_template.html").read_text(encoding="utf-8").split("@@")
    values = {"TITLE": escape(title), "BODY": body, "PLOTLY": plotly_source()}
    parts[1::2] = [values[name] for name in parts[1::2]]  # text, NAME, text, NAME, ..., text
    return "".join(parts)


def header(title: str, badge: str, style: str, sub: str) -> str:
    """Title with a badge (``style`` good, fair or bad) and a line below; all plain text."""
    return (
        f'<header><h1>{escape(title)}</h1><span class="badge {style}">{escape(badge)}</span></header>'
        f'<p class="sub">{escape(sub)}</p>'
    )


def section(key: str, title: str, paper: str, note: str, figure: object | None) -> str:
    """One figure with its title and note, as HTML; a figure that could not be drawn says so."""
    reference = f'<span class="paper">paper {escape(paper)}</span>' if paper else ""
    body = ""
    if figure is not None:
        # a "<" in a name could end the script element
        data = figure.to_json().replace("<", "\\u003c")  # type: ignore[attr-defined]
        body = (
            f'<div class="figure" id="figure-{key}"></div>'
            f'<script type="application/json" id="figure-{key}-data">{data}</script>'
        )
    note = note if figure is not None else f"Not drawn: the log has no usable data for this figure. {note}"
    return (
        f'<section id="{key}"><h2>{escape(title)}{reference}</h2><p class="note">{escape(note)}</p>'
        f"{body}</section>\n"
    )


def details(title: str, text: str, name: str = "") -> str:
    """Long text that opens on demand; with a file ``name`` it can be saved."""
    save = ""
    if name:
        data = base64.b64encode(text.encode()).decode("ascii")
        save = (
            f'<p><a download="{escape(name, quote=True)}" href="data:application/octet-stream;base64,{data}">'
            f"Save as {escape(name)}</a></p>"
        )
    return f"<details><summary>{escape(title)}</summary>{save}<pre>{escape(text)}</pre></details>"


def need_plotly() -> None:
    """Check that figures can be drawn.

    Raises:
        ReportError: the plotting library is not installed.
    """
    try:
        import plotly.graph_objects  # noqa: F401
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith("plotly"):
            raise
        raise ReportError(
            'the page needs plotly, which is not installed: pip install "crazyflie-flightstack[report]"'
        ) from error


@cache
def plotly_source() -> str:
    """The drawing library, packed: gzip in base64, a third of its size; the page unpacks it."""
    packed = gzip.compress((files("plotly") / "package_data" / "plotly.min.js").read_bytes(), _LEVEL, mtime=0)
    return base64.b64encode(packed).decode("ascii")
