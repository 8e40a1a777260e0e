"""The attachment rmw_zenoh puts on every sample: sequence number, source time, publisher id.

Written in one form only, the 33 bytes of rmw_zenoh since 0.2.4; a malformed one makes ROS 2 nodes abort.
Read in two: the 77 bytes of 0.2.0 to 0.2.3 carry the same values behind field names.
"""

from __future__ import annotations

import struct

GID_BYTES = 16
_NEW = struct.Struct("<qqB16s")  # the byte is the length of the id (attachment_helpers.cpp)
_OLD = struct.Struct("<16sq17sq11sB16s")
_OLD_NAMES = (b"\x0fsequence_number", b"\x10source_timestamp", b"\x0asource_gid")


def pack_attachment(sequence: int, source_time_ns: int, gid: bytes) -> bytes:
    """Make the 33-byte attachment.

    Args:
        sequence: number of the sample, from 1.
        source_time_ns: when it was sent, Unix time.
        gid: 16 bytes that no other publisher has.

    Raises:
        ValueError: ``gid`` has another length.
    """
    if len(gid) != GID_BYTES:
        raise ValueError(f"publisher id has {len(gid)} bytes: rmw_zenoh needs {GID_BYTES}")
    return _NEW.pack(sequence, source_time_ns, GID_BYTES, gid)


def parse_attachment(data: bytes | None) -> tuple[int, int] | None:
    """Return sequence number and source time in Unix nanoseconds; None if absent or of another form."""
    if data is None:
        return None
    if len(data) == _NEW.size:
        sequence, source_time_ns, length, _ = _NEW.unpack(data)
        return (sequence, source_time_ns) if length == GID_BYTES else None
    if len(data) == _OLD.size:
        name_1, sequence, name_2, source_time_ns, name_3, length, _ = _OLD.unpack(data)
        if (name_1, name_2, name_3) == _OLD_NAMES and length == GID_BYTES:
            return (sequence, source_time_ns)
    return None
