"""The paper's filter, eq. 11 as printed; the base class implements it."""

from __future__ import annotations

from typing import Annotated

from flightstack.core.memory import MotionMemory
from flightstack.core.numeric import UNSEEN
from flightstack.core.strategies.strategy import Filter


class PaperFilter(Filter):
    """Filter of eq. 11 as printed: it assumes a perfect velocity loop, and estimates nothing."""

    certificate = "flightstack.verify.certificate:paper_checks"
    watches_swinging = False  # the paper's filter has no model of the velocity loop
    waits_filtered = False
    motion: Annotated[MotionMemory, UNSEEN]  # unused, since this filter estimates nothing
