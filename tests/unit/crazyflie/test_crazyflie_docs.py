"""The pages of the bridges against the code: every reason, option and number that they name."""

import inspect
import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner

from bridge.crazyflie import arming as crazyflie_arming
from bridge.crazyflie import checks as crazyflie_checks
from bridge.crazyflie import link as crazyflie_link
from bridge.crazyflie import pilot as crazyflie_pilot
from bridge.crazyflie import rules as crazyflie_rules
from bridge.crazyflie.link import EVENTS_MAX
from bridge.crazyflie.state import LATE_MAX_S
from bridge.mocap.checks import Limits, Refusal
from bridge.mocap.vehicle import WANTS
from flightstack.cli.real.bridge import bridge

DOCS = Path(__file__).parents[3] / "docs"
CRAZYFLIE = (DOCS / "how_to" / "crazyflie.md").read_text()
MOCAP = (DOCS / "how_to" / "mocap.md").read_text()


def options(verb):
    return {name for p in bridge.commands[verb].params for name in p.opts}


@pytest.mark.parametrize("page", [CRAZYFLIE, MOCAP])
def test_the_commands_are_understood(page):
    ran = 0
    for line in re.findall(r"^\$ flightstack bridge (.*)$", page, re.MULTILINE):
        verb, *words = shlex.split(line)
        given = {word for word in words if word.startswith("--")}
        assert given <= options(verb), line
        shown = CliRunner().invoke(bridge, [verb, "--help"])
        assert shown.exit_code == 0
        ran += 1
    assert ran >= 1


def test_every_option_that_is_described_exists():
    for name in re.findall(r"^\| `(--[a-z-]+)", MOCAP, re.MULTILINE):
        assert name in options("mocap") | options("crazyflie"), name


def test_every_reason_in_the_table_is_one_of_the_code():
    source = inspect.getsource(crazyflie_checks) + inspect.getsource(crazyflie_arming)
    table = CRAZYFLIE.split("## Why it refuses to arm")[1].split("## First flight")[0]
    reasons = [
        r for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE) for r in re.findall(r"`([^`]+)`", row)
    ]
    assert len(reasons) >= 14
    for reason in reasons:
        if reason.startswith("mocap"):
            continue
        words = re.sub(r"[0-9.]+ m\)|[0-9]+(\.[0-9]+)?|stabilizer\.estimator is|\.\.\.", "\0", reason)
        longest = max(words.split("\0"), key=len).strip(" :(,")
        assert longest in source, reason


def test_the_numbers_are_those_of_the_code():
    rules = crazyflie_rules
    for text in (
        f"silent for {rules.STREAM_S:g} s",
        f"after {rules.CLIENT_SILENT_S:g} s without a heartbeat",
        f"a text after {rules.SILENT_S:g} s, no heartbeat after {rules.LOST_S:g} s",
        f"opened anew\nafter {rules.RECONNECT_S:g} s".replace("\n", " "),
        f"for {rules.BLIND_LANDING_MAX_S:g} s at most",
        f"armed on the ground for {rules.IDLE_S:g} s",
        f"back within {rules.KILL_KEPT_S:g} s",
        f"`--speed-max` ({rules.SPEED_MAX_M_S:g} m/s)",
        f"{crazyflie_pilot.CLIMB_M_S:g} m/s up, {crazyflie_pilot.DESCENT_M_S:g} m/s down",
        f"within {crazyflie_arming.KILL_UNSEEN_S:g} s becomes an emergency stop",
        f"{crazyflie_checks.BATTERY_MIN_V:g} V needed",
        f"more than {LATE_MAX_S:g} s on its way",
        f"for more than {crazyflie_link.VELOCITY_AGE_MAX_S:g} s is not sent",
        f"a queue of {EVENTS_MAX}",
    ):
        assert text in CRAZYFLIE.replace("\n", " "), text


def test_the_rules_for_poses_are_those_of_the_code():
    limits, page = Limits(), MOCAP.replace("\n", " ")
    for refusal in Refusal:
        assert f"| {refusal.name.lower()} |" in page
    for text in (
        f"more than {limits.late_max_s:g} s later",
        f"more than {limits.room_m:g} m from zero",
        f"{limits.jump_m:g} m + {limits.speed_max_m_s:g} m/s",
        f"{limits.turn_rad:g} rad + {limits.turn_rate_max_rad_s:g} rad/s",
        f"within {limits.return_m:g} m of the last",
        f"for {limits.settle_s:g} s is believed",
        f"for {limits.gap_max_s:g} s, or with less than {limits.rate_min_hz:g}",
    ):
        assert text in page, text
    for wants in WANTS.values():
        assert f"{wants.rate_max_hz:g} Hz" in page
        for name in re.findall(r"[A-Z0-9]+_[A-Z0-9_]+", wants.settings):
            assert f"`{name}`" in page
