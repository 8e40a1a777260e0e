"""One MAVLink 2 endpoint: a UDP socket, its peers, and the frames that pass through it."""

from __future__ import annotations

import math
import select
import socket
import time
from collections.abc import Callable, Sequence
from enum import Enum
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.address import check_policy, local_host_for, parse_peer, parse_url, resolve
from bridge.decoding import Message, decode
from bridge.endpoint_counters import EndpointCounters
from bridge.framing import FLAG_SIGNED, intact, split_frames, without_signature
from bridge.packing import pack
from bridge.peers import Peer, PeerTable
from bridge.signing import Signer
from bridge.signing_key import SigningKey

__all__ = ["Direction", "Endpoint", "Peer", "Received", "dialect", "parse_peer", "parse_url"]

_DATAGRAMS_PER_CALL = 512  # a flood must not keep the loop in receive() for ever,
_RECEIVE_MAX_S = 0.004  # s of processor time: nor may datagrams that are full of small frames
_UNTIMED_BYTES = 4096  # in one call, before the clock is looked at, which costs as much as a small datagram
_RECEIVED_MAX = 4096  # bytes of a datagram that is looked at; nobody joins frames beyond an Ethernet frame
_DATAGRAM_MAX = 1400  # bytes; below an Ethernet frame and PX4's 1600-byte buffer (mavlink_receiver.cpp)
_SOCKET_BUFFER = 1 << 20  # bytes, asked for; the kernel may give less
_HEARTBEAT = bytes(3)  # message id 0, on the wire
_SETUP_SIGNING: int = dialect.MAVLINK_MSG_ID_SETUP_SIGNING


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


class Endpoint:
    """A UDP socket that speaks MAVLink 2; not thread-safe, owned by one loop.

    With a key every frame is signed, and what is not signed with it is dropped before it is decoded.

    Attributes:
        tap: called with every valid frame both ways, for the recorder; an outgoing frame is shown once.
            It sees frames without their signatures: nothing to learn from, and the same whatever the clock.
        counters: what passed and what was thrown away.
        local_port: the port the socket is bound to.
        warnings: what a person should know before flying.
    """

    dialect = dialect

    def __init__(
        self,
        url: str,
        system_id: int,
        component_id: int,
        *,
        max_peers: int = 8,
        signing_key: SigningKey | None = None,
        always: Sequence[Peer] = (),
        allow_unsigned: bool = False,
        link_id: int = 0,
    ) -> None:
        """Open the socket.

        Args:
            url: ``udpin:HOST:PORT`` listens, ``udpout:HOST:PORT`` sends there first and hears nobody else.
            system_id: our MAVLink system id, 1 to 255.
            component_id: our MAVLink component id, 1 to 255.
            max_peers: how many senders of heartbeats are remembered and served at a time.
            signing_key: sign everything, and hear nothing unsigned.
            always: ``udpin`` only: peers that get telemetry before they speak, and never expire.
            allow_unsigned: listen to a network without a key.
            link_id: of signing, for endpoints that share key and ids, 0 to 255.

        Raises:
            ValueError: bad URL or id, the host has no IPv4 address, it would listen to a network without a
                key, or the state of signing cannot be understood.
            OSError: the address cannot be bound, for example because another process has the port, or the
                state of signing cannot be read or written.
        """
        for name, value in (("system", system_id), ("component", component_id)):
            if not 1 <= value <= 255:
                raise ValueError(f"MAVLink {name} id is {value}: allowed is 1 to 255")
        kind, host, port = parse_url(url)
        address = resolve(f"MAVLink URL {url!r}", host, port)
        configured = tuple(dict.fromkeys(always))
        warning = check_policy(
            url, address, configured, signed=signing_key is not None, allow_unsigned=allow_unsigned
        )
        self.tap: Tap | None = None
        self.counters = EndpointCounters()
        self._mav = dialect.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._peers = PeerTable((address,) if kind == "udpout" else configured, max_peers)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._open(url, kind, address)
            self._signer = Signer(signing_key, system_id, component_id, link_id) if signing_key else None
        except BaseException:
            self._socket.close()
            raise
        self.local_port: int = self._socket.getsockname()[1]
        signer_warning = self._signer.warning if self._signer else None
        self.warnings = tuple(text for text in (warning, signer_warning) if text is not None)

    def _open(self, url: str, kind: str, address: Peer) -> None:
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SOCKET_BUFFER)
            if kind == "udpin":
                self._socket.bind(address)
            else:
                self._socket.bind((local_host_for(address), 0))
                self._socket.connect(address)  # the kernel drops what comes from elsewhere
        except OSError as error:
            hint = "is another process listening there?" if kind == "udpin" else "is there a route to it?"
            raise OSError(error.errno, f"cannot open {url!r}: {error.strerror}; {hint}") from error

    @property
    def peers(self) -> tuple[Peer, ...]:
        """Whom ``send`` reaches: configured peers, and everyone with a heartbeat heard in the last 10 s."""
        return self._peers.reached

    def receive(self) -> list[Received]:
        """Take what is in the socket now, in order of arrival; never blocks, never raises.

        It stops after 4 ms of work with all but the first 4 kB; what a flood left in the socket then waits
        for the next call.
        """
        received: list[Received] = []
        size, until_s = 0, math.inf
        for _ in range(_DATAGRAMS_PER_CALL):
            try:
                datagram, peer = self._socket.recvfrom(_RECEIVED_MAX + 1)
            except BlockingIOError:
                break
            except OSError:  # a peer's port was closed, or ours: nothing to mend here
                continue
            if len(datagram) > _RECEIVED_MAX:
                self.counters.oversize += 1
                continue
            for frame in split_frames(datagram, self.counters):
                self._take(frame, peer, received)
            size += len(datagram)
            if size > _UNTIMED_BYTES:
                now_s = time.thread_time()
                if now_s > until_s:
                    break
                until_s = min(until_s, now_s + _RECEIVE_MAX_S)
        if self._signer is not None:
            self._signer.save_if_due()
        return received

    def _take(self, frame: bytes, peer: Peer, received: list[Received]) -> None:
        """Check a frame, decode it, note its sender; what is refused is counted."""
        counters, size = self.counters, len(frame)
        refused = self._refused(frame)
        if refused is not None:
            counters.add(refused)
            return
        if frame[2] & FLAG_SIGNED:
            frame = without_signature(frame)
        try:
            message = decode(frame)
        except Exception:  # a frame from the network must never stop the loop
            counters.undecodable += 1
            return
        if message.get_msgId() == _SETUP_SIGNING:  # keys come from files; and no key may get into the log
            counters.setup_signing += 1
            return
        counters.received += 1
        if not self._peers.heard(peer, size, heartbeat=frame[7:10] == _HEARTBEAT):
            counters.peers_refused += 1
        if self.tap is not None:
            self.tap(Direction.IN, frame, peer)
        received.append(Received(message, frame, peer))

    def _refused(self, frame: bytes) -> str | None:
        """Name of the counter of a frame that signing keeps out, None to let it in."""
        signed = frame[2] & FLAG_SIGNED
        if self._signer is None:
            self.counters.unchecked += signed  # cannot be checked: no better than an unsigned one
            return None
        if not signed:
            return "unsigned"
        refusal = self._signer.refusal(frame)
        return refusal.value if refusal is not None else None

    def wait(self, timeout_s: float) -> bool:
        """Wait until a datagram is there; False when none came in ``timeout_s`` of wall time."""
        readable, _, _ = select.select((self._socket,), (), (), max(0.0, timeout_s))
        return bool(readable)

    def fileno(self) -> int:
        """Descriptor of the socket, for a ``select`` over several links."""
        return self._socket.fileno()

    def pack(self, message: Message) -> bytes:
        """Serialise a message, unsigned, with our ids and the next sequence number.

        Raises:
            struct.error: a field does not fit its type on the wire.
            IndexError: an array is too short.
        """
        mav = self._mav
        frame = pack(message, mav.seq, mav.srcSystem, mav.srcComponent)
        mav.seq = (mav.seq + 1) % 256
        return frame

    def send(self, messages: Sequence[Message], peer: Peer | None = None) -> None:
        """Send messages, in order, in one datagram (more only when they exceed 1400 bytes).

        Args:
            messages: instances of the dialect's message classes.
            peer: whom to; None means every peer known. Without any peer nothing is sent or numbered. Somebody
                without a heartbeat gets no more bytes than came from there: what is over that is dropped.

        Raises:
            struct.error: a field does not fit its type on the wire.
        """
        peers = (peer,) if peer is not None else self.peers
        if not messages or not peers:
            return
        allowance_bytes = self._peers.allowance_bytes(peer) if peer is not None else None
        frames, wire = self._pack(messages, allowance_bytes)
        if not frames:
            return
        for datagram in _datagrams(wire):
            for to in peers:
                self._send_to(datagram, to)
        if allowance_bytes is not None:
            self._peers.spend(peers[0], sum(map(len, wire)))
        self.counters.sent += len(frames) * len(peers)
        if self.tap is not None:
            for frame in frames:
                self.tap(Direction.OUT, frame, peers[0])

    def repeat(self, frame: bytes, peer: Peer | None = None) -> None:
        """Send a frame again, byte for byte: no new sequence number, not shown to the tap.

        How often that happens is a matter of wall time; so it stays out of log and numbering. With a key it
        is signed anew, since the receiver takes no timestamp twice; a frame damaged on purpose stays damaged.
        """
        wire = self._signer.sign(frame) if self._signer is not None and intact(frame) else frame
        for to in (peer,) if peer is not None else self.peers:
            allowance_bytes = self._peers.allowance_bytes(to)
            if allowance_bytes is not None and allowance_bytes < len(wire):
                self.counters.withheld += 1
                continue
            self._peers.spend(to, len(wire))
            self._send_to(wire, to)

    def close(self) -> None:
        """Close the socket and write down the state of signing; may be called twice."""
        self._socket.close()
        if self._signer is not None:
            self._signer.close()

    def _pack(
        self, messages: Sequence[Message], allowance_bytes: int | None
    ) -> tuple[list[bytes], list[bytes]]:
        """Frames as they are logged and as they are sent; only as many as an allowance covers."""
        if self._signer is None and allowance_bytes is None:
            frames = [self.pack(message) for message in messages]
            return frames, frames
        frames, wire, size = [], [], 0
        for message in messages:
            number = self._mav.seq
            frame = self.pack(message)
            signed = self._signer.sign(frame) if self._signer is not None else frame
            size += len(signed)
            if allowance_bytes is not None and size > allowance_bytes:
                self._mav.seq = number  # never sent, so the next one has it
                self.counters.withheld += len(messages) - len(frames)
                break
            frames.append(frame)
            wire.append(signed)
        return frames, wire

    def _send_to(self, datagram: bytes, peer: Peer) -> None:
        for _ in range(2):
            try:
                self._socket.sendto(datagram, peer)
            except (
                ConnectionRefusedError
            ):  # says that an earlier datagram found no listener: not about this one
                continue
            except OSError:  # full buffer or no route: the caller sends again next tick
                self.counters.send_errors += 1
            return
        self.counters.send_errors += 1


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
