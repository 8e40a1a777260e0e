"""The two moves of writing CDR piece by piece, for messages of varying length."""

from __future__ import annotations

import struct


def align(out: bytearray, size: int) -> None:
    """Pad the body so far, without its encapsulation, to a multiple of ``size``."""
    out += bytes(-len(out) % size)


def string(out: bytearray, text: str) -> None:
    """Append a string: length with its zero, then both."""
    align(out, 4)
    raw = text.encode() + b"\x00"
    out += struct.pack("<I", len(raw))
    out += raw
