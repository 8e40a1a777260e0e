"""Offset between the clocks of two processes, from the times of messages in both directions.

A message arrives after it was sent. With d = own clock - other clock at the same moment:

    arrival here  - stamp of the other one  >=  d      the minimum is ``ahead_ns``
    arrival there - own stamp               >= -d      the other process reports its minimum, ``echo_ns``

So d lies between -echo_ns and ahead_ns. The estimate is the middle, and its bound is half of the width: half
of the sum of the minimum delays of both directions. The delays need not be known or equal. This is the method
of Cristian (1989), with the minimum delay of each direction instead of one round trip.

Clocks drift, so both minimum values grow with their age by ``DRIFT``.
"""

from __future__ import annotations

from typing import NamedTuple

# Largest drift between two clocks, s/s: Linux slews each by at most 500 ppm (adjtimex(2)).
DRIFT = 1e-3


class Offset(NamedTuple):
    """Offset of this process's clock from that of another process."""

    ns: int  # estimate of own clock minus other clock
    bound_ns: int  # bound of the error of ``ns``


class Least:
    """Minimum of several values, which grows with its age."""

    def __init__(self) -> None:
        self._value_ns: int | None = None
        self._at_ns = 0

    def note(self, value_ns: int, now_ns: int) -> None:
        """Add the value of a message at the time ``now_ns`` of this process's clock."""
        least_ns = self.at(now_ns)
        self._value_ns = value_ns if least_ns is None else min(value_ns, least_ns)
        self._at_ns = now_ns

    def at(self, now_ns: int) -> int | None:
        """Return the minimum with its growth until now; None before the first value."""
        if self._value_ns is None:
            return None
        return self._value_ns + round(DRIFT * max(0, now_ns - self._at_ns))


class OtherClock:
    """Estimate of the clock of another process; call ``heard`` with each of its messages."""

    def __init__(self) -> None:
        self._ahead, self._echo = Least(), Least()

    def heard(self, stamp_ns: int, arrival_ns: int, echo_ns: int | None) -> bool:
        """Add the times of a message; return whether they agree with the earlier ones.

        If they do not agree, one of the clocks has jumped, and the estimate restarts.

        ``stamp_ns``: stamp on the other clock; ``arrival_ns``: arrival on this process's clock; ``echo_ns``:
        minimum that the other process reports; None: it has received nothing from this process.
        """
        self._ahead.note(arrival_ns - stamp_ns, arrival_ns)
        if echo_ns is not None:
            self._echo = Least()  # the other process keeps the minimum itself
            self._echo.note(echo_ns, arrival_ns)
        offset = self.offset(arrival_ns)
        if offset is None or offset.bound_ns >= 0:
            return True
        self._ahead, self._echo = Least(), Least()
        return False

    def ahead_ns(self, now_ns: int) -> int | None:
        """Return the value to send to the other process as its ``echo_ns``; None: nothing was received."""
        return self._ahead.at(now_ns)

    def offset(self, now_ns: int) -> Offset | None:
        """Return this clock minus the other clock; None until both directions are known.

        ``now_ns``: time on this process's clock.
        """
        ahead_ns, echo_ns = self._ahead.at(now_ns), self._echo.at(now_ns)
        if ahead_ns is None or echo_ns is None:
            return None
        width_ns = ahead_ns + echo_ns
        return Offset((ahead_ns - echo_ns) // 2, (width_ns + 1) // 2)
