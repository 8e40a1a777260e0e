"""MAVLink's messages as pymavlink's classes, and their decoding from checked MAVLink 2 frames.

``wide_messages.json`` holds messages that pymavlink's dialect ``ardupilotmega`` lacks: those of the dialect
``all`` (which takes 0.6 s to load), and messages of MAVLink's ``common`` that PX4 sends and pymavlink lacks.
``python -m tests.tables messages`` updates the first group and keeps the second.

The messages are added to pymavlink's table, so its parser decodes them.
"""

from __future__ import annotations

import struct
from importlib.resources import files
from typing import Any

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as dialect


def _make_class(row: dict[str, Any]) -> Any:
    """Make a message class like pymavlink's generated classes from a row of the table."""
    names = row["fieldnames"]
    texts = {name for name, kind in zip(names, row["fieldtypes"], strict=True) if kind == "char"}

    def init(self: Any, *values: Any) -> None:
        dialect.MAVLink_message.__init__(self, row["id"], row["msgname"])
        self._fieldnames = names
        for name, value in zip(names, values, strict=True):
            setattr(self, name, value)
            if name in texts:
                setattr(self, f"_{name}_raw", value)
                setattr(self, name, value.split(b"\x00", 1)[0].decode("ascii", errors="replace"))

    def pack(self: Any, mav: Any, force_mavlink1: bool = False) -> bytes:
        values: list[Any] = []
        for name, length in zip(row["ordered_fieldnames"], row["lengths"], strict=True):
            value = getattr(self, f"_{name}_raw" if name in texts else name)
            values += value[:length] if length > 1 else [value]
        payload = made["unpacker"].pack(*values)
        return bytes(self._pack(mav, row["crc_extra"], payload, force_mavlink1))

    orders = [row["ordered_fieldnames"].index(name) for name in names]
    made = {**row, "__init__": init, "pack": pack, "orders": orders, "unpacker": struct.Struct(row["format"])}
    return type(f"MAVLink_{row['msgname'].lower()}_message", (dialect.MAVLink_message,), made)


def wide_rows() -> list[dict[str, Any]]:
    """Return the table: attributes of classes in ascending order of id, and the format for ``struct``."""
    data = files("bridge.mavlink.codec").joinpath("wide_messages.json").read_bytes()
    rows: list[dict[str, Any]] = msgspec.json.decode(data)["messages"]
    return rows


# Classes of all known messages by id: pymavlink's, then those of ``wide_messages.json``.
MESSAGES: dict[int, Any] = dialect.mavlink_map
MESSAGES.update({row["id"]: _make_class(row) for row in wide_rows()})

# CRC_EXTRA of every known message: the checksum also covers the message's definition.
CRC_EXTRA: dict[int, bytes] = {id_: bytes([cls.crc_extra]) for id_, cls in MESSAGES.items()}
# CRC-16/MCRF4XX by the package fastcrc; if fastcrc is not available, by pymavlink's slow class.
checksum = dialect.mcrf4xx or (lambda data: dialect.x25crc(data).crc)

Message = Any  # an instance of one of pymavlink's generated classes, which have no type hints


def message_id(frame: bytes) -> int:
    return frame[7] | frame[8] << 8 | frame[9] << 16


def decode(frame: bytes) -> Message:
    """Decode one frame of ``split_frames``. Raises the error of a message class that rejects its values."""
    return _DECODER.decode(bytearray(frame))


_DECODER = dialect.MAVLink(None)
