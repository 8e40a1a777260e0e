"""Layouts for landings, as files for Foxglove and PlotJuggler; needs no viewer's package."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from logs.reader.reader import LogFile
from logs.tools.file import new_file

FOXGLOVE = "foxglove.json"
NAMES = (FOXGLOVE, "plotjuggler.xml")
_OF_TARGET = frozenset({"frame:target", "frame:target_pad"})  # frames of each member in a fleet
SHIPPED_NAMESPACE = "cf1"  # namespace of the files in this package


def layout(name: str, namespace: str = SHIPPED_NAMESPACE) -> str:
    """Return the text of one of ``NAMES`` for a vehicle with another name space."""
    text = (files("logs.view") / "layouts" / name).read_text(encoding="utf-8")
    return text.replace(f"/{SHIPPED_NAMESPACE}/", f"/{namespace}/")


def fleet_layout(name: str, namespace: str, members: Sequence[str]) -> str:
    """Return a layout file: the curves of one member, and the scene of the whole fleet."""
    text = layout(name, namespace)
    if name != FOXGLOVE:
        return text
    whole = json.loads(text)
    scene = whole["configById"]["3D!scene"]
    own, frames = scene["topics"], scene["transforms"]
    shared = {frame: shown for frame, shown in frames.items() if frame not in _OF_TARGET}
    scene["topics"] = {
        topic.replace(f"/{namespace}/", f"/{each}/", 1): shown
        for each in members
        for topic, shown in own.items()
    }
    scene["transforms"] = shared | {
        frame.replace("frame:", f"frame:{each}/"): shown
        for each in members
        for frame, shown in frames.items()
        if frame in _OF_TARGET
    }
    return json.dumps(whole, indent=2)


def write_layouts(log: Path, folder: Path, member: str | None = None, *, force: bool = False) -> list[Path]:
    """Write all layouts for a log; for a fleet one per member, each with all members in the scene."""
    opened, members = LogFile(log, member), LogFile(log).members
    folder.mkdir(parents=True, exist_ok=True)
    texts: dict[str, str] = {}
    if members:
        for each in opened.members or (member or "",):
            for name in NAMES:
                stem, dot, ending = name.partition(".")
                texts[f"{stem}_{each}{dot}{ending}"] = fleet_layout(name, each, members)
    else:
        space = opened.metadata().get("onboard", {}).get("namespace", SHIPPED_NAMESPACE).strip("/")
        if not re.fullmatch(r"[A-Za-z0-9_./-]+", space):  # the name becomes a part of XML and JSON
            raise ValueError(f"{log}: found a namespace {space!r}; allowed are A-Z a-z 0-9 _ . / -")
        texts = {name: layout(name, space) for name in NAMES}
    written = []
    for name, text in texts.items():
        with new_file(folder / name, force=force) as part:
            part.write_text(text, encoding="utf-8")
        written.append(folder / name)
    return written
