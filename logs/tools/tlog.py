"""MAVLink telemetry logs: each raw frame behind its time, as ground stations and pymavlink keep them.

Layout: eight bytes, big-endian, microseconds since 1970, then the frame. MAVProxy keeps the number of the
link in the two low bits of the time, 3 for frames it sent itself (MAVProxy mavproxy_link.py); so does this.
"""

from __future__ import annotations

from pathlib import Path

from logs.reader.reader import LogFile
from logs.schema.codec_mavlink import FrameError, unpack_mavlink
from logs.schema.schemas import MAVLINK
from logs.tools.file import new_file

RECEIVED, SENT = 0, 3  # low bits of the time
SENT_SUFFIX = "_sink"  # MAVROS: mavlink_sink is what goes to the vehicle


def export_tlog(log: LogFile, out: Path, *, topic: str | None = None, force: bool = False) -> int:
    """Write the recorded frames of both directions, or of one topic; return their number.

    Raises:
        ValueError: The log holds no MAVLink frame, or one that contradicts itself.
        OSError: ``out`` exists, or cannot be written.
    """
    frames = 0
    with new_file(out, force=force) as part:
        with part.open("wb") as stream:
            for message in log.messages(None if topic is None else [topic]):
                if message.schema != MAVLINK:
                    continue
                try:
                    _, frame = unpack_mavlink(message.data)
                except FrameError as error:
                    raise ValueError(f"{message.topic}, sequence {message.sequence}: {error}") from error
                direction = SENT if message.topic.endswith(SENT_SUFFIX) else RECEIVED
                time_us = message.log_time_ns // 1000 & ~3 | direction
                stream.write(time_us.to_bytes(8, "big") + frame)
                frames += 1
        if not frames:
            where = f"topic {topic}" if topic else "it"
            raise ValueError(f"{log.path}: {where} holds no MAVLink frame ({MAVLINK}); see `log info`")
    return frames
