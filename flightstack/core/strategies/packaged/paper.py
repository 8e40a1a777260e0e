"""Filter of eq. 11 as printed in the paper: it assumes a perfect velocity loop and has no estimators."""

from __future__ import annotations

from flightstack.core.strategies.strategy import Filter


class PaperFilter(Filter):
    """The base class, without the checks that need a model of the velocity loop."""

    certificate = "flightstack.verify.certificate:paper_checks"
    watches_swinging = False  # the paper's filter has no model of the velocity loop
    waits_filtered = False
