"""Check of the time stamps of another process, and the delay of its messages.

Arrival minus stamp is the difference of the two clocks plus the delay of the message. The minimum belongs to
a message without delay; the excess of another message over this minimum is its lateness. The minimum
follows the messages by these rules:

* a minimum that no message reaches for ``HOLDS_S`` rises at the rate ``FORGETS``, and so follows drifting
  clocks; a delay that grows faster, as in a queue, counts as lateness;
* a stamp too far ahead, or older than the newest one, is rejected. If rejected messages agree with each
  other for ``proof_s`` and no message is accepted in this time, the sender's clock was set or restarted: the
  minimum of these messages is adopted;
* late messages can come from a queue, which looks like a clock that was set back in a pause. No queue keeps
  its length for a long time, so late messages must agree for ``patience_s``.

One-way stamps cannot distinguish a delay that grows slower than ``FORGETS`` from a slow clock.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Self

from flightstack.core.memory import ClockMemory
from flightstack.core.numeric import rare

FORGETS = 0.04  # rate at which the minimum rises, s/s: firmware and simulators can run 3 % slow
HOLDS_S = 1.0  # time in which at least one message is assumed to have a short delay, s
FORGETS_SLOWLY = 0.002  # rate of the slow minimum, s/s: four times the maximum slew of a Linux clock
ELAPSED_MAX_S = 1.0  # maximum part of a pause between messages in which a minimum rises, s
FLOOR_MAX_S = 0.2  # limit of the difference between fast and slow minimum, s; clock drift would exceed it
GRAIN_S = 1e-6  # tolerance for Unix times as doubles, s; their rounding error is 2.4e-7 s
# maximum time by which a delay may be below the shortest delay so far, s; ``ahead_max_s`` adds one tick
AHEAD_S = 0.03
AGREE_S = 0.1  # maximum allowed difference of arrival minus stamp between messages of one clock, s
GAP_MAX_S = 0.5  # maximum pause between two messages whose times agree, s
PATIENCE_S = 10.0  # time for which late messages must agree, s; delays by queues change within this time
QUEUE_MAX_S = 10.0  # maximum delay by a queue after a pause, s; a longer queue needs time to fill
STAMP_MAX_S = 2.0**32  # maximum valid stamp, s: the year 2106; ROS 2 and Unix times end before this year


class Reading(IntEnum):
    """Result of the check of a time stamp; the last five belong to the other checks of a target sample."""

    text: str

    def __new__(cls, text: str) -> Self:
        """Return a member numbered in the order of declaration."""
        member = int.__new__(cls, len(cls.__members__))
        member._value_, member.text = len(cls.__members__), text
        return member

    FRESH = "accepted"
    STEPPED = "accepted: the sender's clock was set, or began anew"
    UNUSABLE = "time stamp not between 1970 and 2106"
    REPEATED = "repeated"
    OUT_OF_ORDER = "out of order"
    AHEAD = "time stamp from the future"
    LATE = "too late"
    NOT_FINITE = "not finite"
    WRONG_ROBOT = "from another robot or frame"
    TOO_FAST = "faster than allowed"
    JUMP = "jumped"
    FROZEN = "not measured anew"

    @property
    def good(self) -> bool:
        """Whether the message is accepted."""
        return self is Reading.FRESH or self is Reading.STEPPED


class SenderClock:
    """Estimate of a sender's clock; ``memory`` is its complete state."""

    memory: ClockMemory
    ahead_max_s: float  # ``AHEAD_S`` plus one tick, s
    _late_max_s: float  # lateness above which a message is rejected, s
    _proof_s: float  # time for which rejected messages must agree until their clock is adopted, s
    # minimum step back after a pause for which a clock is adopted immediately, s: the sender has restarted
    _reboot_s: float

    def __init__(
        self, late_max_s: float, proof_s: float, tick_s: float = 0.0, reboot_s: float = math.inf,
        memory: ClockMemory | None = None,
    ) -> None:  # fmt: skip
        self.memory = memory or ClockMemory()
        self.ahead_max_s = AHEAD_S + tick_s
        self._late_max_s, self._proof_s, self._reboot_s = late_max_s, proof_s, reboot_s

    def accept(self, stamp_s: float, arrival_s: float, patience_s: float = PATIENCE_S) -> Reading:
        """Check a time stamp, and update the clock estimate if the stamp is good."""
        reading = self.judge(stamp_s, arrival_s, patience_s)
        if reading.good:
            self.take(stamp_s, arrival_s)
        return reading

    def judge(self, stamp_s: float, arrival_s: float, patience_s: float = PATIENCE_S) -> Reading:
        """Check a time stamp; only ``take`` updates the clock estimate."""
        memory, transit_s = self.memory, arrival_s - stamp_s
        if not 0.0 <= stamp_s <= STAMP_MAX_S:  # this comparison also rejects NaN
            return Reading.UNUSABLE
        if stamp_s > memory.stamp_s:
            # before this time, samples can come from a queue that is being emptied
            known = arrival_s - memory.began_s >= self._proof_s
            if known and transit_s < memory.floor_s - self.ahead_max_s:
                reading = Reading.AHEAD
            elif transit_s - memory.offset_s > self._late_max_s or self._goes_on_late(transit_s, arrival_s):
                reading = Reading.LATE
            else:
                return Reading.FRESH
        else:
            reading = Reading.REPEATED if stamp_s == memory.stamp_s else Reading.OUT_OF_ORDER
        return self._refused(reading, stamp_s, arrival_s, patience_s)

    @rare
    def _refused(self, reading: Reading, stamp_s: float, arrival_s: float, patience_s: float) -> Reading:
        """Return the reading, or ``STEPPED`` if rejected messages have agreed for ``needed_s``."""
        needed_s = self._proof_s if self._noted(reading, stamp_s, arrival_s) else patience_s
        return Reading.STEPPED if arrival_s - self.memory.run_since_s >= needed_s else reading

    def take(self, stamp_s: float, arrival_s: float) -> bool:
        """Update the estimate with an accepted stamp; return whether the sender's clock has changed."""
        memory, transit_s = self.memory, arrival_s - stamp_s
        newest = memory.run_stamp_s == stamp_s and memory.run_arrival_s == arrival_s
        stepped = newest and memory.run_since_s < math.inf
        if stepped or memory.began_s == math.inf:
            memory.began_s = arrival_s
        if stepped:
            memory.offset_s = memory.floor_s = memory.run_way_s
            memory.held_s = 0.0
        else:
            elapsed_s = min(arrival_s - memory.taken_s, ELAPSED_MAX_S)
            memory.held_s = memory.held_s + elapsed_s if transit_s > memory.offset_s + GRAIN_S else 0.0
            if memory.held_s > HOLDS_S:
                memory.offset_s += FORGETS * elapsed_s
            if transit_s > memory.floor_s + GRAIN_S:
                memory.floor_s += FORGETS_SLOWLY * elapsed_s
            memory.offset_s = min(transit_s, memory.offset_s)
            memory.floor_s = max(min(transit_s, memory.floor_s), memory.offset_s - FLOOR_MAX_S)
        memory.stamp_s, memory.taken_s = stamp_s, arrival_s
        memory.run_since_s, memory.run_sure = math.inf, False
        return stepped

    def lateness_s(self, stamp_s: float, now_s: float) -> float:
        """Return the lateness of a message with this stamp, s; ``now_s``: time of this process's clock."""
        return max(0.0, now_s - stamp_s - self.memory.offset_s)

    def _goes_on_late(self, transit_s: float, arrival_s: float) -> bool:
        """Whether the stamps of a clock that was set back slightly have passed the newest accepted stamp."""
        m = self.memory
        return transit_s - m.offset_s > AGREE_S and m.run_sure and self._agrees(transit_s, arrival_s)

    def _agrees(self, transit_s: float, arrival_s: float) -> bool:
        m = self.memory
        in_time = m.run_since_s <= arrival_s <= m.run_arrival_s + GAP_MAX_S
        return in_time and abs(transit_s - m.run_way_s) <= AGREE_S

    @rare
    def _noted(self, reading: Reading, stamp_s: float, arrival_s: float) -> bool:
        """Store a rejected message; return whether only a changed clock explains the run of rejections."""
        m, transit_s = self.memory, arrival_s - stamp_s
        if stamp_s > m.run_stamp_s and self._agrees(transit_s, arrival_s):
            m.run_way_s = min(m.run_way_s, transit_s)
        else:
            before_s = m.run_arrival_s if m.run_since_s < math.inf else m.taken_s
            silent = arrival_s - before_s > GAP_MAX_S
            began = silent and transit_s - m.offset_s > QUEUE_MAX_S  # too late for a queue after a pause
            sure = began or reading in (Reading.AHEAD, Reading.OUT_OF_ORDER)
            m.run_since_s, m.run_way_s, m.run_sure = arrival_s, transit_s, sure
            if silent and m.stamp_s - stamp_s > self._reboot_s:
                m.run_since_s = -math.inf
        m.run_stamp_s, m.run_arrival_s = stamp_s, arrival_s
        return m.run_sure
