"""One MAVLink 2 endpoint: a UDP socket, its peers, and the frames that pass through it."""

from __future__ import annotations

import os
import re
import select
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.decoding import Message, decode
from bridge.framing import FrameCounters, split_frames

Peer = tuple[str, int]

_PEER_EXPIRY_S = 10.0  # s of wall time; a vehicle or companion that is alive sends a heartbeat every second
_DATAGRAMS_PER_CALL = 512  # a flood must not keep the loop in receive() for ever
_DATAGRAM_MAX = 1400  # bytes; below an Ethernet frame and PX4's 1600-byte buffer (mavlink_receiver.cpp)
_SOCKET_BUFFER = 1 << 20  # bytes, asked for; the kernel may give less
_URL = re.compile(r"^(udpin|udpout):(?://)?([^:/\s]+):(\d{1,5})$")
_URL_HELP = (
    "allowed is 'udpin:HOST:PORT' (listen; port 0 takes any free one) or 'udpout:HOST:PORT' (send there "
    "first), HOST an IPv4 address or a name, PORT up to 65535, for example udpin:127.0.0.1:14540"
)


class Direction(Enum):
    """Which way a frame went, seen from this process."""

    IN = "in"
    OUT = "out"


class Received(NamedTuple):
    """One frame that arrived."""

    message: Message
    raw: bytes
    peer: Peer


Tap = Callable[[Direction, bytes, Peer], None]


@dataclass(slots=True)
class EndpointCounters(FrameCounters):
    """Counts of one endpoint."""

    received: int = 0  # frames decoded
    sent: int = 0  # frames handed to the socket, once per peer
    send_errors: int = 0  # datagrams the system did not take
    peers_refused: int = 0  # frames of senders for whom the peer table had no room


def parse_url(url: str) -> tuple[str, str, int]:
    """Split an endpoint URL into kind ("udpin" or "udpout"), host and port.

    Raises:
        ValueError: the URL is none of the allowed forms.
    """
    match = _URL.match(url)
    if match is None:
        raise ValueError(f"MAVLink URL {url!r} is not understood: {_URL_HELP}")
    kind, host, port = match.group(1), match.group(2), int(match.group(3))
    if port > 65535 or (port == 0 and kind == "udpout"):
        raise ValueError(f"MAVLink URL {url!r} has port {port}: {_URL_HELP}")
    return kind, host, port


class Endpoint:
    """A UDP socket that speaks MAVLink 2; not thread-safe, owned by one loop.

    Attributes:
        tap: called with every valid frame both ways, for the recorder; an outgoing frame is shown once.
        counters: what passed and what was thrown away.
        local_port: the port the socket is bound to.
    """

    dialect = dialect

    def __init__(self, url: str, system_id: int, component_id: int, *, max_peers: int = 8) -> None:
        """Open the socket.

        Args:
            url: ``udpin:HOST:PORT`` listens, ``udpout:HOST:PORT`` sends there first.
            system_id: our MAVLink system id, 1 to 255.
            component_id: our MAVLink component id, 1 to 255.
            max_peers: how many senders are remembered and answered at a time.

        Raises:
            ValueError: bad URL or id, or the host has no IPv4 address.
            OSError: the address cannot be bound, for example because another process has the port.
        """
        for name, value in (("system", system_id), ("component", component_id)):
            if not 1 <= value <= 255:
                raise ValueError(f"MAVLink {name} id is {value}: allowed is 1 to 255")
        kind, host, port = parse_url(url)
        address = _resolve(url, host, port)
        self.tap: Tap | None = None
        self.counters = EndpointCounters()
        self._mav = dialect.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._fixed: Peer | None = address if kind == "udpout" else None
        self._peers: dict[Peer, float] = {}
        self._max_peers = max_peers
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SOCKET_BUFFER)
            self._socket.bind(address if kind == "udpin" else (_local_host_for(address), 0))
        except OSError as error:
            self._socket.close()
            hint = "is another process listening there?" if kind == "udpin" else "is there a route to it?"
            raise OSError(error.errno, f"cannot open {url!r}: {error.strerror}; {hint}") from error
        self.local_port: int = self._socket.getsockname()[1]

    @property
    def peers(self) -> tuple[Peer, ...]:
        """Whom ``send`` reaches: the address of ``udpout`` and everyone heard in the last 10 s."""
        oldest = time.monotonic() - _PEER_EXPIRY_S
        for peer in [p for p, heard in self._peers.items() if heard < oldest]:
            del self._peers[peer]
        if self._fixed is None or self._fixed in self._peers:
            return tuple(self._peers)
        return (self._fixed, *self._peers)

    def receive(self) -> list[Received]:
        """Take everything that is in the socket now, in order of arrival; never blocks, never raises."""
        received: list[Received] = []
        for _ in range(_DATAGRAMS_PER_CALL):
            try:
                datagram, peer = self._socket.recvfrom(65536)
            except OSError:  # nothing left, or a peer's port was closed: neither is ours to mend
                break
            for frame in split_frames(datagram, self.counters):
                try:
                    message = decode(frame)
                except Exception:  # a frame from the network must never stop the loop
                    self.counters.undecodable += 1
                    continue
                self.counters.received += 1
                self._learn(peer)
                if self.tap is not None:
                    self.tap(Direction.IN, frame, peer)
                received.append(Received(message, frame, peer))
        return received

    def wait(self, timeout_s: float, *, spin_s: float = 0.0) -> bool:
        """Wait until a datagram is there; False when none came in ``timeout_s``.

        Args:
            timeout_s: wall time.
            spin_s: look without sleeping for so long at first, giving way to others between looks: waking a
                sleeping process on another core takes 0.1 ms and more, which is what lockstep waits for.
        """
        spin_until = time.monotonic() + min(timeout_s, spin_s)
        while time.monotonic() < spin_until:
            if select.select((self._socket,), (), (), 0.0)[0]:
                return True
            os.sched_yield()
        readable, _, _ = select.select((self._socket,), (), (), max(0.0, timeout_s))
        return bool(readable)

    def fileno(self) -> int:
        """Descriptor of the socket, for a ``select`` over several links."""
        return self._socket.fileno()

    def pack(self, message: Message) -> bytes:
        """Serialise a message with our ids and the next sequence number.

        Raises:
            struct.error: a field does not fit its type on the wire.
        """
        frame: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame

    def send(self, messages: Sequence[Message], peer: Peer | None = None) -> None:
        """Send messages, in order, in one datagram (more only when they exceed 1400 bytes).

        Args:
            messages: instances of the dialect's message classes.
            peer: whom to; None means every peer known. Without any peer nothing is sent or numbered.
        """
        peers = (peer,) if peer is not None else self.peers
        if not messages or not peers:
            return
        frames = [self.pack(message) for message in messages]
        for datagram in _datagrams(frames):
            for to in peers:
                try:
                    self._socket.sendto(datagram, to)
                except OSError:  # full buffer or no route: the caller sends again next tick
                    self.counters.send_errors += 1
        self.counters.sent += len(frames) * len(peers)
        if self.tap is not None:
            for frame in frames:
                self.tap(Direction.OUT, frame, peers[0])

    def repeat(self, frame: bytes, peer: Peer | None = None) -> None:
        """Send a frame again, byte for byte: no new sequence number, not shown to the tap.

        How often that happens is a matter of wall time; so it stays out of log and numbering.
        """
        for to in (peer,) if peer is not None else self.peers:
            try:
                self._socket.sendto(frame, to)
            except OSError:
                self.counters.send_errors += 1

    def close(self) -> None:
        """Close the socket; may be called twice."""
        self._socket.close()

    def _learn(self, peer: Peer) -> None:
        if peer in self._peers or len(self._peers) < self._max_peers or len(self.peers) < self._max_peers:
            self._peers[peer] = time.monotonic()
        else:
            self.counters.peers_refused += 1


def _datagrams(frames: list[bytes]) -> list[bytes]:
    """Join frames, in order, into as few datagrams as the size limit allows."""
    if sum(map(len, frames)) <= _DATAGRAM_MAX:
        return [b"".join(frames)]
    datagrams: list[bytes] = []
    current = b""
    for frame in frames:
        if current and len(current) + len(frame) > _DATAGRAM_MAX:
            datagrams.append(current)
            current = b""
        current += frame
    return [*datagrams, current]


def _resolve(url: str, host: str, port: int) -> Peer:
    try:
        info = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise ValueError(
            f"MAVLink URL {url!r}: host {host!r} has no IPv4 address ({error}); {_URL_HELP}"
        ) from error
    address, found_port = info[0][4][:2]
    return (str(address), int(found_port))


def _local_host_for(address: Peer) -> str:
    """Our own address on the way to ``address``, so that the socket does not listen on other interfaces."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(address)  # UDP: chooses a route, sends nothing
        return str(probe.getsockname()[0])
