"""Tests the options that ``fly`` passes to the onboard process."""

import re
from dataclasses import MISSING, dataclass, replace
from pathlib import Path
from typing import Annotated

import click
import pytest
from click.testing import CliRunner

from bridge.crazyflie.rules import CrazyflieOptions
from bridge.mocap.checks import MocapOptions
from flightstack.cli.main import main
from flightstack.common.options import Option, argv, declared, takes
from flightstack.common.processes import LaunchError
from flightstack.common.strict_toml import ConfigError
from flightstack.config import load, path_of
from flightstack.config.options import FlightOptions, OnboardOptions, Piloted, WatchOptions, described
from flightstack.launch import fly
from flightstack.launch.launcher import Launcher
from flightstack.launch.run_options import FlyOptions, RunOptions
from flightstack.launch.sitl import endpoints, prepare
from sim.options import Px4SimOptions, TargetOptions, VehicleOptions
from sim.scenarios.scenario import load as load_scenario

ROOT = Path(__file__).parents[3]


@pytest.fixture
def started(monkeypatch):
    """Return a function that runs ``fly`` and returns its options for the onboard process."""
    seen = []

    def start(launcher, verb, options, of=""):
        seen.append(options)
        raise LaunchError("not flown here", 2)

    monkeypatch.setattr(Launcher, "start", start)
    monkeypatch.setattr(Launcher, "record", lambda launcher, log: log.parent)
    monkeypatch.setattr(fly, "describe", lambda *_: None)
    monkeypatch.setattr(fly, "dialled", lambda **_: (None, []))  # the test's file is no Zenoh configuration

    def fly_with(*words):
        done = CliRunner().invoke(main, ["fly", *map(str, words)])
        assert done.exit_code == 2  # exit status of the LaunchError above
        return seen[-1]

    return fly_with


def test_every_option_of_the_onboard_process_is_handed_on_as_it_was_given(started, tmp_path):
    given = OnboardOptions(
        vehicle_url="udpin:0.0.0.0:14540", config_file=path_of("crazyflie"), **others(FlightOptions, tmp_path)
    )
    words = [*argv(replace(given, no_record=False)), "--out", str(tmp_path)]
    found = started(*words)
    assert load(found.config_file) == load("crazyflie")
    assert found.recorder is not None
    own = {"config_file": found.config_file, "recorder": found.recorder, "no_record": False}
    assert found == replace(given, **own, listen=(*given.listen, found.listen[-1]))


def test_an_option_of_a_flight_is_in_its_log_once_it_is_declared():
    @dataclass(frozen=True, kw_only=True)
    class Noted(Piloted):
        note: Annotated[str, Option("--note", "Remark of the operator.")] = ""

    given = Noted(accept_release=True, note="windy")
    assert described(given, Noted) == {"accept_release": "true", "note": "windy"}
    assert described(given, Piloted) == {"accept_release": "true"}


def others(cls, folder):
    """Return a value for each option with a default; the value differs from the default."""
    file = folder / "file"
    file.write_text("{}")
    found = {
        "filter": "robust", "parameters": {"COM_OF_LOSS_T": 0.123456789}, "members": {2: "udpin:127.0.0.1:1"},
    }  # fmt: skip
    for name, option, kind, many, number, default in declared(cls):
        if default is MISSING or name in found:
            continue
        if kind is bool:
            value = not default
        elif kind is Path:
            value = folder if option.path == "folder" else path_of("crazyflie") if option.read else file
        elif kind is str:
            value = option.allowed[-1] if option.choices else "tcp/127.0.0.1:7447"
        else:
            value = kind(option.span[1] or 3)
        found[name] = (value,) if many else (-0.1, value, 3e-7) if number == 3 else value
    return {name: value for name, value in found.items() if name in {each.name for each in declared(cls)}}


@pytest.mark.parametrize(
    ("cls", "required"),
    [
        (OnboardOptions, {"vehicle_url": "udpin:127.0.0.1:0", "config_file": path_of("crazyflie")}),
        (FlyOptions, {"vehicle_url": "udpin:127.0.0.1:0", "config_file": path_of("crazyflie")}),
        (RunOptions, {"scenario": "grid"}),
        (VehicleOptions, {"scenario": "grid"}),
        (TargetOptions, {"scenario": "grid"}),
        (Px4SimOptions, {"scenario": "grid"}),
        (WatchOptions, {}),
        (CrazyflieOptions, {"uri": "usb://0"}),
        (MocapOptions, {"pose_key": "a/b", "vehicle_url": "udpin:127.0.0.1:0"}),
    ],
)
def test_a_command_line_made_of_options_gives_the_same_options(cls, required, tmp_path):
    found = []
    command = click.command()(takes(cls)(found.append))
    for given in (cls(**required), cls(**required, **others(cls, tmp_path))):
        command.main(argv(given), standalone_mode=False)
        assert found[-1] == given


@pytest.mark.parametrize(("scenario", "config"), [("grid", "px4-crazyflie"), ("large", "px4-1kg")])
def test_a_configuration_that_does_not_say_where_to_begin_begins_where_the_scenario_does(scenario, config):
    given = load_scenario(scenario).onboard.takeoff.start_offset_m
    assert load(config).takeoff.start_offset_m is None
    flown = prepare(RunOptions(scenario=scenario, px4=Path("px4"))).onboard
    assert flown.takeoff.start_offset_m == given
    assert flown.vehicle == load(config).vehicle


@pytest.mark.parametrize(
    ("members", "lockstep", "why"),
    [
        ("[[member]]\n[[member]]\n", False, "onboard.fleet.id: found 1, 1; each member needs its own id"),
        (
            "[onboard.fleet]\nid = 1\nmembers = [1, 2]\n[[member]]\n[[member]]\nonboard.fleet.id = 3\n"
            "onboard.fleet.members = [1, 3]\n",
            False, "member 1: onboard.fleet.members: 3 missing",
        ),
        ("[onboard.fleet]\nid = 1\nmembers = [1, 2]\n", True, "found members 2, which this command"),
    ],
)  # fmt: skip
def test_members_are_the_vehicles_of_the_run(members, lockstep, why, tmp_path):
    file = tmp_path / "team.toml"
    file.write_text(f'name = "team"\nbase = "field"\n{members}')
    with pytest.raises(ConfigError, match=why):
        prepare(RunOptions(scenario=str(file), lockstep=lockstep))


def test_sitl_flies_the_team_of_the_page_on_campaigns(tmp_path):
    page, file = (ROOT / "docs/how_to/campaign.md").read_text(), tmp_path / "team.toml"
    file.write_text(page[page.index('name = "mine"') :].partition("```")[0])
    assert len(prepare(RunOptions(scenario=str(file), lockstep=True)).members) == 2


@pytest.mark.parametrize(
    ("listen", "second"),
    [
        ([], []),
        (["tcp/0.0.0.0:7448"], ["tcp/0.0.0.0:7449"]),
        (["udp/[::1]:7448#iface=lo"], ["udp/[::1]:7449#iface=lo"]),
        (["tcp/127.0.0.1:0", "tcp/127.0.0.1:0"], ["tcp/127.0.0.1:0", "tcp/127.0.0.1:0"]),
        (["tcp/a:7448", "tcp/a:7450", "tcp/b:7448"], ["tcp/a:7449", "tcp/a:7451", "tcp/b:7449"]),
        (["tcp/a:65534"], ["tcp/a:65535"]),
    ],
)
def test_a_second_vehicle_listens_on_the_next_port(listen, second):
    assert endpoints(listen, 2) == [tuple(listen), tuple(second)]


def test_a_vehicle_alone_listens_on_each_endpoint_as_given():
    listen = ("unixsock-stream//run/watch", "tcp/127.0.0.1:65535", "tcp/127.0.0.1:7448", "tcp/127.0.0.1:7449")
    assert endpoints(listen, 1) == [listen]


@pytest.mark.parametrize(
    ("scenario", "listen", "why"),
    [
        ("fleet_3", ["tcp/a:7448", "tcp/a:7450"], "used twice: tcp/a:7450; .* at least 3 apart"),
        ("fleet_3", ["tcp/a:7448", "tcp/a:7449#iface=lo"], "used twice: tcp/a:7449, tcp/a:7450;"),
        ("lab", ["tcp/a:7448", "tcp/a:7448"], "used twice: tcp/a:7448;"),
        ("fleet_3", ["unixsock-stream//run/watch"], "found unixsock-stream//run/watch for 3 vehicles"),
        ("fleet_3", ["tcp/a:65534"], "found tcp/a:65534; .* ports 65534 to 65536, allowed is up to 65535"),
        ("lab", ["tcp/a"], "'tcp/a' is not understood"),
    ],
)
def test_endpoints_that_not_all_vehicles_can_have_are_refused_before_the_run(scenario, listen, why, tmp_path):
    words = [word for each in listen for word in ("--listen", each)]
    done = CliRunner().invoke(main, ["sitl", "--scenario", scenario, "--out", str(tmp_path / "run"), *words])
    assert done.exit_code == 2
    assert re.search(f"--listen: .*{why}", " ".join(done.output.split()))
    assert not (tmp_path / "run").exists()
