"""The paper's filter, eq. 11 as printed; the base class implements it."""

from __future__ import annotations

from flightstack.core.strategies.strategy import Filter


class PaperFilter(Filter):
    """Filter of eq. 11 as printed: it assumes a perfect velocity loop, and estimates nothing."""

    certificate = "flightstack.verify.certificate:paper_checks"
    watches_swinging = False  # the paper's filter has no model of the velocity loop
    waits_filtered = False
