"""Generates the packaged tables that come from other projects.

``python -m tests.tables messages``: ``bridge/mavlink/codec/wide_messages.json`` from the installed pymavlink.
``python -m tests.tables px4_events FILE``: ``bridge/mavlink/client/px4_events.json`` from the events of a PX4
build (all_events.json.xz).
"""

from __future__ import annotations

import json
import lzma
import sys
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import all as everything
from pymavlink.dialects.v20 import ardupilotmega

from bridge.mavlink.codec.messages import wide_rows

MESSAGES = Path(__file__).parents[1] / "bridge" / "mavlink" / "codec" / "wide_messages.json"
_ABOUT = (
    "MAVLink messages that pymavlink's dialect ardupilotmega lacks, as attributes of pymavlink's classes. "
    "Sources: pymavlink's dialect all; MAVLink's common.xml for those that no dialect of pymavlink has. "
    "Renewed by: python -m tests.tables messages"
)
_ATTRIBUTES = ("id", "msgname", "crc_extra", "fieldnames", "fieldtypes", "ordered_fieldnames", "lengths",
               "array_lengths")  # fmt: skip


def messages_table() -> str:
    """Return the table of messages as text; only the messages of pymavlink are generated again."""
    table = {row["id"]: row for row in wide_rows()}  # the bridge adds these messages to ardupilotmega, too
    made = {id_: row for id_, row in table.items() if id_ not in everything.mavlink_map}
    for id_ in everything.mavlink_map.keys() - (ardupilotmega.mavlink_map.keys() - table.keys()):
        cls = everything.mavlink_map[id_]
        made[id_] = {**{name: getattr(cls, name) for name in _ATTRIBUTES}, "format": cls.unpacker.format}
    rows = ",\n".join(json.dumps(made[id_]) for id_ in sorted(made))
    return f'{{"about": {json.dumps(_ABOUT)},\n"messages": [\n{rows}\n]}}\n'


EVENTS = Path(__file__).parents[1] / "bridge" / "mavlink" / "client" / "px4_events.json"
_SOURCE = "PX4 Autopilot v1.16.0, all_events.json; BSD 3-Clause, see px4_events.LICENSE.txt"


def events_table(metadata: Path, source: str = _SOURCE) -> str:
    """Return the table of events as text: message and argument types of events, texts of enumerations.

    ``metadata``: all_events.json, or the same file compressed by xz; ``source``: release and licence of this
    file, which are written to the table.
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


def main(arguments: list[str]) -> int:
    """Write the named table; invalid arguments end with status 2."""
    match arguments:
        case ["messages"]:
            MESSAGES.write_text(messages_table(), encoding="ascii")
        case ["px4_events", file]:
            EVENTS.write_text(events_table(Path(file)), encoding="ascii")
        case _:
            print(__doc__, file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
