"""Explains why no heartbeat of a vehicle arrives: other senders, or dropped frames. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import NamedTuple

from bridge.mavlink.transport.transport import EndpointCounters

_SENDERS_SHOWN = 4


class _Cause(NamedTuple):
    counters: tuple[str, ...]
    text: str  # text with the count as {n}


# The first cause that applies is reported. Every vehicle sends some unknown messages, so the causes by other
# senders come first.
_SIGNING = (
    _Cause(("bad_signature",), "{n} frames are signed with another key than --signing-key"),
    _Cause(("unsigned",), "{n} frames have no signature: with --signing-key only signed ones are accepted"),
    _Cause(
        ("stale", "replayed", "ahead"),
        "{n} signed frames are rejected by their time stamps: its clock and ours differ",
    ),
    _Cause(("reflected",), "{n} frames have our own ids: the link sends back what we send"),
)
_DAMAGE = (
    _Cause(("version_1",), "{n} frames are MAVLink 1: set that link of the vehicle to MAVLink 2"),
    _Cause(("bad_crc", "unknown_id", "undecodable"), "{n} frames are damaged or of unknown messages"),
    _Cause(("garbage_bytes",), "{n} bytes are no MAVLink 2 frames"),
)

_NO_DATA = "no data arrives; check that the vehicle is on and that its link leads to the address of --vehicle"


class Arrivals:
    """Increments of an endpoint's counters since the last call."""

    def __init__(self) -> None:
        self._before: dict[str, int] = {}

    def grown(self, counters: EndpointCounters) -> dict[str, int]:
        now = asdict(counters)
        grown = {name: n - self._before.get(name, 0) for name, n in now.items()}
        self._before = now
        return {name: n for name, n in grown.items() if n > 0}


def why_silent(
    system_id: int,
    grown: Mapping[str, int],
    senders: Mapping[tuple[int, int], int],
    *,
    time: str = "",
) -> str:
    """Return a sentence about the missing heartbeat of a vehicle with the likely reason.

    ``grown``: increments of the endpoint's counters; ``senders``: number of frames of each other sender
    (system, component); ``time``: how long none arrived, such as " for 5 s".
    """
    text = f"no heartbeat of system {system_id}, component 1{time}: "
    cause = _first(_SIGNING, grown)
    if cause:
        return text + cause
    if grown.get("received") and senders:
        shown = ", ".join(f"{system}/{component}" for system, component in sorted(senders)[:_SENDERS_SHOWN])
        more = ", ..." if len(senders) > _SENDERS_SHOWN else ""
        return text + f"frames come from system/component {shown}{more}; --system-id names the vehicle's"
    if grown.get("received"):
        return text + "only its other messages arrive"
    return text + (_first(_DAMAGE, grown) or _NO_DATA)


def _first(causes: Sequence[_Cause], grown: Mapping[str, int]) -> str:
    """Return the sentence of the first cause that applies; empty if none applies."""
    for cause in causes:
        n = sum(grown.get(name, 0) for name in cause.counters)
        if n:
            return cause.text.format(n=n)
    return ""
