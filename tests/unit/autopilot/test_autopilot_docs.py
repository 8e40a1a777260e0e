"""docs/reference/mavlink.md says what the code does: its tables against the code's own."""

from __future__ import annotations

from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.parameters import INT32
from bridge.mavlink.server.profile import EVERY_TICK
from sim.autopilot.profiles import DEFAULT_HZ, px4_parameters
from sim.autopilot.telemetry import BUILDERS
from sim.autopilot.watches import FENCE, STATION_LOST, STREAM_LOST, Action
from tests.unit.autopilot.autopilot_fakes import Rig

TEXT = (Path(__file__).parents[3] / "docs" / "reference" / "mavlink.md").read_text(encoding="utf-8")


def rows(section: str) -> list[list[str]]:
    """Cells of the first table under a heading."""
    lines = iter(TEXT.split(f"\n## {section}\n", 1)[1].splitlines())
    found = []
    for line in lines:
        if line.startswith("|"):
            found.append([cell.strip() for cell in line.strip("|").split("|")])
        elif found:
            break
    return found[2:]


def rate(message_id: int) -> str:
    if message_id == mav.MAVLINK_MSG_ID_HEARTBEAT:
        return "1 Hz, at once on a change; not settable"
    if message_id not in BUILDERS:
        return "on request; not settable"
    if message_id in EVERY_TICK:
        return "every tick"
    return f"{DEFAULT_HZ[message_id]:g} Hz" if message_id in DEFAULT_HZ else "off"


def test_messages() -> None:
    wanted = [[str(i), mav.mavlink_map[i].msgname, rate(i)] for i in sorted(Rig().autopilot.messages)]
    assert rows("What it sends") == wanted


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
    fixed = TEXT.split("and fixed:\n", 1)[1].split(".", 1)[0].replace("\n", " ").split(", ")
    assert fixed == [p.name for p in px4_parameters(1) if p.low == p.high]


def test_fail_safe_actions() -> None:
    words = {Action.NONE: "nothing", Action.WARN: "warn", Action.HOLD: "hold", Action.RETURN: "return"}
    words[Action.LAND] = "land"
    by_parameter = {row[1]: row[2] for row in rows("Fail-safes")}
    for name, actions in (("NAV_DLL_ACT", STATION_LOST), ("GF_ACTION", FENCE)):
        assert by_parameter[name] == ", ".join(f"{value} {words[a]}" for value, a in actions.items())
    landing = [value for value, action in STREAM_LOST.items() if action is Action.LAND]
    assert by_parameter["COM_OBL_RC_ACT"].startswith(f"{landing[0]} and {landing[1]} land, 3 return, 5 hold")
