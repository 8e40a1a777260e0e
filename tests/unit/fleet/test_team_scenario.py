"""Tests team files: shared keys, keys of one member, and error messages with instructions."""

from dataclasses import replace

import pytest

from flightstack import config as configurations
from flightstack.common.strict_toml import ConfigError
from sim.scenarios import scenario


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "mine.toml"
        path.write_text(text)
        return path

    return write


ABOUT = 'name = "mine"\ndescription = "x"\n'


def test_a_member_overrides_the_team_and_the_team_its_base(written):
    found = scenario.load(
        written(
            ABOUT + 'base = "field"\nwind.mean_m_s = 0.0\n[[member]]\nwind.gust_rms_m_s = 0.1\n[[member]]\n'
        )
    )
    first, second = found.members
    assert (first.wind.mean_m_s, first.wind.gust_rms_m_s) == (0.0, 0.1)
    assert (second.wind.mean_m_s, second.wind.gust_rms_m_s) == (0.0, 0.6)
    assert [each.name for each, _ in found.singles(0)] == ["mine", "mine"]


BASED = ABOUT + 'base = "field"\n'
ANY = "[a-z_, 0-9]*"
FIRST, SECOND = BASED + "[[member]]\n", BASED + "[[member]]\n[[member]]\n"


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (ABOUT + 'base = "feild"\n[[member]]\n', "base: scenario 'feild': neither a file nor one of"),
        (ABOUT + "base = 3\n[[member]]\n", "base: found 3, the name of a scenario"),
        (BASED + "member = 3\n", r"member: found 3, allowed: tables \[\[member\]\]"),
        (BASED + "[[others]]\n", r"others: unknown key; give a table \[\[member\]\] for each vehicle"),
        (BASED + "sped = 1\n", f"sped: unknown key; allowed: base, {ANY}, member, (?!.*others)"),
        (BASED + "sped = 1\n[[member]]\n", f"sped: unknown key; allowed: base, {ANY}, member, "),
        (BASED + "[[membr]]\n", "membr: unknown key; did you mean member[?] "),
        (FIRST + "sped = 1\n", f"sped: unknown key; allowed: config, (?!.*(base|member|name)){ANY}, wind$"),
        (FIRST + "others = []\n", r"member 1: others: found \[\]; only the run has it, remove it"),
        (SECOND + "start.hight_m = 1.0\n", "member 2: start.hight_m: unknown key"),
        (FIRST + "target.speed_m_s = 9.0\n", "member 1: target.speed_m_s: found 9.0, allowed: 0 to 3"),
        (FIRST + 'name = "a"\n', "member 1: name: found 'a'; only the run has it, remove it"),
        (FIRST + 'config = "px5"\n', "member 1: config: configuration 'px5': neither a file nor one of"),
        (FIRST + "config = 3\n", "member 1: config: found 3, the name of a configuration"),
        (SECOND + "onboard.loop.rate_hz = 50\n", "found 50, 100; all members have the same ticks"),
    ],
)
def test_errors_say_what_was_found_and_what_to_do(written, text, error):
    with pytest.raises(ConfigError, match=error) as raised:
        scenario.load(written(text))
    assert "mine.toml: " in str(raised.value)


def test_a_member_can_have_a_configuration_of_its_own(written):
    text = """base = "grid"
onboard.checks.retries_max = 7
onboard.takeoff.start_offset_m = [-0.8, 0.3, 0.7]
[onboard.fleet]
members = [1, 2]
id = 1
rate_1_s = 0.3
reach_m = 8.0
[[member]]
[[member]]
config = "px4-crazyflie"
onboard.fleet.id = 2
onboard.checks.wait_time_max_s = 99.0
"""
    first, second = (each.onboard for each in scenario.load(written(ABOUT + text)).members)
    named = configurations.load("px4-crazyflie")
    assert second.velocity_loop == named.velocity_loop != first.velocity_loop
    assert second.checks == replace(named.checks, wait_time_max_s=99.0)  # replaces the value of the team
    assert second.takeoff == replace(named.takeoff, start_offset_m=(-0.8, 0.3, 0.7))
    assert second.fleet == replace(first.fleet, id=2)
    assert first.checks.retries_max == 7


def test_one_member_is_taken_with_its_seed_and_one_vehicle_as_it_is():
    singles = list(scenario.load("fleet_3").singles(5))
    assert [scenario.load("fleet_3").one(5, number) for number in (1, 2, 3)] == singles
    field, seed = scenario.load("field").one(5, None)
    wind = replace(field.wind, direction_rad=None)
    assert (replace(field, wind=wind), seed) == (scenario.load("field"), 5)


@pytest.mark.parametrize(
    ("name", "number", "error"),
    [
        ("fleet_3", None, "fleet_3: one vehicle is needed; the scenario has members 1 to 3"),
        ("fleet_3", 4, "fleet_3: found member 4; the scenario has members 1 to 3"),
        ("field", 2, "field: found member 2; the scenario has members 1 to 1"),
    ],
)
def test_a_member_that_there_is_not_is_refused(name, number, error):
    with pytest.raises(ConfigError, match=error):
        scenario.load(name).one(0, number)


def test_the_exchange_is_the_team_s(written):
    text = ABOUT + 'base = "field"\n[exchange]\ndelay_s = 0.02\nloss = 0.1\n[[member]]\n'
    assert scenario.load(written(text)).exchange == scenario.ExchangeLink(0.02, 0.1)
    with pytest.raises(ConfigError, match=r"exchange\.loss: found 2\.0, allowed: 0 to 1"):
        scenario.load(written(text.replace("0.1", "2.0")))


ROBOT = "[[member]]\n[member.target]\n"
LANE = ROBOT + 'path = "straight"\nspeed_m_s = 0.2\nturn_rate_rad_s = 0.0\nrandom_heading = false\n'
STANDS = ROBOT + 'path = "still"\nspeed_m_s = 0.0\nturn_rate_rad_s = 0.0\n'


@pytest.mark.parametrize(
    ("robots", "apart_m"),
    [
        (STANDS + STANDS + "position_m = [3.0, 4.0]\n", [5.0]),
        (LANE + STANDS + "position_m = [3.0, 4.0]\n", [4.0]),
        (LANE + "heading_rad = 0.5\n" + LANE + "heading_rad = 0.5\nposition_m = [0.0, 2.0]\n", [1.755]),
        (LANE + LANE + "heading_rad = 3.14159265358979\nposition_m = [9.0, 2.0]\n", [2.0]),
        (LANE + LANE + "heading_rad = 0.1\nposition_m = [0.0, 2.0]\n", [0.0]),  # the paths cross
        (STANDS + LANE.replace("turn_rate_rad_s = 0.0", "turn_rate_rad_s = 0.1"), [0.0]),
        (
            STANDS + "pad_behind_axle_m = 0.1\n" + STANDS + "position_m = [3.0, 4.0]\n",
            [0.0],
        ),  # unknown heading
        (STANDS, []),
    ],
)
def test_how_near_pads_can_come(written, robots, apart_m):
    found = scenario.load(written(ABOUT + 'base = "field"\n' + robots))
    assert found.pads_apart_m() == pytest.approx(apart_m, abs=1e-3)


TWO = ABOUT + 'base = "field"\none_target = true\n[[member]]\n[[member]]\n'


@pytest.mark.parametrize(
    ("more", "error"),
    [
        ("target.speed_m_s = 0.1\n", r"member 2: target: found another one .* give it once, in \[target\]"),
        ("odometry.loss = 0.2\n", r"member 2: odometry: found another one .* in \[odometry\]"),
        (
            '[[member.fault]]\nwhat = "target_odometry"\nkind = "off"\n',
            "member 2: fault: found one of the robot; with one_target the robot has none",
        ),
    ],
)
def test_one_robot_is_the_same_for_all_members(written, more, error):
    with pytest.raises(ConfigError, match=error):
        scenario.load(written(TWO + more))
