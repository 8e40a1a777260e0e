"""What carries the bytes of a MAVLink endpoint: UDP datagrams, a serial line or a TCP connection."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from bridge.mavlink.transport.address import Peer


class Chunk(NamedTuple):
    """Bytes that arrived together."""

    data: bytes
    peer: Peer


class LineCounters(Protocol):
    """Counts that a transport keeps."""

    bytes_in: int
    bytes_out: int
    send_errors: int
    oversize: int
    outgoing_full: int
    connections_lost: int


class Transport(Protocol):
    """One way to the other side. Nothing of it ever blocks but ``wait``, and that is bounded.

    Attributes:
        local_port: UDP or TCP port of ours; 0 where there is none.
        baud: bits a second of a serial line, None where the speed is not known.
        is_stream: chunks are pieces of one stream, cut anywhere; else each stands alone.
    """

    local_port: int
    baud: int | None
    is_stream: bool

    def receive(self) -> Chunk | None:
        """Take the next bytes; None when there are none now. Never raises."""

    def send(self, frames: Sequence[bytes], peer: Peer) -> None:
        """Send whole frames, in order; what does not go is dropped whole and counted. Never raises."""

    def wait(self, timeout_s: float) -> bool:
        """Wait until there is something to receive; False when nothing came in ``timeout_s``."""

    def fileno(self) -> int:
        """Descriptor that becomes readable when something can be received; it may change after a loss."""

    def take_notices(self) -> list[str]:
        """Texts about the connection since the last call: lost, found again."""

    def close(self) -> None:
        """Close it; may be called twice."""
