"""Faults that were injected into a flight: what was wrong, from when to when, as the events tell."""

from __future__ import annotations

from typing import NamedTuple

from logs.reader.flight_data import Flight

BEGINS, ENDS = "Fault: ", "Fault over: "
_RELAYED = "vehicle: "  # the onboard process repeats what the vehicle says
_ENOUGH = 200  # a page with more is not read


class FaultSpan(NamedTuple):
    """One fault; times as in the flight, ``over`` is False for one that lasted to the end of the log."""

    text: str
    begin_s: float
    end_s: float
    over: bool


def fault_spans(flight: Flight) -> list[FaultSpan]:
    """Faults in the order of their beginning; the same told by two processes counts once."""
    begun: dict[str, float] = {}
    found: list[FaultSpan] = []
    for event in flight.events:
        text = event.text.removeprefix(_RELAYED)
        if text.startswith(BEGINS):
            begun.setdefault(text.removeprefix(BEGINS), event.t_s)
        elif text.startswith(ENDS):
            name = text.removeprefix(ENDS)
            begin_s = begun.pop(name, None)
            if begin_s is not None:
                found.append(FaultSpan(name, begin_s, event.t_s, over=True))
    found += [FaultSpan(name, begin_s, flight.duration_s, over=False) for name, begin_s in begun.items()]
    return sorted(found, key=lambda span: span.begin_s)[:_ENOUGH]
