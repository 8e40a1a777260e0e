"""Layouts for landings, as files for Foxglove and PlotJuggler; needs no viewer's package."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path

from logs.reader.reader import LogFile
from logs.tools.file import new_file

NAMES = ("foxglove.json", "plotjuggler.xml")
SHIPPED_NAMESPACE = "cf1"  # namespace of the files in this package


def layout(name: str, namespace: str = SHIPPED_NAMESPACE) -> str:
    """Return the text of one of ``NAMES`` for a vehicle with another name space."""
    text = (files("logs.view") / "layouts" / name).read_text(encoding="utf-8")
    return text.replace(f"/{SHIPPED_NAMESPACE}/", f"/{namespace}/")


def write_layouts(log: Path, folder: Path, member: str | None = None, *, force: bool = False) -> list[Path]:
    """Write all layouts for a log; for a fleet one of each kind per member."""
    opened = LogFile(log, member)
    members = opened.members or ((member,) if member is not None else ())
    spaces = {f"_{each}": each for each in members}
    if not spaces:
        space = opened.metadata().get("onboard", {}).get("namespace", SHIPPED_NAMESPACE).strip("/")
        if not re.fullmatch(r"[A-Za-z0-9_./-]+", space):  # the name becomes a part of XML and JSON
            raise ValueError(f"{log}: found a namespace {space!r}; allowed are A-Z a-z 0-9 _ . / -")
        spaces = {"": space}
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for of_member, space in spaces.items():
        for name in NAMES:
            place = (folder / name).with_stem(f"{Path(name).stem}{of_member}")
            text = layout(name, space)
            if of_member:  # in a fleet each member has its own frame
                text = text.replace('"frame:target_pad"', f'"frame:{space}/target_pad"')
            with new_file(place, force=force) as part:
                part.write_text(text, encoding="utf-8")
            written.append(place)
    return written
