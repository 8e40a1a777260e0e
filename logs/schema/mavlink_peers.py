"""Short names for the peers of a MAVLink endpoint, so that every recorded frame says whose it is.

A frame's record carries the name in its ``frame_id``; the address behind a name is a metadata record. Names
count the peers in the order in which they appeared, so that two runs of one seed call them the same although
their ports differ.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

MAVLINK_PEERS = "mavlink_peers"  # metadata: name -> HOST:PORT
NAMED_MAX = 99  # anybody may send to an open port: only so many are told apart,
OTHERS = b"p99"  # and this is all the others


class MetadataSink(Protocol):
    """Where names are explained."""

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""


class PeerNames:
    """Names peers as they appear: ``p00``, ``p01``, ..."""

    def __init__(self, sink: MetadataSink) -> None:
        self._sink = sink
        self._names: dict[tuple[str, int], bytes] = {}

    def __call__(self, peer: tuple[str, int]) -> bytes:
        """Return the name of a peer (host, port), three characters; a new one is written down."""
        name = self._names.get(peer)
        if name is None:
            if len(self._names) >= NAMED_MAX:
                return OTHERS
            name = self._names[peer] = b"p%02d" % len(self._names)
            self._sink.metadata(MAVLINK_PEERS, {name.decode(): f"{peer[0]}:{peer[1]}"})
        return name
