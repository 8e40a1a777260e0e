"""Answers peers whose signing clock is behind, so that it is moved forward.

An autopilot without a clock of its own starts at the time it had when it was switched off, and takes the time
of a signed frame that it accepts when that is later (mavlink.io, guide/message_signing). An endpoint that
listens until it knows a peer would refuse its frames for ever and never send one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from bridge.mavlink.codec.decoding import Message
from bridge.mavlink.signing.signing import Refusal
from bridge.mavlink.transport.peers import Peer

ANSWERED = frozenset({Refusal.STALE, Refusal.REPLAYED})  # the signature was right, the time was not
ANSWER_S = 1.0  # s between two answers to one address
_PEERS_MAX = 4  # addresses answered at a time: whoever repeats recorded frames gets no more than that
_HEARTBEAT = 0  # message id


class StaleAnswers:
    """Decides whom to send our newest heartbeat."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._heartbeat: Message | None = None
        self._answered_s: dict[Peer, float] = {}

    def note(self, messages: Sequence[Message]) -> None:
        """Remember our heartbeat among messages that are sent, or would be if there were anybody."""
        for message in messages:
            if message._header.msgId == _HEARTBEAT:
                self._heartbeat = message

    def due(self, peer: Peer) -> Message | None:
        """Our heartbeat for the sender of a frame that is signed rightly but too old; None: not now."""
        now_s = self._clock_s()
        said_s = self._answered_s.get(peer)
        if self._heartbeat is None or (said_s is not None and now_s - said_s < ANSWER_S):
            return None
        for other, other_s in list(self._answered_s.items()):
            if now_s - other_s >= ANSWER_S:
                del self._answered_s[other]
        if len(self._answered_s) >= _PEERS_MAX:
            return None
        self._answered_s[peer] = now_s
        return self._heartbeat
