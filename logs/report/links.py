"""What the links delivered: messages, rates, losses and gaps, counted from the recorded traffic."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from logs.reader.flight import TARGET_TOPIC_END
from logs.reader.flight_data import Floats
from logs.reader.reader import LogFile
from logs.schema.codec_mavlink import FrameError, unpack_mavlink
from logs.schema.schemas import MAVLINK, ODOMETRY

POSITION = "vehicle position"
TARGET = "target odometry"
_SOURCE, _SINK = "/mavlink_source", "/mavlink_sink"
_SHOWN = {
    (_SOURCE, dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED): POSITION,
    (_SOURCE, dialect.MAVLINK_MSG_ID_HEARTBEAT): "vehicle heartbeat",
    (_SINK, dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED): "set-points sent",
}
_ALL = {_SOURCE: "vehicle, all MAVLink", _SINK: "onboard, all MAVLink"}
_V2 = 0xFD
_HALF = 128  # a sequence number this far ahead is one that comes late


@dataclass(frozen=True)
class Stream:
    """One kind of message on one link."""

    name: str
    t_s: Floats  # (n,) arrival times, as in the flight
    # messages missing from the sender's numbering; ``None`` where it does not number this kind
    lost: int | None

    @property
    def rate_hz(self) -> float | None:
        span_s = float(self.t_s[-1] - self.t_s[0]) if len(self.t_s) > 1 else 0.0
        return (len(self.t_s) - 1) / span_s if span_s > 0.0 else None

    @property
    def gap_max_s(self) -> float | None:
        return float(np.diff(self.t_s).max()) if len(self.t_s) > 1 else None


def load_streams(path: Path, origin_ns: int, member: str | None = None) -> list[Stream]:
    """Read the traffic of a log, up to its break; frames that are damaged are left out."""
    times: dict[str, list[int]] = defaultdict(list)
    numbers: dict[str, list[int]] = defaultdict(list)
    target: list[int] = []
    for message in LogFile(path, member).messages():
        if message.schema == ODOMETRY and message.topic.endswith(TARGET_TOPIC_END):
            times[TARGET].append(message.log_time_ns)
            target.append(message.sequence)
        elif message.schema == MAVLINK:
            side = next((end for end in _ALL if message.topic.endswith(end)), None)
            if side is not None:
                _frame(side, message.log_time_ns, message.data, times, numbers)
    lost = {_ALL[side]: missing_of_256(numbers[side]) for side in _ALL}
    lost[TARGET] = missing(target)
    order = (*_ALL.values(), *_SHOWN.values(), TARGET)
    return [
        Stream(name, np.asarray((np.array(times[name]) - origin_ns) * 1e-9, np.float64), lost.get(name))
        for name in order
        if name in times
    ]


def _frame(
    side: str, at_ns: int, data: bytes, times: dict[str, list[int]], numbers: dict[str, list[int]]
) -> None:
    try:
        _, frame = unpack_mavlink(data)
    except (FrameError, struct.error):
        return
    version_2 = frame[0] == _V2
    message_id = int.from_bytes(frame[7:10], "little") if version_2 else frame[5]
    numbers[side].append(frame[4] if version_2 else frame[2])
    times[_ALL[side]].append(at_ns)
    name = _SHOWN.get((side, message_id))
    if name is not None:
        times[name].append(at_ns)


def missing(numbers: Sequence[int]) -> int | None:
    """Numbers between the first and the last that never arrived; ``None`` if the sender does not count."""
    if not numbers or max(numbers) == 0:
        return None
    return max(numbers) - min(numbers) + 1 - len(set(numbers))


def missing_of_256(numbers: Sequence[int]) -> int | None:
    """As ``missing`` for MAVLink's numbers, which wrap after 255; late messages are not lost."""
    if not numbers:
        return None
    lost, last = 0, numbers[0]
    for number in numbers[1:]:
        ahead = (number - last) & 0xFF
        if 0 < ahead < _HALF:
            lost += ahead - 1
            last = number
        elif ahead >= _HALF:
            lost = max(0, lost - 1)
    return lost
