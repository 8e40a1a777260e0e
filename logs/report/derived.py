"""Values that the report derives from a flight: faults, first contact, flights of a page."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from logs.reader.flight_data import Flight
from logs.schema.events import ContactBit
from logs.verdict.types import Verdict

BEGINS, ENDS = "Fault: ", "Fault over: "
_RELAYED = "vehicle: "  # prefix of the vehicle's texts in events of the onboard process
_ENOUGH = 200  # maximum number of shown faults


class FaultSpan(NamedTuple):
    """A fault, with start and end since the flight's origin, s; a missing end is the end of the log."""

    text: str
    begin_s: float
    end_s: float


def fault_spans(flight: Flight) -> list[FaultSpan]:
    """Return the faults in order of their start; a fault that two processes report counts once."""
    begun: dict[str, float] = {}
    found: list[FaultSpan] = []
    for event in flight.events:
        text = event.text.removeprefix(_RELAYED)
        if text.startswith(BEGINS):
            begun.setdefault(text.removeprefix(BEGINS), event.t_s)
        elif text.startswith(ENDS):
            name = text.removeprefix(ENDS)
            if (begin_s := begun.pop(name, None)) is not None:
                found.append(FaultSpan(name, begin_s, event.t_s))
    found += [FaultSpan(name, begin_s, flight.duration_s) for name, begin_s in begun.items()]
    return sorted(found, key=lambda span: span.begin_s)[:_ENOUGH]


class Side(NamedTuple):
    """A flight of one vehicle on a report page, with name, verdict and time offset."""

    name: str  # name of the vehicle
    flight: Flight
    verdict: Verdict
    offset_s: float  # offset that converts times of the flight to times of the page, s


def touch_index(flight: Flight) -> int | None:
    """Return the index of the first true state after the start of the landing that touches the pad."""
    truth, start_s = flight.truth, flight.landing_start_s
    if truth is None or start_s is None:
        return None
    found = np.flatnonzero((truth.contacts & ContactBit.PAD > 0) & (truth.t_s > start_s))
    return int(found[0]) if len(found) else None
