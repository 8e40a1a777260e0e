"""Generates the certificate's tables of docs/how_it_works. This command writes them into the pages:

python -m tests.unit.verify.certificate_page
"""

import math
from pathlib import Path

from flightstack.verify.certificate import checks
from flightstack.verify.envelope import extremes
from flightstack.verify.feedback import follow_m
from flightstack.verify.fleet import fleet_checks
from flightstack.verify.robust import between_ticks_m, demand, depth_m, outside
from flightstack.verify.touchdown import descent_time_s, drift_m
from sim.scenarios import scenario
from sim.vehicle.declared import crowd

PAGES = Path(__file__).parents[3] / "docs" / "how_it_works"
TIERS = ("lab", "room", "field", "storm", "deck")
BEGIN, END = "<!-- table: {} -->", "<!-- end -->"


def _row(name, values):
    return f"| {name} | " + " | ".join(values) + " |"


def _table(first, rows):
    head = [_row(first, [f"`{tier}`" for tier in TIERS]), "|---" * (len(TIERS) + 1) + "|"]
    return "\n".join([*head, *rows])


def worked():
    """Return the table of the values that the certificate computes for each tier."""
    found = [(c, extremes(c)) for c in (scenario.load(tier).onboard for tier in TIERS)]

    def row(name, value):
        return _row(name, [value(c, x) for c, x in found])

    return _table(
        "quantity",
        [
            row("target: speed, climb, m/s", lambda c, x: f"{x.target_speed_m_s:g}, {x.target_climb_m_s:g}"),
            row("target: acceleration, m/s²", lambda c, x: f"{x.target_acceleration_m_s2:g}"),
            row("tracking error ē, m/s", lambda c, x: f"{c.robust.tracking_error_m_s:g}"),
            row("ē / γ, mm", lambda c, x: f"{1e3 * c.robust.tracking_error_m_s / c.robust.rate_1_s:.1f}"),
            row("position error k σ: horizontal, vertical, mm",
                lambda c, x: f"{1e3 * x.position_error_m:.1f}, {1e3 * x.height_error_m:.1f}"),
            row("margin m, mm", lambda c, x: f"{1e3 * x.usual.margin_m.low:.1f}"),
            row("margin m at the age limit, mm", lambda c, x: f"{1e3 * x.shape.margin_m.high:.1f}"),
            row("loss of h between ticks, mm", lambda c, x: f"{1e3 * between_ticks_m(c, x):.1f}"),
            row("loss of h between samples, mm", lambda c, x: f"{1e3 * x.growth_m:.1f}"),
            row("lower bound of h outside the pad, mm", lambda c, x: f"{-1e3 * depth_m(c, x)[0]:.1f}"),
            row("γ, limit 1 / lag_z of the slowest vehicle, 1/s",
                lambda c, x: f"{c.robust.rate_1_s:g}, {1.0 / x.lag_z_s:.2f}"),
            row("vertical velocity: required, in the box, m/s",
                lambda c, x: f"{_climb(c, x):.2f}, {c.limits.velocity_max_m_s[2]:g}"),
            row("longest last descent, s", lambda c, x: f"{descent_time_s(c, x):.2f}"),
            row("commit: radius, mm; slip, m/s",
                lambda c, x: f"{1e3 * c.robust.commit_radius_m:.0f}; {c.robust.commit_speed_m_s:g}"),
            row("largest distance from the middle after the commit, mm",
                lambda c, x: f"{1e3 * (drift_m, follow_m)[c.velocity_feedback.horizontal](c, x)[0]:.0f}"),
            row("h for a go-around: required, mm; reserved, mm",
                lambda c, x: f"{1e3 * turn_back_m(c, x):.0f}; {1e3 * c.retreat.h_left_m:.0f}"),
        ]
    )  # fmt: skip


def _climb(c, x):
    worst = outside(x, lambda d: demand(x, x.shape.slope(d)))
    return worst.bound + x.target_climb_m_s + c.robust.tracking_error_m_s


def turn_back_m(c, x):
    """Return the height that is lost between the decision to go around and the start of the climb, m."""
    late_s = c.velocity_loop.slope_time_s + c.envelope.lag_spread * c.velocity_loop.lag_z_s
    late_s += 2.0 / c.loop.rate_hz + c.own.delay_s
    down = c.robust.descent_m_s
    return down * late_s + down**2 / (2.0 * c.robust.acceleration_max_m_s2[2])


def verdicts():
    results = [{k.name: k for k in checks(scenario.load(tier).onboard)} for tier in TIERS]
    names = list(dict.fromkeys(name for result in results for name in result))

    def word(check):
        if check is None or check.proven:
            return "–" if check is None else "proven"
        return "**unknown**" if math.isnan(check.room) else f"**{check.room:.2g} {check.unit}**"

    rows = [(name, [word(result.get(name)) for result in results]) for name in names]
    return _table("check", [_row(name, words) for name, words in rows if any("*" in w for w in words)])


def fleet():
    """Return the table with the checks of one member of `fleet_3` and with those of all members together."""
    found = scenario.load("fleet_3")
    results = [*fleet_checks(found.onboard), *crowd(found)]
    rows = [_row(check.name, [check.claim, _room(check), check.worst]) for check in results]
    return "\n".join(["| check | claim | distance to the limit | worst point |", "|---|---|---|---|", *rows])


def _room(check):
    room = f"{check.room:.3g} {check.unit}".strip()
    return room if check.proven else f"**not proven**, {room}"


def tables():
    return {
        "worked": (PAGES / "robust_filter.md", worked()),
        "verdicts": (PAGES / "robust_filter.md", verdicts()),
        "fleet": (PAGES / "fleet.md", fleet()),
    }


def split(text, name):
    """Return the text up to and with the table's begin mark, the table, and the text from its end mark on."""
    before, rest = text.split(BEGIN.format(name) + "\n", 1)
    within, after = rest.split(END, 1)
    return before + BEGIN.format(name) + "\n", within.rstrip("\n"), "\n" + END + after


if __name__ == "__main__":
    for name, (page, table) in tables().items():
        before, _, after = split(page.read_text(), name)
        page.write_text(before + table + after)
