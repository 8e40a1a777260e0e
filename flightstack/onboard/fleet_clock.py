"""How far the clock of another process is from ours, by the times of messages in both directions.

A message arrives after it was sent. With d = our clock - the other one's clock at the same moment:

    arrival here  - stamp of the other one  >=  d      its least value is ``ahead_ns``
    arrival there - stamp of ours           >= -d      the other process reports its least value, ``echo_ns``

So d is between -echo_ns and ahead_ns. The middle is the estimate, and half of the width is its bound: half of
the sum of the least delays of both directions. No delay has to be known, and they may differ. This is the
method of Cristian (1989), with the least delay of each direction in place of one round trip.

Clocks drift. Both least values therefore grow with their age by ``DRIFT``.
"""

from __future__ import annotations

from typing import NamedTuple

# Of two clocks against each other, without unit: Linux slews each of them by 500 ppm at most (adjtimex(2)).
DRIFT = 1e-3


class Offset(NamedTuple):
    """Our clock minus the other one's."""

    ns: int  # estimate
    bound_ns: int  # bound of its error


class Least:
    """Minimum of the noted values; it grows with its age."""

    def __init__(self) -> None:
        self._value_ns: int | None = None
        self._at_ns = 0

    def note(self, value_ns: int, now_ns: int) -> None:
        """Note a value. ``value_ns``: of a message; ``now_ns``: our clock."""
        least_ns = self.at(now_ns)
        self._value_ns = value_ns if least_ns is None else min(value_ns, least_ns)
        self._at_ns = now_ns

    def at(self, now_ns: int) -> int | None:
        """Return the minimum with its growth until now; None before the first value."""
        if self._value_ns is None:
            return None
        return self._value_ns + round(DRIFT * max(0, now_ns - self._at_ns))


class OtherClock:
    """The clock of another process; call ``heard`` with each of its messages."""

    def __init__(self) -> None:
        self._ahead, self._echo = Least(), Least()

    def heard(self, stamp_ns: int, arrival_ns: int, echo_ns: int | None) -> bool:
        """Add the times of a message; returns whether they agree with the earlier ones.

        If not, one of the clocks has jumped, and the estimate restarts.

        ``stamp_ns``: of the message, by the other clock; ``arrival_ns``: of the message, by ours;
        ``echo_ns``: its reported value; None: it has received nothing from us.
        """
        self._ahead.note(arrival_ns - stamp_ns, arrival_ns)
        if echo_ns is not None:
            self._echo = Least()  # the other process stores the minimum
            self._echo.note(echo_ns, arrival_ns)
        offset = self.offset(arrival_ns)
        if offset is None or offset.bound_ns >= 0:
            return True
        self._ahead, self._echo = Least(), Least()
        return False

    def ahead_ns(self, now_ns: int) -> int | None:
        """Return the value to send to the other process as its ``echo_ns``; None: nothing received."""
        return self._ahead.at(now_ns)

    def offset(self, now_ns: int) -> Offset | None:
        """Return our clock minus the other one; None until both directions are known.

        ``now_ns``: our clock.
        """
        ahead_ns, echo_ns = self._ahead.at(now_ns), self._echo.at(now_ns)
        if ahead_ns is None or echo_ns is None:
            return None
        width_ns = ahead_ns + echo_ns
        return Offset((ahead_ns - echo_ns) // 2, (width_ns + 1) // 2)
