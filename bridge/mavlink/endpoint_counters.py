"""What an endpoint let pass and what it threw away, and what a vehicle link left aside of the rest."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

from bridge.mavlink.codec.framing import FrameCounters

_PASSED = ("received", "sent", "bytes_in", "bytes_out", "unknown_frames", "stale_answered")
_SENDERS_MAX = 16  # other systems and components that are counted one by one


@dataclass(slots=True)
class EndpointCounters(FrameCounters):
    """Counts of one endpoint; each reason to drop something has one of its own."""

    received: int = 0  # frames decoded
    sent: int = 0  # frames handed to the socket, once per peer
    bytes_in: int = 0  # everything that came over the line, frames or not
    bytes_out: int = 0  # what the system took
    send_errors: int = 0  # datagrams the system did not take; frames while a line or connection was lost
    outgoing_full: int = 0  # serial and TCP: whole frames for which the line had no room
    connections_lost: int = 0  # serial and TCP
    peers_refused: int = 0  # heartbeats of senders for whom the peer table had no room
    oversize: int = 0  # datagrams longer than 4096 bytes
    withheld: int = 0  # answers not sent: more bytes than a sender without heartbeat had sent us
    setup_signing: int = 0  # attempts to set a key over the network, never obeyed
    unchecked: int = 0  # without a key: signed frames, taken as if they were unsigned
    # With a key only:
    stale_answered: int = 0  # heartbeats sent to peers whose signing clock is behind
    unsigned: int = 0  # frames without a signature
    bad_signature: int = 0  # signed with another key, forged or changed
    replayed: int = 0  # not later than the last frame of the same stream
    stale: int = 0  # a new stream that is a minute or more behind our clock
    ahead: int = 0  # more than an hour ahead of our clock
    reflected: int = 0  # frames with our own ids
    streams_refused: int = 0  # a new stream for which the table had no room

    def add(self, name: str) -> None:
        """Count one more of ``name``."""
        setattr(self, name, getattr(self, name) + 1)

    def dropped(self) -> str:
        """What was thrown away, as one line; empty when nothing was."""
        counts = asdict(self)
        return ", ".join(f"{name} {n}" for name, n in counts.items() if n and name not in _PASSED)


@dataclass(slots=True)
class LinkCounters:
    """Frames and set-points that were not let through."""

    foreign: int = 0  # frames of other systems or components
    held_lost: int = 0  # lockstep: frames that no tick ever claimed
    setpoints_refused: int = 0  # not finite, or forbidden while the vehicle takes off by itself
    senders: dict[tuple[int, int], int] = field(default_factory=dict)  # of them, by system and component

    def add_foreign(self, sender: tuple[int, int]) -> None:
        """Count a frame of somebody else."""
        self.foreign += 1
        if sender in self.senders or len(self.senders) < _SENDERS_MAX:
            self.senders[sender] = self.senders.get(sender, 0) + 1
