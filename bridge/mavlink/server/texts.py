"""STATUSTEXT of a vehicle: events and reasons of refusals, limited in number and rate."""

from __future__ import annotations

import math
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message

_CHUNK = 50  # characters of one STATUSTEXT
_WAITING_MAX = 64  # greatest number of texts between two ticks
_SAME_GAP_S = (
    1.0  # time between two refusals on one topic, s; a wrong stream repeats its error 100 times a second
)
_BURST = 20  # refusals on different topics in a row; a ground station sends a dozen requests at its start
_PER_S = 5.0  # rate of further refusals, 1/s
_TOPICS_MAX = 64


class Text(NamedTuple):
    severity: int  # severity number of MAVLink (MAV_SEVERITY)
    text: str


class Texts:
    """Texts that wait to be sent: at most 64 events, and refusals at a limited rate."""

    def __init__(self) -> None:
        self.waiting: list[Text] = []  # texts that wait to be sent
        self._said_s: dict[str, float] = {}
        self._credit = float(_BURST)
        self._credit_s = -math.inf
        self._hidden = 0
        self._id = 0  # id of the newest text in chunks

    def say(self, severity: int, text: str) -> None:
        if len(self.waiting) < _WAITING_MAX:
            self.waiting.append(Text(severity, text))

    def refuse(
        self, text: str, now_s: float, topic: str = "", severity: int = dialect.MAV_SEVERITY_WARNING
    ) -> None:
        """Add the reason of a refusal, unless the same one was added in the last second.

        Refusals with the same ``topic`` count as equal; without a topic the text is used.
        """
        topic = topic or text
        if now_s - self._said_s.get(topic, -math.inf) < _SAME_GAP_S:
            return
        self._credit = min(_BURST, self._credit + max(0.0, now_s - self._credit_s) * _PER_S)
        self._credit_s = now_s
        if self._credit < 1.0:
            self._hidden += 1
            return
        self._credit -= 1.0
        if self._hidden:
            self.say(dialect.MAV_SEVERITY_WARNING, f"{self._hidden} refusals not shown")
            self._hidden = 0
        if len(self._said_s) >= _TOPICS_MAX:
            del self._said_s[min(self._said_s, key=self._said_s.__getitem__)]
        self._said_s[topic] = now_s
        self.say(severity, text)

    def take(self) -> list[Text]:
        texts, self.waiting = self.waiting, []
        return texts

    def messages(self, text: Text) -> list[Message]:
        """Convert a text into STATUSTEXT, a long one in chunks."""
        raw = text.text.encode("ascii", "replace")
        if len(raw) <= _CHUNK:
            return [dialect.MAVLink_statustext_message(text.severity, raw)]
        self._id = self._id % 0xFFFF + 1  # 0 means "not in chunks"
        # A chunk shorter than 50 ends the text; an empty chunk follows a full last one.
        return [
            dialect.MAVLink_statustext_message(text.severity, raw[at : at + _CHUNK], self._id, at // _CHUNK)
            for at in range(0, len(raw) + 1, _CHUNK)
        ]
