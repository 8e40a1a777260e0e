"""Makes ``bridge/mavlink/client/px4_events.json`` from the events of a PX4 build (all_events.json.xz)."""

from __future__ import annotations

import json
import lzma
from pathlib import Path
from typing import Any

FILE = Path(__file__).parents[2] / "bridge" / "mavlink" / "client" / "px4_events.json"
_SOURCE = "PX4 Autopilot v1.16.0, all_events.json; BSD 3-Clause, see px4_events.LICENSE.txt"


def table(metadata: Path, source: str = _SOURCE) -> str:
    """The whole file: each event's message and types of its arguments, each enumeration's words.

    Args:
        metadata: all_events.json, or that compressed by xz.
        source: what it was made from.
    """
    raw = metadata.read_bytes()
    read: dict[str, Any] = json.loads(lzma.decompress(raw) if metadata.suffix == ".xz" else raw)
    events, enums = {}, {}
    for component, part in read["components"].items():
        for group in part["event_groups"].values():
            for id_, event in group["events"].items():
                kinds = [argument["type"].split("::")[-1] for argument in event.get("arguments", ())]
                events[int(component) << 24 | int(id_)] = [event["message"], *kinds]
        for name, enum in part["enums"].items():
            words = {value: entry["description"] for value, entry in enum["entries"].items()}
            enums[name] = [enum["type"], enum.get("is_bitfield", False), words]
    head = f'{{\n"source": {json.dumps(source)},\n'
    return head + f'"events": {_lines(events)},\n"enums": {_lines(enums)}\n}}\n'


def _lines(entries: dict[Any, Any]) -> str:
    rows = [f"{json.dumps(str(key))}: {json.dumps(entries[key])}" for key in sorted(entries)]
    return "{\n" + ",\n".join(rows) + "\n}"
