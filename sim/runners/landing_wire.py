"""MAVLink connection of a landing in one process: messages are passed as they would arrive, without bytes.

A float field has 32 bits on the wire. Only this rounding is applied here, because packing, checksums and
sockets change no number. Messages with strings or doubles, and frames changed by a link fault, are packed and
decoded completely.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any, cast

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.framing import split_frames
from bridge.mavlink.codec.messages import Message, decode
from bridge.mavlink.endpoint import Endpoint, Received
from bridge.mavlink.transport.address import Peer
from bridge.mavlink.transport.transport import EndpointCounters

PEER: Peer = ("in-process", 0)


_Round = Callable[[Message], None]
_Plan = _Round | bool  # True: only integers, passed unchanged; False: packed to bytes


def _plan(cls: Any) -> _Plan:
    """Return how messages of a class are passed."""
    # an array of length one arrives as a number
    if {"char", "double"} & set(cls.fieldtypes) or 1 in cls.array_lengths:
        return False
    length_of = dict(zip(cls.ordered_fieldnames, cls.array_lengths, strict=True))
    floats = [name for name, kind in zip(cls.fieldnames, cls.fieldtypes, strict=True) if kind == "float"]
    arrays = [name for name in cls.fieldnames if length_of[name]]
    return _rounding(floats, {name: length_of[name] for name in arrays}) if floats or arrays else True


def _rounding(floats: list[str], lengths: dict[str, int]) -> _Round:
    """Return a function that rounds attributes; generated code takes half as long as a loop over names.

    ``floats``: names of the 32-bit attributes; ``lengths``: lengths of arrays by name; arrays arrive as
    lists.
    """
    single = [name for name in floats if name not in lengths]
    wire = struct.Struct(f"<{len(single)}f")
    fields = "".join(f"message.{name}, " for name in single)
    scope: dict[str, Any] = {"pack": wire.pack, "unpack": wire.unpack, "pack_all": struct.pack}
    lines = [f"{fields}= unpack(pack({fields}))"] if single else []
    for name, length in lengths.items():
        values = f"message.{name}[:{length}]"
        if name in floats:
            scope[f"unpack_{name}"] = struct.Struct(f"<{length}f").unpack
            values = f"unpack_{name}(pack_all('<{length}f', *{values}))"
        lines.append(f"message.{name} = list({values})")
    body = "\n    ".join(lines)
    exec(f"def rounded(message):\n    {body}", scope)
    return cast(_Round, scope["rounded"])


_PLANS: dict[int, _Plan] = {id_: _plan(cls) for id_, cls in dialect.mavlink_map.items()}


class Inlet(Endpoint):
    """One end of the connection; it replaces a socket."""

    def __init__(self, system_id: int, component_id: int) -> None:
        self.tap = None
        self.counters = EndpointCounters()
        self.warnings = ()
        self.other: Inlet = self  # receiving end
        # called when this end waits: runs the other side
        self.answer: Callable[[], None] | None = None
        self._ids = (system_id, component_id)
        self._mav = dialect.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._arrived: list[Received] = []

    @property
    def peers(self) -> tuple[Peer, ...]:
        """Return the other end."""
        return (PEER,)

    def receive(self) -> list[Received]:
        """Return the messages that have arrived, in order."""
        arrived, self._arrived = self._arrived, []
        return arrived

    def send(self, messages: Sequence[Message], peer: Peer | None = None) -> None:
        """Pass messages to the other end; they may be changed."""
        del peer
        arrived = self.other._arrived
        for message in messages:
            header = message._header
            plan = _PLANS[header.msgId]
            if plan is False:
                self.repeat(self.pack(message))
                continue
            if plan is not True:
                plan(message)
            header.srcSystem, header.srcComponent = self._ids
            arrived.append(Received(message, b"", PEER))

    def repeat(self, frame: bytes, peer: Peer | None = None) -> None:
        """Pass a frame to the other end; a damaged frame is lost."""
        del peer
        for good in split_frames(frame):
            self.other._arrived.append(Received(decode(good), good, PEER))

    def wait(self, timeout_s: float) -> bool:
        """Run the other side now."""
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
