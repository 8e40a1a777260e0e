"""The pre-flight check: unsafe and accepted parameters, and the bounded dialogue."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.preflight import examine as module
from bridge.mavlink.preflight.examine import examine
from bridge.mavlink.preflight.table import Level, Needs, judge, table
from bridge.mavlink.profiles import ARDUPILOT, CRAZYFLIE, OWN_SITL, PX4
from flightstack.common.strict_toml import ConfigError, from_table
from flightstack.core.parameters.flight import FlightConfig
from flightstack.onboard.preflight import check, lines, needs_of, record, verdict
from sim.autopilot.autopilot import Autopilot
from sim.autopilot.parameters import px4_parameters
from sim.scenarios import scenario
from tests.fake_autopilot import OnUdp, Served
from tests.unit.autopilot.autopilot_fakes import RATE_HZ, FakeVehicle
from tests.unit.onboard.safe_parameters import ARDUPILOT_46_DEFAULT, SAFE, packed

NEEDS = Needs(0.5 * math.sqrt(2.0), 0.5, 1.0, 1.5, 3.0)
ARDUPILOT_UNSAFE = {"GUID_TIMEOUT", "FS_GCS_ENABLE", "SYSID_MYGCS"}  # unsafe with its defaults


def asked(name):
    """Return parameters of the newest release; for ArduCopter, those of the fake."""
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


def test_what_is_missing_says_why():
    findings = judge(asked("px4"), {}, {"COM_OF_LOSS_T": "no answer to 5 requests"}, NEEDS, ())
    assert all(f.level is not Level.OK for f in findings)
    (found,) = (f for f in findings if f.name == "COM_OF_LOSS_T")
    assert found.level is Level.UNSAFE
    assert "COM_OF_LOSS_T is missing: no answer to 5 requests; " in found.text


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
    """A lockstep flight, always with the simulator, skips the check."""
    shown = {parameter.name: parameter.default for parameter in px4_parameters(1)}
    assert {each.name.name for each in asked("sitl") if each.rule.missing is None} <= set(shown)
    assert unsafe("sitl", shown, needs_of(scenario.load(name).onboard)) == set()


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


class Simulated:
    """The simulated autopilot, a tick for each call of ``step``; replies of the types ``mute`` are lost."""

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


def talk(vehicle, chosen=None, wait_s=10.0, accepted=(), system_id=1, stopped=lambda: False):
    endpoint = Endpoint(vehicle.url, 1, 191)
    try:
        return examine(endpoint, system_id, chosen, NEEDS, accepted, wait_s=wait_s, stopped=stopped)
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
    # the check reads and never changes parameters
    assert {m.get_type() for m in vehicle.asked} == {"HEARTBEAT", "COMMAND_LONG", "PARAM_REQUEST_READ"}
    assert {m.command for m in vehicle.asked if m.get_type() == "COMMAND_LONG"} == {512}


def test_ardupilots_default_time_out_keeps_it_from_arming():
    version = packed("4.6")
    report = talk(OnUdp("ardupilot", version, ARDUPILOT_46_DEFAULT))
    assert (report.profile, report.version) == (ARDUPILOT, "4.6.0")
    assert {f.name for f in report.blocking} == ARDUPILOT_UNSAFE
    assert "GUID_TIMEOUT" in verdict(report)
    assert "accepted_parameters" in verdict(report)
    assert any(
        "UNSAFE: GUID_TIMEOUT is 3 s: for this time the vehicle flies with" in line for line in lines(report)
    )
    assert talk(OnUdp("ardupilot", version, ARDUPILOT_46_DEFAULT), accepted=ARDUPILOT_UNSAFE).safe


def test_a_lost_companion_comes_down_only_if_its_own_heartbeats_are_minded():
    """Both parameters are needed: FS_GCS_ENABLE alone reacts to the loss of another system."""
    values, needs = SAFE["ardupilot", "4.6"] | {"SYSID_MYGCS": 7}, NEEDS._replace(system_id=7)
    assert unsafe("ardupilot", values, needs) == set()
    for wrong in ({"FS_GCS_ENABLE": 0}, {"SYSID_MYGCS": 255}):
        assert unsafe("ardupilot", values | wrong, needs) == set(wrong)
    findings = judge(asked("ardupilot"), values | {"SYSID_MYGCS": 255}, {}, needs, ())
    (finding,) = (f for f in findings if f.name == "SYSID_MYGCS")
    assert "set it to 7 (the system id of companion and vehicle)" in finding.text


def test_the_accelerations_are_those_of_the_filter():
    robust, paper = (needs_of(scenario.load("lab").with_filter(kind).onboard) for kind in ("robust", "paper"))
    config = scenario.load("lab").onboard
    for needs, (x, y, z) in (
        (robust, config.robust.acceleration_max_m_s2), (paper, config.limits.slew_max_m_s2)
    ):  # fmt: skip
        assert (needs.horizontal_m_s2, needs.vertical_m_s2) == (math.hypot(x, y), z)


def test_parameters_that_do_not_come_make_it_unsafe():
    report = talk(Vehicle(mute=("PARAM_VALUE",)))
    assert not report.safe
    assert all(f.value is None for f in report.findings)
    assert "no answer" in report.blocking[0].text


def test_without_a_version_it_counts_as_the_real_one_whose_release_is_not_known(monkeypatch):
    monkeypatch.setattr(module, "_VERSION_TRIES", 2)
    report = talk(Vehicle(mute=("AUTOPILOT_VERSION",)))
    assert (report.profile, report.version) == (PX4, None)
    assert "no AUTOPILOT_VERSION in reply to 2 requests within 1 s" in verdict(report)
    assert "MAV_FWDEXTSP" in {f.name for f in report.blocking}  # the simulator lacks this parameter
    assert "refused: DOES_NOT_EXIST" in next(f.why for f in report.findings if f.name == "MAV_FWDEXTSP")


def test_a_profile_that_is_given_needs_no_version(monkeypatch):
    monkeypatch.setattr(module, "_VERSION_TRIES_UNNEEDED", 1)
    for profile, rules in ((OWN_SITL, "1.18"), (CRAZYFLIE, None)):
        report = talk(Vehicle(mute=("AUTOPILOT_VERSION",)), chosen=profile)
        assert (report.profile, report.version, report.rules, report.safe) == (profile, None, rules, True)


def test_unknown_autopilots_are_refused_before_anything_is_asked():
    beat = dialect.MAVLink_heartbeat_message(2, 17, 1, 0, 3, 3)
    vehicle = Vehicle(heartbeat=beat)
    report = talk(vehicle)
    assert report.findings == ()
    assert "ArduCopter, GUIDED (3)" in report.problem
    assert {m.get_type() for m in vehicle.asked} == {"HEARTBEAT"}


def test_nobody_there_is_a_failure_in_the_time_given():
    report = talk(Vehicle(), wait_s=0.5, system_id=7)
    assert "no heartbeat of system 7" in report.problem
    assert not report.safe


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
    """At rest: an armed vehicle shows its voltage under load, which the controller checks."""
    reserve = {"hover_throttle": 0.78, "hover_voltage_v": 3.7, "lowest_voltage_v": 3.2, "sag_v": 0.4}
    section = {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5}, **({"reserve": reserve} if table else {})}
    vehicle = Vehicle(fake=FakeVehicle(battery_v=volts, armed=armed))
    endpoint = Endpoint(vehicle.url, 1, 191)
    try:
        report = check(endpoint, from_table(FlightConfig, section), "auto", 1, wait_s=10.0)
    finally:
        endpoint.close()
        vehicle.close()
    told = verdict(report) or ""
    assert ("the battery has 3.62 V at rest, at least 3.65 V are needed" in told) == refused
    assert ("charge or change it" in told) == refused


def test_the_operator_may_break_it_off():
    report = talk(Vehicle(mute=("PARAM_VALUE",)), stopped=lambda: True)
    assert report.problem == "cancelled by the operator"
