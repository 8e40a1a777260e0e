"""Tables of a fleet's report as HTML: members, result, pairs, who waited, messages between members."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from logs.reader.fleet_messages import FleetMessages, waited_s
from logs.reader.flight_data import Fleet
from logs.report.page import html, paragraph, table, time_link
from logs.report.tables import YES_NO, definitions, number, scaled
from logs.verdict.verdict import FleetVerdict

_DASH = "\N{WORD JOINER}–\N{WORD JOINER}"  # no line breaks at it


def members_table(verdict: FleetVerdict, words: FleetMessages, pages: Mapping[str, Path]) -> str:
    rows = []
    for name, v in verdict.members.items():
        place = html('<a href="{}">{}</a>').format(pages[name].name, name) if name in pages else name
        rows.append(
            (place, v.outcome.value, YES_NO[v.violation], number(v.h_min_outside_pad_m, 3),
             scaled(v.touchdown_error_m, 100.0, 1), number(v.touchdown_speed_vertical_m_s, 2),
             number(v.touchdown_speed_horizontal_m_s, 2), number(v.time_to_land_s, 1),
             number(waited_s(words.spans[name]), 1), v.reason)
        )  # fmt: skip
    head = ("vehicle", "outcome", "barrier violated", "lowest h [m]", "error [cm]", "down [m/s]",
            "aside [m/s]", "landed after [s]", "waited [s]", "because")  # fmt: skip
    return table(head, rows, numbers=range(3, 9))


def fleet_result_table(verdict: FleetVerdict) -> str:
    v = verdict
    rows = [
        ("outcome", v.outcome.value, "", v.reason),
        ("barrier violation", YES_NO[v.violation], "", "of any member over its pad"),
        ("pairs that collided", _count(v.collisions), "", "their shapes overlapped"),
        (
            "ellipsoid violations",
            _count(v.ellipsoid_violations),
            "",
            "times that two came inside, both in flight",
        ),
        (
            "smallest distance in the ellipsoid's measure",
            number(v.ellipsoid_min, 2),
            "1",
            "both in flight; below 1: inside",
        ),
        ("smallest distance", number(v.distance_min_m, 3), "m", "of two centres of mass, at any time"),
    ]
    return table(("fleet", "value", "unit", "meaning"), rows, numbers=(1,)) + definitions()


def _count(value: int | None) -> str:
    return "not known" if value is None else str(value)


def pairs_table(fleet: Fleet) -> str:
    if not fleet.pairs:
        return paragraph("The log has nothing of the simulator about pairs.")
    rows = []
    for (one, other), pair in sorted(fleet.pairs.items()):
        names = f"{fleet.ids.get(one, one)}{_DASH}{fleet.ids.get(other, other)}"
        least, flying_m = (
            None if np.isinf(v) else v for v in (pair.ellipsoid_min, pair.flying_distance_min_m)
        )
        hit = "–" if pair.collided_ms < 0 else f"{pair.collided_ms * 1e-3:.2f}"
        rows.append(
            (
                names,
                number(least, 2),
                number(flying_m, 3),
                str(pair.violations),
                number(pair.inside_ms * 1e-3, 2),
                hit,
            )
        )
    head = ("pair", "measure [1]", "distance [m]", "times inside", "inside [s]", "collided [s]")
    return table(head, rows, numbers=range(1, 6))


def waits_table(words: FleetMessages) -> str:
    spans = [(name, span) for name, each in words.spans.items() for span in each if span.waits]
    if not spans:
        return paragraph("Nobody waited.")
    rows = [
        (time_link(span.begin_s, f"{span.begin_s:.2f}"), name, ", ".join(span.gives_way_to),
         f"{span.end_s - span.begin_s:.2f}")
        for name, span in sorted(spans, key=lambda each: each[1].begin_s)
    ]  # fmt: skip
    return table(("from [s]", "who", "for whom", "for [s]"), rows, numbers=(0, 3))


def messages_table(words: FleetMessages) -> str:
    if not words.links:
        return paragraph("The log has no messages between members.")
    rows = []
    for link in words.links:
        lost = max(0, link.sent - link.used)
        share = f"{100.0 * lost / link.sent:.1f}" if link.sent else "–"
        silent_s = sum(until_s - begin_s for begin_s, until_s in link.silent)
        rows.append(
            (f"{link.sender} to {link.receiver}", str(link.sent), str(link.used), share,
             scaled(link.late_max_s, 1e3, 0), scaled(link.gap_max_s, 1e3, 0), number(silent_s, 2))
        )  # fmt: skip
    head = ("from, to", "sent", "used", "not used [%]", "latest [ms]", "longest gap [ms]", "silent [s]")
    return table(head, rows, numbers=range(1, 7))
