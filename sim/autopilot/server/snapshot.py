"""What all telemetry of one moment is made from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bridge.mavlink.codec.decoding import Message
from sim.autopilot.flight import Flight
from sim.autopilot.modes import EstimateLike


@dataclass(slots=True)
class Snapshot:
    """One moment."""

    flight: Flight
    estimate: EstimateLike
    now_s: float
    epoch_ns: int  # Unix time of the boot clock's zero

    @property
    def boot_ms(self) -> int:
        """Boot clock, ms."""
        return round(self.now_s * 1000) & 0xFFFFFFFF

    @property
    def boot_us(self) -> int:
        """Boot clock, us."""
        return round(self.now_s * 1e6)


Builder = Callable[[Snapshot], Message]
