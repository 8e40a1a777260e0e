"""Puts STATUSTEXT messages together again: long texts travel in chunks."""

from __future__ import annotations

from bridge.mavlink.codec.decoding import Message

_CHUNK = 50  # characters a message holds; a chunk with fewer is the last
_CHUNKS_MAX = 16  # longest text taken: 800 characters


class TextAssembler:
    """Collects the chunks of one text at a time, as PX4 sends them."""

    def __init__(self) -> None:
        self._id = 0
        self._severity = 0
        self._next = 0
        self._parts: list[str] = []

    def add(self, message: Message) -> list[tuple[int, str]]:
        """Take one STATUSTEXT; return the texts (severity, text) that it completes.

        A text whose chunks stop coming is given out, marked with an ellipsis, when the next one starts.
        """
        texts: list[tuple[int, str]] = []
        if self._parts and (message.id != self._id or message.chunk_seq != self._next):
            texts.append(self._take(" ..."))
        if message.id == 0 and not self._parts:
            return [*texts, (message.severity, clean(message.text))]
        self._id, self._severity, self._next = message.id, message.severity, message.chunk_seq + 1
        self._parts.append(message.text)
        if len(message.text) < _CHUNK or len(self._parts) == _CHUNKS_MAX:
            texts.append(self._take(""))
        return texts

    def _take(self, mark: str) -> tuple[int, str]:
        text = clean("".join(self._parts)) + mark
        self._parts = []
        return (self._severity, text)


def clean(text: str) -> str:
    """Printable characters only: the text goes to terminals and logs, and comes from the network."""
    return "".join(c if c.isprintable() else " " for c in text).strip()
