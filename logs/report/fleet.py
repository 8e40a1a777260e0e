"""The report of a fleet: a page of all members together, and one of each as a single flight has it."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from logs.reader.fleet_words import Words, load_words, waited_s
from logs.reader.flight_data import Fleet
from logs.report.page import (
    block,
    details,
    header,
    html,
    need_libraries,
    page,
    paragraph,
    repeat_box,
    section,
    table,
    time_bar,
    time_link,
    warnings_box,
)
from logs.report.report import command, write_page
from logs.report.report import warnings as warnings_of
from logs.report.tables import (
    EVENTS_MAX,
    HEADLINES,
    YES_NO,
    definitions,
    number,
    scaled,
    severity,
    versions_table,
)
from logs.schema.names import FLEET, TEAM
from logs.verdict.fleet import FleetVerdict, pairs_known
from logs.verdict.pairs import PairSeries, pair_series
from logs.verdict.types import RADIUS_ABOVE_M, RADIUS_BESIDE_M, SOURCES, Outcome

_TICK_S = 0.011  # true states are this far apart; the ellipsoid is judged every millisecond
_DASH = "\N{WORD JOINER}–\N{WORD JOINER}"  # no line breaks at it
_SPEED_M_S = 4.0  # at which two vehicles may come nearer between two of them
_EQUAL = 1e-3  # of the measure: a true state between two ticks is not in the log
_LANES = (
    "Two lanes for each member: its phase, and what it told the others that it was about to do. Orange: it "
    "flew and gave way to another one. Red, where there are any: a member heard nothing of another one for "
    "longer than it lets pass. Touch or point at a bar to read it."
)
_ROOM = (
    "True paths, or the vehicles' own estimates where the log has no true states. Dotted: the pads. Circle: "
    "start. Square: end."
)
_NEAR = (
    f"By true states. The ellipsoid of two vehicles has the semi-axes {2 * RADIUS_BESIDE_M:g} m sideways and "
    f"{2 * RADIUS_ABOVE_M:g} m up and down; its measure is 1 on the surface, below is too near. It counts "
    "while both fly; thin: one of them rests. Dotted, in metres, of up to three pairs: the limit along the "
    "line between the two. Of many pairs the nearest are shown at first; touch a name to show or hide one."
)
_BARRIERS = "h of each member over its own pad since its landing began; below zero is unsafe outside the pad."
_WAITS = "Times in which a member flew and gave way to others, by its own words."
_WAYS = (
    "Taken: words that a tick of the hearer was given. The others got lost, or a newer one overtook them. "
    "Silent: time beyond the greatest age of a word, while the other one flew."
)


class Pages(NamedTuple):
    page: Path
    members: dict[str, Path]


def write_fleet(fleet: Fleet, verdict: FleetVerdict, out: Path | None = None) -> Pages:
    """Write the report of a judged fleet, by default beside its log, and the members' pages beside it."""
    need_libraries()
    target = fleet.path.with_suffix(".html") if out is None else out
    target.parent.mkdir(parents=True, exist_ok=True)
    members = {name: target.with_name(f"{target.stem}_{name}{target.suffix}") for name in fleet.flights}
    for name, place in members.items():
        write_page(fleet.flights[name], verdict.members[name], place, of=target.name)
    target.write_text(render(fleet, verdict, members), encoding="utf-8")
    return Pages(target, members)


def render(fleet: Fleet, verdict: FleetVerdict, pages: Mapping[str, Path]) -> str:
    """Return the page of the fleet as text."""
    from logs.report import fleet_figures as figures

    told = fleet.metadata.get(FLEET, {})
    words = load_words(fleet)
    series = pair_series(fleet)
    badge, style = _headline(verdict)
    body = (
        header(told.get("scenario", fleet.path.stem), badge, style, _subtitle(told, verdict)),
        warnings_box(_warnings(fleet, verdict, words, series)),
        block("result", "Result", _source(verdict), _members(verdict, words, pages) + _result(verdict)),
        time_bar(events=True),
        section("timeline", "Who did what, and who waited for whom", "", _LANES, figures.lanes(fleet, words)),
        section("room", "All paths in the room", "", _ROOM, figures.room_3d(fleet)),
        section("plan", "Paths from above", "", _ROOM, figures.plan(fleet)),
        section("pairs", "Distance of each pair", "", _NEAR, figures.distances(fleet, series)),
        section("barriers", "Barrier value of each member", "", _BARRIERS, figures.barriers(fleet)),
        '<div class="columns">',
        block("near", "How near they came", "Judged every physics step, while both flew.", _pairs(fleet)),
        block("waits", "Who waited for whom", _WAITS, _waits(words)),
        "</div>",
        block("words", "Words that they told each other", _WAYS, _ways(words)),
        block(
            "events",
            "Events of all",
            "Times since the log began; each is a link.",
            _events(fleet),
            "wide events",
        ),
        _repeat(fleet, told),
        block("versions", "Versions", "", versions_table(fleet.metadata)),
        _configuration(fleet),
        html("<footer>Log: {}. Frames: east, north, up; SI units.</footer>").format(fleet.path.name),
    )
    return page(told.get("scenario", fleet.path.stem), "".join(body))


def _headline(verdict: FleetVerdict) -> tuple[str, str]:
    text, style = HEADLINES[verdict.outcome]
    text = "All landed" if verdict.outcome is Outcome.LANDED else text
    also = ["a barrier violation"] if verdict.violation else []
    also += ["an ellipsoid violation"] if verdict.ellipsoid_violations else []
    if also:
        return f"{text}, with {' and '.join(also)}", "fair" if style == "good" else style
    return text, style


def _subtitle(told: Mapping[str, str], verdict: FleetVerdict) -> str:
    shown = [f"seed {told['seed']}"] if "seed" in told else []
    shown += [told["mode"]] if "mode" in told else []
    return " · ".join([f"{len(verdict.members)} vehicles", *shown, verdict.reason])


def _source(verdict: FleetVerdict) -> str:
    judged = dict.fromkeys(SOURCES[each.judged_from] for each in verdict.members.values())
    return f"Judged from {' and '.join(judged)}. The fleet has landed when all its members have."


def _warnings(fleet: Fleet, verdict: FleetVerdict, words: Words, series: Sequence[PairSeries]) -> list[str]:
    texts = [
        f"{name}: {text}"
        for name, flight in fleet.flights.items()
        for text in warnings_of(flight, verdict.members[name])
    ]
    texts += words.problems
    if not pairs_known(fleet):
        texts.append(
            "the simulator did not follow all pairs to the end: a collision or an ellipsoid violation cannot "
            "be excluded"
        )
    drawn = min(
        (float(np.min(pair.measure[pair.flying])) for pair in series if pair.flying.any()), default=None
    )
    if drawn is not None and verdict.ellipsoid_min is not None:
        passed = _SPEED_M_S * _TICK_S / (2.0 * RADIUS_BESIDE_M)
        if not -_EQUAL <= drawn - verdict.ellipsoid_min <= passed:
            texts.append("the ellipsoid drawn here is not the one that the simulator judged by")
    return texts


def _members(verdict: FleetVerdict, words: Words, pages: Mapping[str, Path]) -> str:
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


def _result(verdict: FleetVerdict) -> str:
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


def _pairs(fleet: Fleet) -> str:
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


def _waits(words: Words) -> str:
    spans = [(name, span) for name, each in words.spans.items() for span in each if span.waits]
    if not spans:
        return paragraph("Nobody waited.")
    rows = [
        (time_link(span.begin_s, f"{span.begin_s:.2f}"), name, ", ".join(span.gives_way_to),
         f"{span.end_s - span.begin_s:.2f}")
        for name, span in sorted(spans, key=lambda each: each[1].begin_s)
    ]  # fmt: skip
    return table(("from [s]", "who", "for whom", "for [s]"), rows, numbers=(0, 3))


def _ways(words: Words) -> str:
    if not words.ways:
        return paragraph("The log has no words of a fleet.")
    rows = []
    for way in words.ways:
        lost = max(0, way.told - way.taken)
        share = f"{100.0 * lost / way.told:.1f}" if way.told else "–"
        silent_s = sum(until_s - begin_s for begin_s, until_s in way.silent)
        rows.append(
            (f"{way.teller} to {way.hearer}", str(way.told), str(way.taken), share,
             scaled(way.late_max_s, 1e3, 0), scaled(way.gap_max_s, 1e3, 0), number(silent_s, 2))
        )  # fmt: skip
    head = ("from, to", "told", "taken", "not taken [%]", "latest [ms]", "longest gap [ms]", "silent [s]")
    return table(head, rows, numbers=range(1, 7))


def _events(fleet: Fleet) -> str:
    if not fleet.events:
        return paragraph("No events in this log.")
    shown = fleet.events[:EVENTS_MAX]
    rows = [(time_link(e.t_s, f"{e.t_s:.2f}"), severity(e.level), e.source, e.text) for e in shown]
    told = table(("time [s]", "level", "from", "event"), rows, numbers=(0,), row_class=1)
    more = len(fleet.events) - len(shown)
    return told + paragraph(f"{more} later events are in the log only.") if more else told


def _repeat(fleet: Fleet, told: Mapping[str, str]) -> str:
    again = shlex.join(["flightstack", "replay", fleet.path.name, "--check"])
    whole = fleet.attachments.get(TEAM)
    if whole is None or "seed" not in told:
        return repeat_box(replay=again)
    return repeat_box(
        replay=again,
        command=command(dict(told), TEAM),
        revision=fleet.metadata.get("made", {}).get("git_revision", ""),
        lockstep=told.get("mode") == "lockstep",
        scenario=details("The team as it was flown", whole.decode(errors="replace"), TEAM),
    )


def _configuration(fleet: Fleet) -> str:
    """Configurations of the members; what else was flown is in the team."""
    texts = [
        details(
            f"Configuration of {name}",
            flight.attachments["onboard.toml"].decode(errors="replace"),
            f"{name}.toml",
        )
        for name, flight in fleet.flights.items()
        if "onboard.toml" in flight.attachments
    ]
    inner = "".join(texts) or paragraph("The log holds none.")
    return html("<section><h2>Configurations</h2>{}</section>").format(html(inner))
