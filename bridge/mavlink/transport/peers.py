"""Who is on the other side of an endpoint, and how much may be sent to whom.

UDP addresses can be forged: whoever has only sent something is answered with no more bytes than came from
him, so that we cannot be used to flood others. A heartbeat makes a peer, who gets telemetry.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

Peer = tuple[str, int]

EXPIRY_S = 10.0  # s of wall time; a vehicle or companion that is alive sends a heartbeat every second
_STRANGERS_MAX = 16  # senders without heartbeat remembered at a time; the longest silent makes room


@dataclass(slots=True)
class _Stranger:
    heard_s: float
    credit_bytes: int  # received minus sent


class PeerTable:
    """Bounded tables of senders; everybody else's frames are heard, too, but never answered.

    Args:
        configured: peers that get everything from the start and never expire.
        peers_max: how many others, with a heartbeat, are served at a time.
    """

    def __init__(self, configured: tuple[Peer, ...], peers_max: int) -> None:
        self._configured = configured
        self._peers_max = peers_max
        self._beating: dict[Peer, float] = {}  # when each was heard last
        self._strangers: dict[Peer, _Stranger] = {}

    @property
    def reached(self) -> tuple[Peer, ...]:
        """Who gets telemetry: configured peers, and those with a heartbeat heard in the last 10 s."""
        oldest_s = time.monotonic() - EXPIRY_S
        alive = [peer for peer, heard_s in self._beating.items() if heard_s >= oldest_s]
        if not self._configured:
            return tuple(alive)
        return (*self._configured, *(peer for peer in alive if peer not in self._configured))

    @property
    def remembered(self) -> int:
        """Entries of both tables."""
        return len(self._beating) + len(self._strangers)

    def heard(self, peer: Peer, size: int, *, heartbeat: bool) -> bool:
        """Note a valid frame; False when it was a heartbeat and there is no room for one more peer.

        Args:
            peer: where it came from.
            size: its bytes.
            heartbeat: it was one.
        """
        now_s = time.monotonic()
        if peer in self._beating:
            self._beating[peer] = now_s
            return True
        if heartbeat and (peer in self._configured or self._room(now_s)):
            self._beating[peer] = now_s
            self._strangers.pop(peer, None)
            return True
        known = self._strangers.pop(peer, None)
        credit_bytes = known.credit_bytes if known and now_s - known.heard_s <= EXPIRY_S else 0
        if known is None and len(self._strangers) >= _STRANGERS_MAX:
            del self._strangers[next(iter(self._strangers))]
        self._strangers[peer] = _Stranger(now_s, credit_bytes + size)
        return not heartbeat

    def allowance_bytes(self, peer: Peer) -> int | None:
        """How much may be sent to a peer now; None: as much as there is, also after a silence of his."""
        if peer in self._configured or peer in self._beating:
            return None
        stranger = self._strangers.get(peer)
        return 0 if stranger is None else stranger.credit_bytes

    def spend(self, peer: Peer, size: int) -> None:
        """Note bytes sent to somebody with an allowance."""
        stranger = self._strangers.get(peer)
        if stranger is not None:
            stranger.credit_bytes -= size

    def _room(self, now_s: float) -> bool:
        """Whether one more peer fits; the place of one that has expired is free."""
        for peer, heard_s in list(self._beating.items()):
            if len(self._beating) >= self._peers_max and now_s - heard_s > EXPIRY_S:
                del self._beating[peer]
        return len(self._beating) < self._peers_max
