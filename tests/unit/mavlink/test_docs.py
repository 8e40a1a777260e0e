"""Compares the tables of the MAVLink documentation with the code."""

from __future__ import annotations

import re
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.parameters import INT32
from bridge.mavlink.server.profile import EVERY_TICK, FlightMode
from sim.autopilot.autopilot import px4_parameters
from sim.autopilot.flight import STREAM_LOST
from sim.autopilot.telemetry import STREAMS
from sim.plant.params import load
from sim.px4.airframe import parameters
from sim.px4.plant import DECLINATION_RAD, INCLINATION_RAD, STRENGTH_GAUSS
from tests.unit.autopilot.autopilot_fakes import Rig

DOCS = Path(__file__).parents[3] / "docs"


MAVLINK = (Path(__file__).parents[3] / "docs" / "reference" / "mavlink.md").read_text(encoding="utf-8")


def rows(section: str) -> list[list[str]]:
    """Return the cells of the first table under a heading."""
    lines = iter(MAVLINK.split(f"\n## {section}\n", 1)[1].splitlines())
    found = []
    for line in lines:
        if line.startswith("|"):
            found.append([cell.strip() for cell in line.strip("|").split("|")])
        elif found:
            break
    return found[2:]


def rate(message_id: int) -> str:
    if message_id == mav.MAVLINK_MSG_ID_HEARTBEAT:
        return "1 Hz, immediately after a change; not settable"
    if message_id not in STREAMS:
        return "on request; not settable"
    if message_id in EVERY_TICK:
        return "every tick"
    rate_hz = STREAMS[message_id][1]
    return f"{rate_hz:g} Hz" if rate_hz is not None else "off"


def test_messages() -> None:
    wanted = [[str(i), mav.mavlink_map[i].msgname, rate(i)] for i in sorted(Rig().autopilot.messages)]
    assert rows("Messages") == wanted


def test_commands() -> None:
    entries = Rig().autopilot.commands.table
    wanted = [
        [str(n), mav.enums["MAV_CMD"][n].name.removeprefix("MAV_CMD_"), entries[n].right.value]
        for n in sorted(entries)
    ]
    assert [row[:3] for row in rows("Commands")] == wanted


def test_parameters() -> None:
    wanted = [
        [
            p.name,
            "int" if p.type == INT32 else "real",
            f"{p.default:g}",
            p.allowed,
            "always" if p.in_flight else "disarmed",
        ]
        for p in px4_parameters(1)
        if p.low < p.high
    ]
    assert rows("Parameters") == wanted
    fixed = " ".join(MAVLINK.split("and fixed:", 1)[1].split(".", 1)[0].split()).split(", ")
    assert fixed == [p.name for p in px4_parameters(1) if p.low == p.high]


def test_fail_safe_actions() -> None:
    words = {FlightMode.HOLD: "hold", FlightMode.LAND: "land"}
    by_parameter = {row[1]: row[2] for row in rows("Fail-safes")}
    wanted = ", ".join(f"{value} {words[mode]}" for value, mode in STREAM_LOST.items())
    assert by_parameter["COM_OBL_RC_ACT"].split(";")[0] == wanted


PX4_WIRE = (DOCS / "reference" / "px4_sim.md").read_text()


def parameter_table():
    found = [parameters(load(airframe)) for airframe in ("crazyflie20", "quad_1000g")]
    rows = [f"| {name} | {found[0][name]} | {found[1][name]} |" for name in found[0]]
    return "\n".join(["| parameter | crazyflie20 | quad_1000g |", "|---|---|---|", *rows])


def test_the_table_of_parameters_is_what_the_verb_prints():
    assert (
        re.search(r"<!-- table: parameters -->\n(.*?)\n<!-- end -->", PX4_WIRE, re.DOTALL)[1]
        == parameter_table()
    )


def test_the_magnetic_field_is_that_of_px4_s_tables_at_the_origin():
    # corners of geo_magnetic_tables.hpp around the origin: rows 40 and 50 N, columns 0 and 10 E
    tables = {
        DECLINATION_RAD: (218, 580, 157, 660, 1e-4),
        INCLINATION_RAD: (9581, 9746, 11387, 11493, 1e-4),
        STRENGTH_GAUSS: (4513, 4593, 4860, 4911, 1e-4),
    }
    north, east = 0.7397742, 0.8545594
    for value, (a, b, c, d, unit) in tables.items():
        low, high = a + east * (b - a), c + east * (d - c)
        assert abs(value - (low + north * (high - low)) * unit) < 2e-5
