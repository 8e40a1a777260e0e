"""The paper's filter, eq. 11 as printed, as the base class implements it."""

from __future__ import annotations

from typing import Annotated

from flightstack.core.memory import MotionMemory
from flightstack.core.numeric import UNSEEN
from flightstack.core.strategies.strategy import Filter


class PaperFilter(Filter):
    """Eq. 11 as printed: the velocity loop is taken to be perfect, and nothing is estimated."""

    certificate = "flightstack.verify.certificate:paper_checks"
    watches_swinging = False  # as printed: it has no model of the velocity loop
    waits_filtered = False
    motion: Annotated[MotionMemory, UNSEEN]  # it estimates nothing
