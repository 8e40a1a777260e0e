"""What the bridge says, as STATUSTEXT and on its terminal; bounded, whatever comes over the network."""

from __future__ import annotations

import math
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.decoding import Message

INFO, WARNING, CRITICAL = (
    dialect.MAV_SEVERITY_INFO, dialect.MAV_SEVERITY_WARNING, dialect.MAV_SEVERITY_CRITICAL,
)  # fmt: skip
_WAITING_MAX = 64
_SAME_GAP_S = 1.0  # s between two refusals of one topic; a wrong stream is wrong 100 times a second
_TOPICS_MAX = 32
_CHUNK = 50  # characters of one STATUSTEXT


class Text(NamedTuple):
    """Something a person should know."""

    severity: int  # MAV_SEVERITY
    text: str


class Texts:
    """Texts until somebody takes them."""

    def __init__(self) -> None:
        self._waiting: list[Text] = []
        self._said_s: dict[str, float] = {}

    def say(self, severity: int, text: str) -> None:
        """Tell of an event; more than 64 between two looks are not kept."""
        if len(self._waiting) < _WAITING_MAX:
            self._waiting.append(Text(severity, text))

    def refuse(self, text: str, now_s: float, topic: str = "") -> None:
        """Tell why something was refused, unless that was said in the last second."""
        topic = topic or text
        if now_s - self._said_s.get(topic, -math.inf) < _SAME_GAP_S:
            return
        if len(self._said_s) >= _TOPICS_MAX:
            del self._said_s[min(self._said_s, key=self._said_s.__getitem__)]
        self._said_s[topic] = now_s
        self.say(WARNING, text)

    def take(self) -> list[Text]:
        """What was said since the last call."""
        texts, self._waiting = self._waiting, []
        return texts


def statustexts(text: Text, chunk_id: int) -> list[Message]:
    """STATUSTEXT of one text, long ones in chunks of ``chunk_id`` (1 to 65535)."""
    raw = text.text.encode("ascii", "replace")
    if len(raw) <= _CHUNK:
        return [dialect.MAVLink_statustext_message(text.severity, raw)]
    return [  # a chunk shorter than 50 ends the text; a full last one is followed by an empty one
        dialect.MAVLink_statustext_message(text.severity, raw[at : at + _CHUNK], chunk_id, at // _CHUNK)
        for at in range(0, len(raw) + 1, _CHUNK)
    ]
