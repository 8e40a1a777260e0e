"""Layouts made for landings, as files for Foxglove and PlotJuggler; needs no viewer's package."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from logs.reader.reader import LogFile
from logs.tools.file import new_file

NAMES = ("foxglove.json", "plotjuggler.xml")
SHIPPED_NAMESPACE = "cf1"  # of the files in this package


def layout(name: str, namespace: str = SHIPPED_NAMESPACE) -> str:
    """Return the text of one of ``NAMES`` for a vehicle of another name space."""
    text = (files("logs.view") / "layouts" / name).read_text(encoding="utf-8")
    return text.replace(f"/{SHIPPED_NAMESPACE}/", f"/{namespace}/")


def write_layouts(log: Path, folder: Path, *, force: bool = False) -> list[Path]:
    """Write all layouts for a log.

    Args:
        log: a flight log; its name space is in the metadata of the onboard process.
        folder: made if it does not exist.
        force: replace files that exist.

    Raises:
        LogError: Not a log.
        ValueError: A file exists.
    """
    namespace = LogFile(log).metadata().get("onboard", {}).get("namespace", SHIPPED_NAMESPACE)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name in NAMES:
        path = folder / name
        with new_file(path, force=force) as part:
            part.write_text(layout(name, namespace.strip("/")), encoding="utf-8")
        written.append(path)
    return written
