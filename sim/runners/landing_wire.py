"""MAVLink connection of a landing in one process: messages are passed as they would arrive, without bytes.

A float field has 32 bits on the wire. Messages get only this rounding, because headers, checksums and sockets
change no value. Messages with arrays or strings, and frames that a link fault changed, are packed and decoded
completely.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.framing import split_frames
from bridge.mavlink.codec.messages import MESSAGES, Message, decode, message_id
from bridge.mavlink.endpoint import Endpoint, Received
from bridge.mavlink.transport.address import Peer

PEER: Peer = ("in-process", 0)


_Round = Callable[[Message], None]


def _rounding(cls: Any) -> _Round | None:
    """Return a function that rounds the fields of a message; None: pack and decode the whole message."""
    names, wire = cls.ordered_fieldnames, cls.unpacker
    if any(cls.array_lengths) or "char" in cls.fieldtypes or len(names) < 2:
        return None
    read, pack, unpack = itemgetter(*names), wire.pack, wire.unpack

    def rounded(message: Message) -> None:
        fields: dict[str, Any] = message.__dict__
        fields.update(zip(names, unpack(pack(*read(fields))), strict=True))

    return rounded


_ROUNDINGS: dict[int, _Round | None] = {id_: _rounding(cls) for id_, cls in dialect.mavlink_map.items()}


class Inlet(Endpoint):
    """One end of the connection; it replaces a socket."""

    def __init__(self, system_id: int, component_id: int) -> None:
        self.tap = None
        self.counters = Counter()
        self.warnings = ()
        self.other: Inlet = self  # the other end; it receives the messages that this end sends
        # function that runs the other side; called when this end waits
        self.answer: Callable[[], None] | None = None
        self._ids = (system_id, component_id)
        self._mav = dialect.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._arrived: list[Received] = []

    @property
    def peers(self) -> tuple[Peer, ...]:
        """Peers of this end: only the other end of the pair."""
        return (PEER,)

    def receive(self) -> list[Received]:
        """Return the messages that have arrived, in order."""
        arrived, self._arrived = self._arrived, []
        return arrived

    def send(self, messages: Sequence[Message], peer: Peer | None = None) -> None:
        """Pass messages to the other end; this may change the messages."""
        del peer
        arrived = self.other._arrived
        for message in messages:
            header = message._header
            rounded = _ROUNDINGS[header.msgId]
            if rounded is None:
                self.repeat(self.pack(message))
                continue
            rounded(message)
            header.srcSystem, header.srcComponent = self._ids
            arrived.append(Received(message, PEER))

    def repeat(self, frame: bytes, peer: Peer | None = None) -> None:
        """Pass a packed frame to the other end; a damaged frame is lost."""
        del peer
        for good in split_frames(frame):
            if message_id(good) in MESSAGES:
                self.other._arrived.append(Received(decode(good), PEER))

    def wait(self, timeout_s: float) -> bool:
        """Let the other end run, instead of waiting; return whether messages have arrived."""
        del timeout_s
        if self.answer is not None:
            self.answer()
        return bool(self._arrived)

    def close(self) -> None:
        """Do nothing; there is no socket."""


def wires(vehicle: tuple[int, int], companion: tuple[int, int]) -> tuple[Inlet, Inlet]:
    """Return both ends of a connection, each for a system id and component id."""
    here, there = Inlet(*vehicle), Inlet(*companion)
    here.other, there.other = there, here
    return here, there
