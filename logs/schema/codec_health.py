"""``Health.msg`` as CDR, and back."""

from __future__ import annotations

import struct
from typing import NamedTuple

from logs.schema.codec import CDR_HEADER

_NS = 1_000_000_000  # nanoseconds in a second
_MAP = b"map\x00"
_HEAD = struct.Struct("<4siII4sQ5d8B4II")  # to the length of the text; every field lies on its own alignment


class HealthRow(NamedTuple):
    """Fields, units and constants as in ``Health.msg``."""

    stamp_ns: int
    tick: int
    own_age_s: float
    target_age_s: float
    link_age_s: float
    battery_v: float
    battery_share: float
    mode: int
    landed: int
    armed: bool
    ready_to_arm: bool
    own_valid: bool
    target_valid: bool
    link_valid: bool
    finished: bool
    target_accepted: int
    target_rejected: int
    overruns: int
    feed_dropped: int
    reason: str


def pack_health(row: HealthRow) -> bytes:
    """Return the health as CDR.

    Raises:
        struct.error: A number out of the range of its field.
    """
    text = row.reason.encode() + b"\x00"
    head = _HEAD.pack(CDR_HEADER, row[0] // _NS, row[0] % _NS, len(_MAP), _MAP, *row[1:-1], len(text))
    return head + text


def unpack_health(data: bytes) -> HealthRow:
    """Return the health in a CDR payload of :func:`pack_health`.

    Raises:
        ValueError: Cut short, another encoding, or a frame other than "map".
    """
    if len(data) <= _HEAD.size or data[:4] != CDR_HEADER or data[12:20] != b"\x04\x00\x00\x00" + _MAP:
        raise ValueError(f"not a Health of this stack: {len(data)} bytes beginning with {data[:20].hex()}")
    f = _HEAD.unpack_from(data)
    text = data[_HEAD.size : _HEAD.size + f[-1]]
    if len(text) != f[-1] or not text.endswith(b"\x00"):
        raise ValueError(f"Health: a text of {f[-1]} bytes is cut short after {len(text)}")
    flags = [bool(value) for value in f[13:19]]
    stamp_ns = f[1] * _NS + f[2]
    return HealthRow._make((stamp_ns, *f[5:13], *flags, *f[19:23], text[:-1].decode(errors="replace")))
