"""One MAVLink 2 endpoint: its socket or serial line, its peers, and the frames it receives and sends."""

from __future__ import annotations

import math
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from enum import Enum
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.framing import FLAG_SIGNED, Framer, without_signature
from bridge.mavlink.codec.messages import MESSAGES, Message, decode, message_id
from bridge.mavlink.signing import Refusal, Signer, SigningKey, load_key
from bridge.mavlink.transport.address import Peer, PeerTable, check_policy, parse_peer, parse_url, resolve
from bridge.mavlink.transport.transport import ByteStream, DatagramTransport
from flightstack.config.options import Signing

_CHUNKS_PER_CALL = 512  # maximum number of chunks in one call of receive()
_BYTES_PER_CALL = 16384  # number of bytes (4 ms of work) after which a call of receive() reads no more chunks
_NOTICES_MAX = 32  # maximum number of texts that wait for ``take_notices``
_HEARTBEAT: int = dialect.MAVLINK_MSG_ID_HEARTBEAT
_OLD = frozenset({Refusal.STALE, Refusal.REPLAYED})  # refusals of old frames with a correct signature
_ANSWER_S = 1.0  # time between two replies to frames with old timestamps, s; replayed frames have them, too
_SETUP_SIGNING: int = dialect.MAVLINK_MSG_ID_SETUP_SIGNING


class Direction(Enum):
    """Direction of a frame as seen from this process."""

    IN = "in"
    OUT = "out"


class Received(NamedTuple):
    message: Message
    peer: Peer

    @property
    def sender(self) -> tuple[int, int]:
        """System id and component id of the sender."""
        header = self.message._header
        return header.srcSystem, header.srcComponent


Tap = Callable[[Direction, bytes, Peer], None]


class Endpoint:
    """MAVLink 2 over UDP, a serial line or TCP, for one thread; with a key, unsigned frames are rejected."""

    def __init__(
        self,
        url: str,
        system_id: int,
        component_id: int,
        *,
        signing_key: SigningKey | None = None,
        always: Sequence[Peer] = (),
        allow_unsigned: bool = False,
    ) -> None:
        """Open the socket or serial line.

        ``always``: peers of ``udpin`` that receive telemetry from the start and never expire.
        ``allow_unsigned``: permit listening on a network without a key.
        A refused TCP connection is no error: the endpoint retries, and ``take_notices`` reports the refusal.
        """
        kind, host, port = parse_url(url)
        address = (host, port) if kind == "serial" else resolve(f"MAVLink URL {url!r}", host, port)
        configured = tuple(dict.fromkeys(always))
        warning = check_policy(
            url, address, configured, signed=signing_key is not None, allow_unsigned=allow_unsigned
        )
        # The recorder's callback: it receives every valid frame of both directions without the signature, and
        # frames of unknown messages, whose checksum cannot be checked.
        self.tap: Tap | None = None
        self.counters = Counter[str]()  # numbers of frames and bytes by outcome, see docs/how_to/security.md
        self._mav = dialect.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._peers = PeerTable(configured if kind == "udpin" else (address,))
        self._notices: deque[str] = deque(maxlen=_NOTICES_MAX)
        self._transport: ByteStream | DatagramTransport = (
            ByteStream(kind, address, self.counters, self._notices)
            if kind in ("serial", "tcp")
            else DatagramTransport(url, kind == "udpin", address, self.counters)
        )
        try:
            self._signer = Signer(signing_key, system_id, component_id) if signing_key else None
        except BaseException:
            self._transport.close()
            raise
        self._framer = Framer(self.counters, stream=self._transport.is_stream)
        self._heartbeat: Message | None = None  # newest heartbeat of this endpoint; stored only with a key
        self._answered_s = -math.inf  # time of the last reply to a frame with an old timestamp, s
        self.local_port = self._transport.local_port  # UDP port of the socket; 0 for other links
        self.baud = self._transport.baud  # speed of a serial line, bit/s; None for other links
        warnings = (warning, self._signer.warning if self._signer else None)
        self.warnings = tuple(filter(None, warnings))  # warnings for the operator before a flight

    @property
    def peers(self) -> tuple[Peer, ...]:
        """Receivers of ``send``: configured peers, and heartbeat senders active in the last 10 s."""
        return self._peers.reached

    @property
    def signed(self) -> bool:
        return self._signer is not None

    def receive(self) -> list[Received]:
        """Return the received messages; never blocks or raises. Data after 16 kB wait for the next call."""
        received: list[Received] = []
        size = 0
        for _ in range(_CHUNKS_PER_CALL):
            chunk = self._transport.receive()
            if chunk is None:
                break
            data, peer = chunk
            for frame in self._framer.push(data):
                self._take(frame, peer, received)
            size += len(data)
            if size > _BYTES_PER_CALL:
                break
        if self._signer is not None:
            self._signer.save_if_due()
        return received

    def _take(self, frame: bytes, peer: Peer, received: list[Received]) -> None:
        """Check and decode a frame and record its sender; count a rejected frame."""
        counters, signed = self.counters, frame[2] & FLAG_SIGNED
        if self._signer is None:
            counters["unchecked"] += signed  # without a key a signed frame is handled like an unsigned one
        elif (refused := self._signer.refusal(frame)) is not None:
            counters[refused.value] += 1
            if refused in _OLD:
                self._answer_stale(peer)
            return
        if signed:
            frame = without_signature(frame)
        if message_id(frame) not in MESSAGES:  # only recorded; its sender does not become a peer
            if self.tap is not None:
                self.tap(Direction.IN, frame, peer)
            return
        try:
            message = decode(frame)
        except Exception:  # an invalid frame from the network must never stop the loop
            counters["undecodable"] += 1
            return
        if message.get_msgId() == _SETUP_SIGNING:  # keys are read only from files and must not be logged
            counters["setup_signing"] += 1
            return
        counters["received"] += 1
        if not self._peers.heard(peer, heartbeat=message.get_msgId() == _HEARTBEAT):
            counters["peers_refused"] += 1
        if self.tap is not None:
            self.tap(Direction.IN, frame, peer)
        received.append(Received(message, peer))

    def _answer_stale(self, peer: Peer) -> None:
        """Send a heartbeat to a peer with a late clock; an autopilot adopts the timestamp of this frame."""
        now_s = time.monotonic()
        if self._heartbeat is None or self._signer is None or now_s - self._answered_s < _ANSWER_S:
            return
        self._answered_s = now_s
        frame = self._heartbeat.pack(self._mav)  # sent by wall time, so neither numbered nor recorded
        self._transport.send((self._signer.sign(frame),), peer)
        self.counters["stale_answered"] += 1

    def wait(self, timeout_s: float) -> bool:
        return self._transport.wait(max(0.0, timeout_s))

    def fileno(self) -> int:
        """Return the descriptor for ``select``; it changes when a connection is lost or reopened."""
        return self._transport.fileno()

    def take_notices(self) -> list[str]:
        """Return the texts about lost connections since the last call."""
        return [self._notices.popleft() for _ in range(len(self._notices))]

    def pack(self, message: Message) -> bytes:
        """Serialise a message, unsigned, with the ids of this endpoint and the next sequence number.

        Raises struct.error: a field does not fit its type on the wire; IndexError: an array is too short.
        """
        frame: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame

    def send(self, messages: Sequence[Message], peer: Peer | None = None) -> None:
        """Send messages in order; UDP uses one datagram, or several for more than 1400 bytes.

        ``peer`` None: all known peers; without any peer no message is sent or numbered.
        Raises struct.error: a field does not fit its type on the wire.
        """
        if self._signer is not None:
            beats = (message for message in messages if message.get_msgId() == _HEARTBEAT)
            self._heartbeat = next(beats, self._heartbeat)
        peers = (peer,) if peer is not None else self.peers
        if not messages or not peers:
            return
        frames = wire = [self.pack(message) for message in messages]
        if self._signer is not None:
            wire = [self._signer.sign(frame) for frame in frames]
        for to in peers:
            self._transport.send(wire, to)
        self.counters["sent"] += len(frames) * len(peers)
        if self.tap is not None:
            for frame in frames:
                self.tap(Direction.OUT, frame, peers[0])

    def repeat(self, frame: bytes, peer: Peer | None = None) -> None:
        """Send a frame again with the same sequence number; do not record it.

        Repetitions depend on wall time, so they are neither logged nor numbered. With a key the frame gets a
        new signature, since receivers reject a repeated timestamp.
        """
        wire = self._signer.sign(frame) if self._signer is not None else frame
        for to in (peer,) if peer is not None else self.peers:
            self._transport.send((wire,), to)

    def close(self) -> None:
        """Close the socket or line and write the signing state; may be called twice."""
        self._transport.close()
        if self._signer is not None:
            self._signer.save()


def open_endpoint(
    who: str, url: str, system_id: int, component_id: int, signing: Signing, peers: Sequence[str] = ()
) -> Endpoint:
    """Open an endpoint with the options of the process ``who``, and print its warnings.

    ``peers``: HOST:PORT of peers that receive telemetry from the start. Raises as ``Endpoint``, and
    ValueError: bad peer or key.
    """
    endpoint = Endpoint(
        url, system_id, component_id,
        signing_key=load_key(signing.signing_key) if signing.signing_key else None,
        always=[parse_peer(peer) for peer in peers], allow_unsigned=signing.allow_unsigned,
    )  # fmt: skip
    for warning in endpoint.warnings:
        print(f"{who}: WARNING: {warning}", file=sys.stderr)
    return endpoint
