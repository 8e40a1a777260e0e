"""Generates the tables of docs/reference/autopilots.md. This command writes them into the page:

python -m tests.unit.mavlink.client.autopilots_page
"""

from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.line_budget import LineTooSlowError
from bridge.mavlink.line_budget import plan as line_plan
from bridge.mavlink.preflight.table import Level, Needs, table
from bridge.mavlink.profiles import ARDUPILOT, CRAZYFLIE, OWN_SITL, PX4
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import Barrier
from flightstack.core.types import Mode, Request
from flightstack.onboard.preflight import needs_of
from sim.scenarios import scenario
from tests.unit.verify.certificate_page import BEGIN, END, split

PAGE = Path(__file__).parents[4] / "docs" / "reference" / "autopilots.md"
PROFILES = (OWN_SITL, CRAZYFLIE, PX4, ARDUPILOT)
EXAMPLE = "lab"  # scenario whose configuration determines the required values in the tables


def _table(head, rows):
    lines = ["| " + " | ".join(cells) + " |" for cells in (head, *rows)]
    return "\n".join([lines[0], "|---" * len(head) + "|", *lines[1:]])


def _steps(profile, request):
    steps = profile.sequences[request]
    return ", ".join(f"{s.name} ({s.command}; {s.tries} × {s.period_s:g} s)" for s in steps)


def _takeoff_height(profile):
    own = any(step.command == dialect.MAV_CMD_NAV_TAKEOFF for step in profile.sequences[Request.TAKEOFF])
    above_home = "above home, plus the vehicle's height above home"
    height = above_home if profile.takeoff_above_home else "above sea level"
    return height if own else "not sent: the vehicle climbs by set-points"


def _modes(profile, mode):
    found = [number for number, of in profile.modes.items() if of is mode]
    return ", ".join(f"0x{n:08x}" if n > 0xFFFF else str(n) for n in found) or "no own mode"


TIME_SYNC = {
    "sitl": "requested in lockstep: it is the tick",
    "crazyflie": "not requested",
    "px4": "requested at 10 Hz, answered",
    "ardupilot": "answered on request; not needed",
}
STREAM_LOST = {
    "sitl": "COM_OBL_RC_ACT after COM_OF_LOSS_T; remains in that mode when the stream returns",
    "crazyflie": "the firmware stops the motors after 2 s, or the bridge lands it (--land-on-silence)",
    "px4": "COM_OBL_RC_ACT after COM_OF_LOSS_T; continues when the stream returns",
    "ardupilot": "stops after GUID_TIMEOUT, remains in GUIDED and armed; continues when the stream returns",
}


def _streams(profile):
    extra = [dialect.mavlink_map[n].msgname for n in profile.asked_hz]
    return "SET_MESSAGE_INTERVAL" + (f"; also {', '.join(extra)}" if extra else "")


def profiles():
    """Return the table of differences between autopilots."""
    rows = [
        ("`--autopilot`", lambda p: f"`{p.name}`"),
        ("MAV_AUTOPILOT of the heartbeat", lambda p: str(p.autopilot)),
        ("mode that follows set-points", lambda p: _modes(p, Mode.EXTERNAL)),
        ("mode of the take-off", lambda p: _modes(p, Mode.TAKEOFF)),
        ("modes that hold the position", lambda p: _modes(p, Mode.HOLD)),
        ("modes that land", lambda p: _modes(p, Mode.LAND)),
        ("first command on the ground", lambda p: ", ".join(s.name for s in p.prepare) or "nothing"),
        ("take-off", lambda p: _steps(p, Request.TAKEOFF)),
        ("height of the take-off", _takeoff_height),
        (
            "set-points during the take-off",
            lambda p: "allowed" if p.stream_in_takeoff else "not sent: a set-point would end it",
        ),
        (
            "set-points before the mode switch",
            lambda p: f"for {p.prestream_s:g} s" if p.prestream_s else "not needed",
        ),
        ("mode switch", lambda p: _steps(p, Request.EXTERNAL)),
        ("landing", lambda p: _steps(p, Request.LAND)),
        ("kill", lambda p: _steps(p, Request.MOTORS_OFF)),
        ("unused command parameters", lambda p: f"{p.unset:g}"),
        ("request of message rates", _streams),
        (
            "encoding of integer parameters",
            lambda p: "bytes of the integer" if p.bytewise else "converted to a float",
        ),
        (
            "origin sent by the stack",
            lambda p: "when `vehicle.origin_wgs84` is set" if p.needs_origin else "no",
        ),
        ("TIMESYNC", lambda p: TIME_SYNC[p.name]),
        ("result of a loss of set-points", lambda p: STREAM_LOST[p.name]),
    ]
    return _table(
        ["property", *(p.title for p in PROFILES)], [[n, *(value(p) for p in PROFILES)] for n, value in rows]
    )


def _needs() -> Needs:
    return needs_of(scenario.load(EXAMPLE).onboard)


_OTHERWISE = {
    Level.UNSAFE: "refused", Level.NOTE: "note", Level.INFO: "hint",
    Level.IGNORED: "",
}  # fmt: skip


def _releases(name):
    ends = (f"from {name.since}" if name.since else "", f"before {name.before}" if name.before else "")
    return f" ({' '.join(filter(None, ends))})" if any(ends) else ""


def rules(name):
    """Return the table of the checked parameters of an autopilot, for all its releases."""
    rows = [
        [
            each.name + _releases(each),
            rule.wanted_in(each, _needs()),
            _OTHERWISE[rule.severity],
            rule.text,
        ]
        for rule in table(name).rule
        if not rule.profiles or name in rule.profiles
        for each in rule.names
        if name != "sitl" or each.has(table(name).releases[-1])
    ]
    return _table(["parameter", "required value", "otherwise", "consequence of another value"], rows)


def line_rates():
    config = FlightConfig(barrier=Barrier(alpha_1_m=1.0, beta_m=1.5))
    rows = []
    for baud in (921_600, 115_200, 57_600, 38_400, 19_200):
        try:
            plan = line_plan(baud, config.loop.rate_hz, config.checks.own_age_max_s)
        except LineTooSlowError:
            rows.append((str(baud), "refused", "", ""))
            continue
        sizes = (f"{size:.0f} B/s" for size in (plan.in_bytes_s, plan.out_bytes_s))
        rows.append((str(baud), f"{plan.hz:.3g} Hz", *sizes))
    return _table(("baud", "rate of position, attitude and set-points", "received bytes", "sent bytes"), rows)


def tables():
    found = {"profiles": profiles(), "line rates": line_rates()}
    return found | {f"rules {p.name}": rules(p.name) for p in PROFILES if table(p.name)}


if __name__ == "__main__":
    page = PAGE.read_text()
    for name, made in tables().items():
        before, _, after = split(page, name)
        page = before + made + after
    PAGE.write_text(page)
    assert all(BEGIN.format(name) in page for name in tables())
    assert page.count(END) == len(tables())
