"""Which answer of PX4 belongs to which HIL_SENSOR. Pure.

PX4's clock is set by HIL_SENSOR.time_usec, and HIL_ACTUATOR_CONTROLS carries that clock: newer versions
count it from the first HIL_SENSOR they saw (drv_hrt.cpp), older ones do not. During its start PX4 answers
nothing, then begins to; from then on every HIL_SENSOR has an answer.
"""

from __future__ import annotations

from sim.px4.messages import Answer

FIRST_US = 1_000_000  # time of the first HIL_SENSOR; not zero, which PX4 takes for "not set"


class NoLockstepError(RuntimeError):
    """PX4 was built without lockstep; its clock is the wall's."""


class Lockstep:
    """Call ``sent`` with every HIL_SENSOR, ``take`` with every answer.

    Attributes:
        started: PX4 has begun to answer.
        old: answers that did not belong to the last HIL_SENSOR, passed over.
        newest_us: time in the newest answer; -1 before the first.
    """

    def __init__(self) -> None:
        self.started = False
        self.old = 0
        self.newest_us = -1
        self._sent_us: int | None = None
        self._before_us = -1  # newest answer when the last HIL_SENSOR went out
        self._behind_us = [0]  # by how much PX4's clock may be behind ours: not at all, or by the first time
        self._seen_us: int | None = None  # by how much it was behind at the last ``adopt``

    @property
    def expected_us(self) -> list[int]:
        """Times that the answer to the last HIL_SENSOR may carry."""
        sent_us = self._sent_us
        return [] if sent_us is None else [sent_us - behind_us for behind_us in self._behind_us]

    def sent(self, time_us: int) -> None:
        """A HIL_SENSOR of this time has gone out."""
        if self._sent_us is None:
            self._behind_us.append(time_us)
        self._sent_us = time_us
        self._before_us = self.newest_us

    def take(self, answer: Answer) -> bool:
        """Whether this answers the last HIL_SENSOR, so that the simulation may step.

        Raises:
            NoLockstepError: PX4 does not wait for the simulation.
        """
        if not answer.lockstep:
            raise NoLockstepError(
                "PX4's HIL_ACTUATOR_CONTROLS has no lockstep flag: it was built without lockstep; "
                "build px4_sitl_default, not px4_sitl_nolockstep"
            )
        if self._sent_us is None:
            return False
        self.started = True
        fresh = answer.time_us > self.newest_us
        self.newest_us = max(self.newest_us, answer.time_us)
        if fresh and answer.time_us in self.expected_us:
            return True
        self.old += 1
        return False

    def adopt(self) -> None:
        """Call after a long wait in vain: a clock that is neither of the two is believed the second time.

        Once may have been a late answer to an earlier HIL_SENSOR.
        """
        behind_us = None
        if self._sent_us is not None and self.newest_us > self._before_us:
            behind_us = self._sent_us - self.newest_us
            if behind_us == self._seen_us:
                self._behind_us = [behind_us]
        self._seen_us = behind_us
