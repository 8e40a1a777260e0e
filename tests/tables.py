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

import msgspec
from pymavlink.dialects.v20 import all as everything
from pymavlink.dialects.v20 import ardupilotmega

from bridge.mavlink.codec.messages import Definition, WideField, definitions

MESSAGES = Path(__file__).parents[1] / "bridge" / "mavlink" / "codec" / "wide_messages.json"
_ABOUT = (
    "MAVLink messages that pymavlink's dialect ardupilotmega lacks: id, name, CRC_EXTRA, fields (type, name, "
    "array length, extension). Sources: pymavlink's dialect all; MAVLink's common.xml for those that no "
    "dialect of pymavlink has. Renewed by: python -m tests.tables messages"
)


def crc_extra(definition: Definition) -> int:
    """Return CRC_EXTRA, the checksum of a message's field names and types (MAVLink serialization guide)."""
    text = f"{definition.name} ".encode()
    for field in definition.on_the_wire:
        if not field.extension:
            text += f"{field.kind} {field.name} ".encode() + bytes([field.array] if field.array else [])
    crc: int = ardupilotmega.x25crc(text).crc
    return (crc & 0xFF) ^ (crc >> 8)


def read_class(cls: Any) -> Definition:
    """Read one of pymavlink's classes; CRC_EXTRA, which excludes extensions, identifies their fields.

    Raises ValueError: no number of extensions gives the CRC_EXTRA.
    """
    kinds = dict(zip(cls.fieldnames, cls.fieldtypes, strict=True))
    arrays = dict(zip(cls.ordered_fieldnames, cls.array_lengths, strict=True))
    for extensions in range(len(cls.ordered_fieldnames)):
        behind = cls.ordered_fieldnames[len(cls.ordered_fieldnames) - extensions :]
        fields = tuple(WideField(kinds[n], n, arrays[n], n in behind) for n in cls.fieldnames)
        made = Definition(cls.id, cls.msgname, cls.crc_extra, fields)
        if crc_extra(made) == cls.crc_extra:
            return made
    raise ValueError(f"{cls.msgname}: CRC_EXTRA {cls.crc_extra} does not fit its fields")


def messages_table() -> str:
    """Return the text of the file: messages of pymavlink are generated again, others are unchanged."""
    table = {d.id: d for d in definitions()}  # a part of ardupilotmega.mavlink_map, too
    narrow = ardupilotmega.mavlink_map.keys() - table.keys()
    wide = {id_: cls for id_, cls in everything.mavlink_map.items() if id_ not in narrow}
    made = {id_: d for id_, d in table.items() if id_ not in everything.mavlink_map}
    made.update({id_: read_class(cls) for id_, cls in wide.items()})
    rows = ",\n".join(json.dumps(msgspec.to_builtins(made[id_])) for id_ in sorted(made))
    return f'{{"about": {json.dumps(_ABOUT)},\n"messages": [\n{rows}\n]}}\n'


EVENTS = Path(__file__).parents[1] / "bridge" / "mavlink" / "client" / "px4_events.json"
_SOURCE = "PX4 Autopilot v1.16.0, all_events.json; BSD 3-Clause, see px4_events.LICENSE.txt"


def events_table(metadata: Path, source: str = _SOURCE) -> str:
    """Return the text of the file: message and argument types of each event, and texts of each enumeration.

    ``metadata``: all_events.json, or the same file compressed by xz; ``source``: release and licence of that
    file, which the result contains.
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
