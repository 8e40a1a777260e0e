"""Tests the pre-flight check: unsafe and accepted parameters, and a limited number of requests."""

import math

import pytest

from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.preflight import examine as module
from bridge.mavlink.preflight.examine import Examination
from bridge.mavlink.preflight.table import Level, Needs, judge, table
from bridge.mavlink.profiles import CRAZYFLIE, OWN_SITL, PX4
from flightstack.common.strict_toml import ConfigError, from_table
from flightstack.core.parameters.flight import FlightConfig
from flightstack.onboard.preflight import check, needs_of, record, verdict
from sim.autopilot.autopilot import Autopilot, px4_parameters
from sim.scenarios import scenario
from tests.fake_autopilot import Served
from tests.unit.autopilot.autopilot_fakes import RATE_HZ, FakeVehicle
from tests.unit.onboard.safe_parameters import SAFE

NEEDS = Needs(0.5 * math.sqrt(2.0), 0.5, 1.0, 1.5, 3.0)


def asked(name):
    """Return the requested parameters with their rules, for ArduCopter 4.6 or else the newest release."""
    return table(name).asked(name, "4.6" if name == "ardupilot" else table(name).releases[-1])


def unsafe(name, values, needs=NEEDS, accepted=()):
    findings = judge(asked(name), values, {}, needs, accepted)
    return {f.name for f in findings if f.level is Level.UNSAFE}


@pytest.mark.parametrize("speeds", [(0.2828, 0.5), (1.054, 0.1), (5.0, 1.234)])
def test_the_speed_that_is_asked_for_suffices(speeds):
    needs = Needs(*speeds, 1.4, 1.0, 3.0)
    all_ = [each for name in ("px4", "sitl", "ardupilot") for r in table(name).releases
            for each in table(name).asked(name, r) if each.rule.means.endswith("speed")]  # fmt: skip
    assert len(all_) == 36
    for name, rule, _ in all_:
        number = float(rule.wanted_in(name, needs).split()[2]) * name.scale
        assert rule.safe(number, needs), name
        assert not rule.safe(0.97 * number, needs), name


def test_what_a_person_accepted_does_not_keep_it_from_arming():
    values = SAFE["px4", "1.18"] | {"COM_OF_LOSS_T": 2.0, "COM_OBL_RC_ACT": 0}
    assert unsafe("px4", values) == {"COM_OBL_RC_ACT", "COM_OF_LOSS_T"}
    assert unsafe("px4", values, accepted=("COM_OBL_RC_ACT",)) == {"COM_OF_LOSS_T"}
    assert unsafe("px4", {}, accepted=tuple(each.name.name for each in asked("px4"))) == set()
    findings = judge(asked("px4"), values, {}, NEEDS, ("COM_OF_LOSS_T",))
    (found,) = (f for f in findings if f.level is Level.ACCEPTED)
    assert (
        "COM_OF_LOSS_T is 2 s: for this time the vehicle flies with the last set-point; set it to 0.1 to 1 s"
        in found.text
    )


@pytest.mark.parametrize("name", scenario.names())
def test_the_simulators_own_parameters_are_safe_for_every_scenario(name):
    """No default value of the simulator is unsafe, so runs in lockstep may skip the check."""
    shown = {parameter.name: parameter.default for parameter in px4_parameters(1)}
    assert {each.name.name for each in asked("sitl") if each.rule.missing is None} <= set(shown)
    assert unsafe("sitl", shown, needs_of(scenario.load(name).onboard)) == set()


class Simulated:
    """The simulated autopilot; each call of ``step`` runs a tick; replies of the types ``mute`` are lost."""

    def __init__(self, *, mute=(), heartbeat=None, fake=None):
        self.autopilot, self.asked = Autopilot(fake or FakeVehicle(), RATE_HZ), []
        self._mute, self._heartbeat, self._ticks = mute, heartbeat, -1

    def step(self, _):
        self._ticks += 1
        beat = self._heartbeat
        return [beat] if beat is not None else self.autopilot.telemetry(self._ticks / RATE_HZ)

    def handle(self, m):
        self.asked.append(m)
        sender = (m.get_srcSystem(), m.get_srcComponent())
        replies = self.autopilot.handle(m, sender, self._ticks / RATE_HZ)
        return [reply for reply in replies if reply.get_type() not in self._mute]


class Vehicle(Served, Simulated):
    """The simulated autopilot on a socket."""


def talk(vehicle, chosen=None, **options):
    endpoint = Endpoint(vehicle.url, 1, 191)
    try:
        return Examination(endpoint, 1, chosen).report(NEEDS, (), wait_s=10.0, **options)
    finally:
        endpoint.close()
        vehicle.close()


def test_the_simulator_is_recognised_and_safe():
    vehicle = Vehicle()
    report = talk(vehicle)
    assert (report.profile, report.version, report.problem) == (OWN_SITL, "1.18.0", None)
    assert report.safe
    assert verdict(report) is None
    assert {f.name for f in report.findings} == {each.name.name for each in asked("sitl")}
    assert record(report)["COM_OF_LOSS_T"] == "0.5 ok"
    # the check only reads parameters
    assert {m.get_type() for m in vehicle.asked} == {"HEARTBEAT", "COMMAND_LONG", "PARAM_REQUEST_READ"}
    assert {m.command for m in vehicle.asked if m.get_type() == "COMMAND_LONG"} == {512}


def test_without_a_version_it_counts_as_the_real_one_whose_release_is_not_known(monkeypatch):
    monkeypatch.setattr(module, "_VERSION_TRIES", 2)
    report = talk(Vehicle(mute=("AUTOPILOT_VERSION",)))
    assert (report.profile, report.version) == (PX4, None)
    assert "no AUTOPILOT_VERSION in reply to 2 requests within 1 s" in verdict(report)
    assert "MAV_FWDEXTSP" in {f.name for f in report.blocking}  # only a real PX4 has this parameter
    assert "refused: DOES_NOT_EXIST" in next(f.why for f in report.findings if f.name == "MAV_FWDEXTSP")


def test_a_profile_that_is_given_needs_no_version(monkeypatch):
    monkeypatch.setattr(module, "_VERSION_TRIES", 1)
    for profile, rules in ((OWN_SITL, "1.18"), (CRAZYFLIE, None)):
        report = talk(Vehicle(mute=("AUTOPILOT_VERSION",)), chosen=profile)
        assert (report.profile, report.version, report.rules, report.safe) == (profile, None, rules, True)


@pytest.mark.parametrize(
    ("volts", "armed", "table", "refused"),
    [
        (3.62, False, True, True),
        (3.66, False, True, False),
        (3.62, True, True, False),
        (3.4, False, False, False),
    ],
)
def test_a_battery_too_low_to_land_is_refused_with_what_it_needs(volts, armed, table, refused):
    """A battery is checked at rest; in flight, the controller checks the voltage under load."""
    reserve = {"hover_throttle": 0.78, "hover_voltage_v": 3.7, "lowest_voltage_v": 3.2, "sag_v": 0.4}
    section = {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5}, **({"reserve": reserve} if table else {})}
    vehicle = Vehicle(fake=FakeVehicle(battery_v=volts, armed=armed))
    endpoint = Endpoint(vehicle.url, 1, 191)
    try:
        report = check(Examination(endpoint, 1), from_table(FlightConfig, section), wait_s=10.0)
    finally:
        endpoint.close()
        vehicle.close()
    told = verdict(report) or ""
    assert ("the battery has 3.62 V at rest, at least 3.65 V are needed" in told) == refused
    assert ("charge or change it" in told) == refused


def test_accepted_names_are_checked():
    section = {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5}}
    config = from_table(FlightConfig, section | {"vehicle": {"accepted_parameters": ["GUID_TIMEOUT"]}})
    assert config.vehicle.accepted_parameters == ("GUID_TIMEOUT",)
    for wrong, words in (
        ({"accepted_parameters": ["guid_timeout"]}, "in capitals"),
        ({"accepted_parameters": [""]}, "found ''"),
        ({"accepted_parameters": ["ABCDEFGHIJKLMNOPQ"]}, "at most 16"),
        ({"origin_wgs84": [91.0, 0.0, 10.0]}, "latitude of -90 to 90"),
        ({"origin_wgs84": [47.0, 8.0, 0.0]}, "height of 0 m; ArduPilot takes 0 .* or 10 where"),
        ({"origin_wgs84": [47.0, 8.0, -0.004]}, "height of -0.004 m"),
        ({"origin_wgs84": [47.0, 8.0]}, "an array of 3 values"),
    ):
        with pytest.raises(ConfigError, match=words):
            from_table(FlightConfig, section | {"vehicle": wrong})
