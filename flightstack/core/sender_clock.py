"""Time stamps of another process: plausibility, and the delay of a message.

Arrival minus stamp is the difference of the two clocks plus the delay of the message. Its least value belongs
to a message without delay; the excess of any other message is its lateness. Old values are forgotten, and no
single message decides:

* a least value that is not met for ``HOLDS_S`` is forgotten at the rate ``FORGETS``: drifting clocks are
  followed, and a queue that grows faster counts as lateness;
* a stamp ahead of all that is known, or older than the newest, is refused. When refused messages agree with
  each other for ``proof_s`` and none was accepted meanwhile, the sender's clock was set or restarted: they
  are followed;
* messages that are only late may come from a queue, which looks like a clock that was set back while nothing
  was sent. No queue keeps its length for long: they have to agree for ``patience_s``.

One-way stamps cannot tell a delay that grows slower than ``FORGETS`` from a slow clock.
"""

from __future__ import annotations

import math

from flightstack.core.memory import ClockMemory
from flightstack.core.numeric import rare
from flightstack.core.types import TextEnum

FORGETS = 0.04  # s/s; firmware and simulators may run 3 % slow; a delay of 0.25 s counts as age for 7 s
HOLDS_S = 1.0  # at least one message within this time has a short delay
FORGETS_SLOWLY = 0.002  # s/s; four times what Linux slews a clock at most (adjtimex(2), 500 ppm)
ELAPSED_MAX_S = 1.0  # largest counted silence, which proves no drift
FLOOR_MAX_S = 0.2  # a busy network hides the least delay by no more; beyond, the clocks have drifted
GRAIN_S = 1e-6  # above the rounding of Unix times to doubles, 2.4e-7 s: that is no drift
AHEAD_S = 0.03  # a message may be faster than all before by this plus a tick
AGREE_S = 0.1  # largest difference of the delays of messages of one clock
GAP_MAX_S = 0.5  # longest gap between two such messages
PATIENCE_S = 10.0  # queues of some seconds grow or drain meanwhile
QUEUE_MAX_S = 10.0  # a longer queue (256 samples at 20 Hz) needs time to fill
STAMP_MAX_S = 2.0**32  # the year 2106; ROS 2 and Unix times end before


class Reading(TextEnum):
    """Result of the check of a time stamp."""

    FRESH = "in time"
    STEPPED = "by a clock that was set, or began anew"
    UNUSABLE = "not between 1970 and 2106"
    REPEATED = "repeated"
    OUT_OF_ORDER = "out of order"
    AHEAD = "from the future"
    LATE = "too late"

    @property
    def good(self) -> bool:
        """Whether the message may be used."""
        return self is Reading.FRESH or self is Reading.STEPPED


class SenderClock:
    """Estimate of the clock of one sender; ``memory`` is its whole state."""

    memory: ClockMemory
    ahead_max_s: float
    _late_max_s: float  # lateness from which a message is refused
    _proof_s: float  # time for which refused messages have to agree, until their clock is followed
    # fall-back of a clock after a silence from which it is followed at once: no healthy stream is disturbed
    _reboot_s: float

    def __init__(
        self,
        late_max_s: float,
        proof_s: float,
        tick_s: float = 0.0,
        reboot_s: float = math.inf,
        memory: ClockMemory | None = None,
    ) -> None:
        self.memory = memory or ClockMemory()
        self.ahead_max_s = AHEAD_S + tick_s
        self._late_max_s, self._proof_s, self._reboot_s = late_max_s, proof_s, reboot_s

    def accept(self, stamp_s: float, arrival_s: float, patience_s: float = PATIENCE_S) -> Reading:
        """Judge a time stamp, and learn from one that is good."""
        reading = self.judge(stamp_s, arrival_s, patience_s)
        if reading.good:
            self.take(stamp_s, arrival_s)
        return reading

    def judge(self, stamp_s: float, arrival_s: float, patience_s: float = PATIENCE_S) -> Reading:
        """Judge a time stamp; only ``take`` learns from it."""
        memory, way_s = self.memory, arrival_s - stamp_s
        if not 0.0 <= stamp_s <= STAMP_MAX_S:  # also NaN
            return Reading.UNUSABLE
        if stamp_s > memory.stamp_s:
            known = arrival_s - memory.began_s >= self._proof_s  # before, a queue from the start may drain
            if known and way_s < memory.floor_s - self.ahead_max_s:
                reading = Reading.AHEAD
            elif way_s - memory.offset_s > self._late_max_s or self._goes_on_late(way_s, arrival_s):
                reading = Reading.LATE
            else:
                return Reading.FRESH
        else:
            reading = Reading.REPEATED if stamp_s == memory.stamp_s else Reading.OUT_OF_ORDER
        return self._refused(reading, stamp_s, arrival_s, patience_s)

    @rare
    def _refused(self, reading: Reading, stamp_s: float, arrival_s: float, patience_s: float) -> Reading:
        """The same, or ``STEPPED`` where refused messages have agreed for long enough."""
        needed_s = self._proof_s if self._noted(reading, stamp_s, arrival_s) else patience_s
        return Reading.STEPPED if arrival_s - self.memory.run_since_s >= needed_s else reading

    def take(self, stamp_s: float, arrival_s: float) -> bool:
        """Learn from an accepted stamp; returns whether the sender's clock was set or restarted."""
        memory, way_s = self.memory, arrival_s - stamp_s
        newest = memory.run_stamp_s == stamp_s and memory.run_arrival_s == arrival_s
        stepped = newest and memory.run_since_s < math.inf
        if stepped or memory.began_s == math.inf:
            memory.began_s = arrival_s
        if stepped:
            memory.offset_s = memory.floor_s = memory.run_way_s
            memory.held_s = 0.0
        else:
            elapsed_s = min(arrival_s - memory.taken_s, ELAPSED_MAX_S)
            memory.held_s = memory.held_s + elapsed_s if way_s > memory.offset_s + GRAIN_S else 0.0
            if memory.held_s > HOLDS_S:
                memory.offset_s += FORGETS * elapsed_s
            if way_s > memory.floor_s + GRAIN_S:
                memory.floor_s += FORGETS_SLOWLY * elapsed_s
            memory.offset_s = min(way_s, memory.offset_s)
            memory.floor_s = max(min(way_s, memory.floor_s), memory.offset_s - FLOOR_MAX_S)
        memory.stamp_s, memory.taken_s = stamp_s, arrival_s
        memory.run_since_s, memory.run_sure = math.inf, False
        return stepped

    def lateness_s(self, stamp_s: float, now_s: float) -> float:
        """Age of a message with this stamp, at a time of our clock."""
        return max(0.0, now_s - stamp_s - self.memory.offset_s)

    def _goes_on_late(self, way_s: float, arrival_s: float) -> bool:
        """Whether messages of a clock that was set back a little have caught up with the newest stamp."""
        m = self.memory
        return way_s - m.offset_s > AGREE_S and m.run_sure and self._agrees(way_s, arrival_s)

    def _agrees(self, way_s: float, arrival_s: float) -> bool:
        m = self.memory
        in_time = m.run_since_s <= arrival_s <= m.run_arrival_s + GAP_MAX_S
        return in_time and abs(way_s - m.run_way_s) <= AGREE_S

    @rare
    def _noted(self, reading: Reading, stamp_s: float, arrival_s: float) -> bool:
        """Store a refused message; returns whether no delay explains the messages that agree with it."""
        m, way_s = self.memory, arrival_s - stamp_s
        if stamp_s > m.run_stamp_s and self._agrees(way_s, arrival_s):
            m.run_way_s = min(m.run_way_s, way_s)
        else:
            before_s = m.run_arrival_s if m.run_since_s < math.inf else m.taken_s
            silent = arrival_s - before_s > GAP_MAX_S
            began = silent and way_s - m.offset_s > QUEUE_MAX_S  # and it did not grow to that
            sure = began or reading in (Reading.AHEAD, Reading.OUT_OF_ORDER)
            m.run_since_s, m.run_way_s, m.run_sure = arrival_s, way_s, sure
            if silent and m.stamp_s - stamp_s > self._reboot_s:
                m.run_since_s = -math.inf
        m.run_stamp_s, m.run_arrival_s = stamp_s, arrival_s
        return m.run_sure
