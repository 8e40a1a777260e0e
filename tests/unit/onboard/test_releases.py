"""The pre-flight check with fake vehicles of every release in its tables."""

import math

import pytest

from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.preflight import examine as module
from bridge.mavlink.preflight.examine import examine
from bridge.mavlink.preflight.table import Level, Needs, Table, judge, table
from flightstack.common.strict_toml import ConfigError, from_table
from flightstack.onboard.preflight import lines, record, verdict
from tests.fake_autopilot import OnUdp
from tests.unit.onboard.safe_parameters import DEV, SAFE, packed

NEEDS = Needs(0.5 * math.sqrt(2.0), 0.5, 1.0, 1.5, 3.0)
# by autopilot and name: level, and unsafe values; a name exists in the releases that have it
BAD = {
    "ardupilot": {
        "GUID_TIMEOUT": (Level.UNSAFE, (0.0, 0.09, 1.01, 3.0)),
        "GUID_OPTIONS": (Level.UNSAFE, (16, 32, 49)),
        "WPNAV_SPEED": (Level.UNSAFE, (0.7072, 70.0)), "WP_SPD": (Level.UNSAFE, (0.0, 0.7)),
        "WPNAV_SPEED_UP": (Level.UNSAFE, (0.5, 49.0)), "WP_SPD_UP": (Level.UNSAFE, (0.49,)),
        "WPNAV_SPEED_DN": (Level.UNSAFE, (0.5, 49.0)), "WP_SPD_DN": (Level.UNSAFE, (0.49,)),
        "WPNAV_ACCEL": (Level.NOTE, (99.0,)), "WP_ACC": (Level.NOTE, (0.99,)),
        "WPNAV_ACCEL_Z": (Level.NOTE, (149.0,)), "WP_ACC_Z": (Level.NOTE, (1.0, 1.49)),
        "ATC_INPUT_TC": (Level.INFO, (0.15, 0.06)),
        "DISARM_DELAY": (Level.UNSAFE, (1, 4)),
        "ARMING_CHECK": (Level.UNSAFE, (0,)), "ARMING_SKIPCHK": (Level.UNSAFE, (-1, 1, 64, 2**20)),
        "FS_EKF_ACTION": (Level.UNSAFE, (0,)), "FS_GCS_ENABLE": (Level.UNSAFE, (0, 2, 7)),
        "SYSID_MYGCS": (Level.UNSAFE, (0, 2, 255)), "MAV_GCS_SYSID": (Level.UNSAFE, (0, 2, 255)),
        "MAV_GCS_SYSID_HI": (Level.UNSAFE, (2, 255)),
        "FS_THR_ENABLE": (Level.NOTE, (1,)), "BATT_FS_CRT_ACT": (Level.NOTE, (0,)),
        "BATT_FS_LOW_ACT": (Level.UNSAFE, (5,)),
        "FENCE_ENABLE": (Level.NOTE, (1,)), "SYSID_ENFORCE": (Level.NOTE, (0,)),
        "MAV_OPTIONS": (Level.NOTE, (0, 2)), "MAV1_OPTIONS": (Level.NOTE, (1, 4)),
        "SERIAL1_OPTIONS": (Level.NOTE, (4096, 5120)),
    },
    "px4": {
        "COM_OF_LOSS_T": (Level.UNSAFE, (0.0, 0.05, 1.01, 60.0)),
        "MPC_XY_VEL_MAX": (Level.UNSAFE, (0.7, 0.0)), "MPC_Z_VEL_MAX_UP": (Level.UNSAFE, (0.49,)),
        "MPC_Z_VEL_MAX_DN": (Level.UNSAFE, (0.49,)), "COM_DISARM_PRFLT": (Level.UNSAFE, (0.0, 4.9)),
        "GF_MAX_VER_DIST": (Level.UNSAFE, (0.1, 2.9)), "GF_MAX_HOR_DIST": (Level.NOTE, (5.0,)),
        "GF_ACTION": (Level.UNSAFE, (4,)), "NAV_DLL_ACT": (Level.UNSAFE, (5, 6)),
        "COM_LOW_BAT_ACT": (Level.NOTE, (0,)), "SYS_FAILURE_EN": (Level.UNSAFE, (1,)),
        "COM_OBL_RC_ACT": (Level.UNSAFE, (0, 1, 2, 3, 6, 7)), "COM_RC_IN_MODE": (Level.NOTE, (0, 3)),
        "COM_RCL_EXCEPT": (Level.NOTE, (0, 3, 8)), "COM_RC_OVERRIDE": (Level.NOTE, (0, 1)),
        "MAN_OVERRIDE_SPD": (Level.NOTE, (-1.0, 0.0, 100.0)), "FD_ALT_LOSS": (Level.UNSAFE, (0.5, 2.9)),
        "NAV_RCL_ACT": (Level.UNSAFE, (5, 6)), "COM_ACT_FAIL_ACT": (Level.UNSAFE, (4,)),
        "COM_WIND_MAX_ACT": (Level.UNSAFE, (4,)), "COM_POS_LOW_ACT": (Level.UNSAFE, (4,)),
        "COM_ARM_ODID": (Level.UNSAFE, (5,)), "COM_GNSSLOSS_ACT": (Level.UNSAFE, (3,)),
        "EKF2_SENS_EN": (Level.NOTE, (0, 8191 - 8, 8191 - 1)), "MAV_FWDEXTSP": (Level.UNSAFE, (0,)),
    },
}  # fmt: skip
ALSO_SAFE = {
    "ardupilot": {"GUID_TIMEOUT": (0.1, 1.0), "GUID_OPTIONS": (1, 64), "DISARM_DELAY": (0, 5),
                  "ARMING_CHECK": (64,), "WPNAV_SPEED": (71.0,), "WP_SPD": (0.7072,),
                  "MAV_GCS_SYSID_HI": (1,), "FS_GCS_ENABLE": (1,)},
    "px4": {"COM_DISARM_PRFLT": (-1.0, 5.0), "GF_MAX_VER_DIST": (3.0,), "FD_ALT_LOSS": (3.0, 10.0),
            "COM_OBL_RC_ACT": (5,), "COM_OF_LOSS_T": (0.1,), "COM_RC_OVERRIDE": (2,)},
}  # fmt: skip
NEWER = {"COM_LOW_BAT_ACT": 5}  # a value that another release lacks
RELEASES = pytest.mark.parametrize(("autopilot", "release"), SAFE, ids=" ".join)


def judged(autopilot, release, values):
    asked = table(autopilot).asked(autopilot, release)
    return {f.name: f for f in judge(asked, values, {}, NEEDS, ())}


def talk(vehicle, **options):
    endpoint = Endpoint(vehicle.url, 1, 191)
    try:
        return examine(endpoint, 1, None, NEEDS, (), wait_s=10.0, **options)
    finally:
        endpoint.close()
        vehicle.close()


def test_the_fakes_are_of_every_release_of_the_tables():
    assert set(SAFE) == {(name, r) for name in ("ardupilot", "px4") for r in table(name).releases}


@RELEASES
def test_a_safe_vehicle_of_any_release_may_arm(autopilot, release):
    report = talk(OnUdp(autopilot, packed(release), SAFE[autopilot, release]))
    assert (verdict(report), report.notes, report.rules) == (None, (), release)
    assert {f.level for f in report.findings} == {Level.OK}
    assert {f.name for f in report.findings} == set(SAFE[autopilot, release])


@RELEASES
def test_every_value_that_is_not_safe_is_found_in_every_release(autopilot, release):
    safe = SAFE[autopilot, release]
    names = {each.name.name for each in table(autopilot).asked(autopilot, release)}
    unasked = {"SERIAL0_OPTIONS", "SERIAL2_OPTIONS", "MAV2_OPTIONS", "MAV3_OPTIONS"}  # optional neighbours
    assert names - unasked == {name for name in BAD[autopilot] if name in safe}
    for name, (level, values) in BAD[autopilot].items():
        for value in values if name in safe else ():
            found = judged(autopilot, release, safe | {name: value})
            assert {n: f.level for n, f in found.items() if f.level is not Level.OK} == {name: level}, value
    for name, values in ALSO_SAFE[autopilot].items():
        for value in values if name in safe else ():
            assert judged(autopilot, release, safe | {name: value})[name].level is Level.OK, (name, value)
    if autopilot == "px4" and release != "1.18":
        assert judged(autopilot, release, safe | NEWER)["COM_LOW_BAT_ACT"].level is Level.NOTE


def test_a_battery_that_stops_the_motors_is_worse_than_one_that_only_warns():
    for value, level in ((0, Level.NOTE), (5, Level.UNSAFE)):
        found = judged("ardupilot", "4.7", SAFE["ardupilot", "4.7"] | {"BATT_FS_CRT_ACT": value})
        assert found["BATT_FS_CRT_ACT"].level is level
    assert (
        "BATT_FS_CRT_ACT is 5: in the air the motors stop; set it to 1 (land) or"
        in found["BATT_FS_CRT_ACT"].text
    )


@RELEASES
def test_what_is_missing_is_as_bad_as_what_is_not_safe(autopilot, release):
    found = judged(autopilot, release, {})
    softer = {"MAV_GCS_SYSID_HI": Level.NOTE, "FD_ALT_LOSS": Level.NOTE}  # missing in some builds
    ignored = {name for name in SAFE[autopilot, release] if name.endswith("_OPTIONS")}
    ignored |= {"ATC_INPUT_TC", "BATT_FS_LOW_ACT", "NAV_RCL_ACT", "COM_ACT_FAIL_ACT", "COM_WIND_MAX_ACT",
                "COM_POS_LOW_ACT", "COM_ARM_ODID", "COM_GNSSLOSS_ACT"}  # fmt: skip
    assert set(found) == set(SAFE[autopilot, release]) - (ignored - {"GUID_OPTIONS", "MAV_OPTIONS"})
    assert all(f.level is softer.get(name, BAD[autopilot][name][0]) for name, f in found.items())


@pytest.mark.parametrize(("autopilot", "release"), [("ardupilot", "4.7"), ("px4", "1.18")])
def test_the_names_of_the_release_before_are_refused(autopilot, release):
    older = {"4.7": "4.6", "1.18": "1.16"}[release]
    report = talk(OnUdp(autopilot, packed(release), SAFE[autopilot, older], says_unknown=True))
    missing = {f.name for f in report.findings if f.value is None}
    assert missing >= {"4.7": {"WP_SPD", "ARMING_SKIPCHK"}, "1.18": {"MAN_OVERRIDE_SPD"}}[release]
    assert any("refused: DOES_NOT_EXIST" in f.why for f in report.findings)
    assert report.safe is (autopilot == "px4")  # new names of PX4 are only notes


def test_a_name_of_any_release_may_be_accepted():
    asked = table("ardupilot").asked("ardupilot", "4.7")
    values = SAFE["ardupilot", "4.7"] | {"WP_SPD": 0.1}
    for name, level in (
        ("WPNAV_SPEED", Level.ACCEPTED),
        ("WP_SPD", Level.ACCEPTED),
        ("WP_ACC", Level.UNSAFE),
    ):
        found = {f.name: f.level for f in judge(asked, values, {}, NEEDS, (name,))}
        assert found["WP_SPD"] is level


UNKNOWN = [
    ("ardupilot", packed("4.9"), "4.8", "the parameters of ArduCopter 4.9.0 are not known"),
    ("ardupilot", packed("4.4"), "4.5", "the parameters of ArduCopter 4.4.0 are not known"),
    ("px4", packed("2.0"), "1.18", "the parameters of PX4 2.0.0 are not known"),
    ("px4", packed("1.19", 64), "1.18", "the parameters of PX4 1.19.0 alpha are not known"),
    ("px4", packed("0.0", DEV), "1.18", "PX4 0.0.0 dev is a version without a number"),
    (
        "px4",
        None,
        "1.18",
        "the release of this PX4 is not known: no AUTOPILOT_VERSION in reply to 2 requests",
    ),
]


@pytest.mark.parametrize(("autopilot", "version", "nearest", "why"), UNKNOWN)
def test_a_release_that_is_not_known_is_refused_by_name_or_flown_by_the_nearest_rules(
    autopilot, version, nearest, why, monkeypatch
):
    monkeypatch.setattr(module, "_VERSION_TRIES", 2)
    safe = SAFE[autopilot, nearest]
    refused = talk(OnUdp(autopilot, version, safe))
    assert not refused.safe
    assert verdict(refused).startswith(why)
    assert f"--accept-release flies it by the rules of {nearest}" in verdict(refused)
    flown = talk(OnUdp(autopilot, version, safe), accept_release=True)
    assert (verdict(flown), flown.rules) == (None, nearest)
    assert any(f"judged by the rules of {nearest} (--accept-release)" in line for line in lines(flown))
    assert why in record(flown)["notes"]
    bad = talk(OnUdp(autopilot, version, safe | {next(iter(safe)): 60.0}), accept_release=True)
    assert not bad.safe


def test_a_build_of_a_known_release_that_is_none_is_noted():
    report = talk(OnUdp("ardupilot", packed("4.8", DEV), SAFE["ardupilot", "4.8"]))
    assert report.safe
    assert report.notes == ("ArduCopter 4.8.0 dev is not a release: judged by the rules of 4.8",)


RULE = {"means": "m", "names": [{"name": "A"}], "text": "t", "low": 1.0}


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"not_zero": True}, "exactly one condition"),
        ({"low": None}, "exactly one condition"),
        ({"names": []}, "names of 1 to 16"),
        ({"names": [{"name": "ABCDEFGHIJKLMNOPQ"}]}, "names of 1 to 16"),
        ({"names": [{"name": "A", "since": "9.9"}]}, "A: since and before are of 1.0, 1.1"),
        ({"names": [{"name": "A"}, {"name": "A", "since": "1.1"}]}, "A: two rules for release 1.1"),
        ({"severity": "bad"}, "severity: found 'bad', allowed: ok, info, note, UNSAFE, accepted, ignored"),
        ({"low": "speed"}, "low: found 'speed', allowed: .*horizontal_m_s"),
        ({"values": ["land"], "low": None}, "whole numbers with their meaning"),
        ({"scales": 2.0}, "scales: unknown key"),
    ],
)
def test_a_broken_table_says_where(wrong, words):
    rule = {key: value for key, value in (RULE | wrong).items() if value is not None}
    with pytest.raises(ConfigError, match=words):
        from_table(Table, {"title": "X", "releases": ["1.0", "1.1"], "rule": [rule]})
