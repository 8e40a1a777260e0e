"""Each size of vehicle or pad in the configuration changes the flight, and the certificate uses it."""

from dataclasses import replace

import pytest

from flightstack.core.controller import Controller
from flightstack.core.memory import AbortWay, Memory
from flightstack.core.mission.conditions import high_enough_m
from flightstack.core.mission.guidance import Situation, nominal_command
from flightstack.core.mission.machine import Mission
from flightstack.core.mission.phases import Condition
from flightstack.core.snapshot import Snapshot
from flightstack.core.strategies.strategy import strategy_of
from flightstack.core.strategies.velocity_tracking import VelocityTracking
from flightstack.core.target.plausibility import Plausibility
from flightstack.core.target.track import TargetState, TargetTrack
from flightstack.core.types import (
    ZERO,
    Inputs,
    Landed,
    Mode,
    OwnState,
    Phase,
    Request,
    TargetSample,
    VehicleStatus,
)
from flightstack.verify.certificate import checks
from tests.unit.core.core_helpers import config

PAD = (0.0, 0.0, 0.0)


def seen(e, velocity=ZERO, *, own_ok=True, now_s=0.0, speed=ZERO):
    own = OwnState(now_s, now_s, e, velocity, 0.0)
    status = VehicleStatus(now_s, True, Mode.EXTERNAL, Landed.IN_AIR, True)
    return Snapshot(Inputs(own, status), TargetState(0.0, PAD, speed, 0.0), own_ok, True, True, e)


def mission_of(settings, memory):
    barrier, strategy = settings.barrier.build(), strategy_of(settings)
    mission = Mission(settings, barrier, strategy, TargetTrack(settings.checks), Plausibility(settings))
    mission.memory = memory
    return mission, Situation(settings, barrier, memory, None, strategy)


def velocity(settings, phase, e, **memory):
    """Return the command of a phase."""
    mission, situation = mission_of(settings, Memory(phase=phase, **memory))
    mission.progress(seen(e))
    return nominal_command(situation._replace(snapshot=seen(e)))


def flags(settings, phase, e, velocity=ZERO, *, after_s=0.0, own_ok=True, memory=None):
    """Return conditions and memory after some time without a change."""
    memory = memory if memory is not None else Memory(own_ok_s=0.0)
    memory.phase = phase
    mission, _ = mission_of(settings, memory)
    found = mission.flags(seen(e, velocity), command_failed=False, now_s=0.0)
    if after_s:
        later = seen(e, velocity, own_ok=own_ok, now_s=after_s)
        found = mission.flags(later, command_failed=False, now_s=after_s)
    return found, memory


def contact(settings, height_m, velocity=ZERO, after_s=0.2, command=ZERO, x_m=0.0):
    memory = Memory(own_ok_s=0.0, command=command)
    flags(settings, Phase.TOUCHDOWN, (x_m, 0.0, height_m), velocity, after_s=after_s, memory=memory)
    return memory.contact


def sliding(settings):
    return replace(settings, contact=replace(settings.contact, sliding_gap_m=0.02))


def learned(settings):
    """Return the estimated disturbance after a strong push."""
    tracking = VelocityTracking(settings.velocity_loop, 0.01)
    for n in range(1000):
        tracking.observe((4.0, 0.0, 0.0), commanding=n > 0)
    return tracking.memory.disturbance_m_s[0]


def lags(settings):
    """Return whether a vehicle that does not move is detected within 5 s."""
    watch = Plausibility(settings)
    for _ in range(500):
        watch.follow((settings.limits.velocity_max_m_s[0], 0.0, 0.0), ZERO)
    return not watch.follows


def drifted_away(settings):
    """Return whether a position that moves at 0.1 m/s, against its velocity, is detected."""
    watch = Plausibility(settings)
    for n in range(500):
        watch.take(OwnState(0.01 * n, 0.01 * n, (0.001 * n, 0.0, 0.0), ZERO, 0.0))
    return watch.memory.distrusted


def parted(settings):
    """Return whether a target that moves at 0.1 m/s, against its velocity, is detected."""
    track = TargetTrack(settings.checks)
    for n in range(500):
        at = TargetSample(0.01 * n, 0.01 * n, "map", "target", (0.001 * n, 0.0, 0.0), ZERO, 0.0, 0.0)
        track.accept(at)
    return track.memory.distrusted


def ended(settings, after_s=70.0):
    """Return whether the stack ends although the vehicle continues to fly after an abort."""
    controller = Controller(settings)
    controller.memory.phase, controller.memory.abort_way = Phase.ABORT, AbortWay.LAND_HERE
    status = VehicleStatus(after_s, True, Mode.LAND, Landed.IN_AIR, True)
    return controller.step(Inputs(None, status), after_s).finished


def cleared(settings):
    memory = {"abort_way": AbortWay.FLY_CLEAR, "target_position_enu_m": PAD, "phase_since_s": -40.0}
    return velocity(settings, Phase.ABORT, (0.3, 0.0, 2.0), **memory).request is Request.LAND


def papers(settings):
    return replace(settings, filter=config("paper").filter)


WIDE = {
    "limits": {"velocity_max_m_s": [1.0, 1.0, 2.0]},
    "takeoff": {"start_offset_m": [1.0, 0.0, 0.7]},
}
# section, key, another value, tested behaviour, result with the default and with the other value
CHANGES = [
    ("takeoff", "level_first_m", 0.5,
     lambda c: velocity(c, Phase.TAKEOFF, (0.0, 0.0, 0.4), climbed=True, was_armed=True).velocity[0] != 0.0,
     (False, True)),
    ("touchdown", "descent_m_s", 0.5,
     lambda c: velocity(papers(c), Phase.TOUCHDOWN, (0.0, 0.0, 0.03)).velocity[2], (-0.2, -0.5)),
    ("touchdown", "blind_time_s", 1.0,
     lambda c: bool(flags(c, Phase.TOUCHDOWN, (0.0, 0.0, 0.03), after_s=0.7, own_ok=False)[0]
                    & Condition.OWN_LOST), (True, False)),
    ("touchdown", "timeout_s", 5.0,
     lambda c: bool(flags(c, Phase.TOUCHDOWN, (0.0, 0.0, 0.2), after_s=3.0)[0] & Condition.PHASE_TIME_OVER),
     (True, False)),
    ("contact", "gap_m", 0.05, lambda c: contact(c, 0.0144 + 0.03), (False, True)),
    ("contact", "beyond_m", 0.02, lambda c: contact(c, 0.0144, x_m=0.11), (False, True)),
    ("contact", "sliding_gap_m", 0.02,
     lambda c: contact(c, 0.0144 + 0.01, (0.0, 0.0, -0.3), x_m=0.06), (False, True)),
    ("contact", "sliding_radius_m", 0.07,
     lambda c: contact(sliding(c), 0.0144 + 0.01, (0.0, 0.0, -0.3), x_m=0.06), (True, False)),
    ("contact", "speed_m_s", 0.1, lambda c: contact(c, 0.0144, (0.0, 0.0, -0.08)), (False, True)),
    ("contact", "time_s", 0.5, lambda c: contact(c, 0.0144), (True, False)),
    ("contact", "stopped_time_s", 0.5,
     lambda c: contact(c, 0.0144 + 0.03, command=(0.0, 0.0, -c.robust.descent_m_s)), (True, False)),
    ("retreat", "drift_time_s", 0.1,
     lambda c: bool(flags(c, Phase.TOUCHDOWN, (0.07, 0.0, 0.22), (0.08, 0.0, 0.0))[0] & Condition.DRIFTED),
     (True, False)),
    ("retreat", "h_left_m", 0.2,
     lambda c: bool(flags(c, Phase.TOUCHDOWN, (0.07, 0.0, 0.22), (0.08, 0.0, 0.0))[0] & Condition.DRIFTED),
     (True, False)),
    ("retreat", "hold_climb_m_s", 0.7,
     lambda c: velocity(c, Phase.HOLD, (0.0, 0.0, 1.0), started_s=0.0).velocity[2], (0.4, 0.7)),
    ("retreat", "climb_margin_m", 0.6,
     lambda c: round(high_enough_m(c, c.barrier.build(), Memory()) - c.barrier.build().peak_height_m, 9),
     (0.2, 0.6)),
    ("retreat", "clear_time_max_s", 90.0, cleared, (True, False)),
    ("retreat", "abort_time_max_s", 200.0, ended, (True, False)),
    ("checks", "follow_memory_s", 0.4, lags, (True, False)),
    ("checks", "own_drift_memory_s", 1.0, drifted_away, (True, False)),
    ("checks", "target_drift_memory_s", 0.5, parted, (True, False)),
    ("checks", "target_drift_max_m", 0.3, parted, (True, False)),
    ("robust", "descent_min_m_s", 0.3,
     lambda c: velocity(c, Phase.LAND, (0.0, 0.0, 0.11)).velocity[2], (-0.1, -0.3)),
    ("velocity_loop", "disturbance_max_m_s", 1.5, learned, (0.6, 1.5)),
]  # fmt: skip


@pytest.mark.parametrize(
    ("section", "key", "other", "does", "expected"), CHANGES, ids=[f"{c[0]}.{c[1]}" for c in CHANGES]
)
def test_a_changed_size_changes_what_it_does(section, key, other, does, expected):
    changed = {**WIDE, section: {**WIDE.get(section, {}), key: other}}
    found = does(config(**WIDE)), does(config(**changed))
    assert found == pytest.approx(expected)


def test_the_climb_goes_half_the_margin_beyond_and_flies_clear_a_quarter_below():
    for margin_m in (0.2, 0.6):
        settings = config(**WIDE, retreat={"climb_margin_m": margin_m})
        top = high_enough_m(settings, settings.barrier.build(), Memory())
        rising = velocity(settings, Phase.CLIMB, (0.0, 0.0, top)).velocity[2]
        assert rising == pytest.approx(0.5 * margin_m)
        known = {"abort_way": AbortWay.FLY_CLEAR, "target_position_enu_m": PAD}
        for lacking, climbs in ((0.26, True), (0.24, False)):
            away = velocity(settings, Phase.ABORT, (0.3, 0.0, top - lacking * margin_m), **known).velocity
            assert (away[2] > 0.0) is climbs


def one(name, settings):
    (found,) = (check for check in checks(settings) if check.name == name)
    return found


@pytest.mark.parametrize(
    ("name", "filter", "section", "key", "passes", "fails"),
    [
        ("contact.speed_m_s", "paper", "contact", "speed_m_s", 0.2, 0.201),
        ("contact.speed_m_s", "robust", "contact", "speed_m_s", 0.22, 0.221),
        ("touchdown.height_m", "paper", "touchdown", "height_m", 0.0145, 0.0143),
        ("checks.follow_lag_max_s", "paper", "checks", "follow_memory_s", 0.45, 0.449),
        ("checks.follow_lag_max_s", "robust", "checks", "follow_memory_s", 0.45, 0.449),
        ("descent time", "robust", "touchdown", "timeout_s", 1.5, 1.3),
        ("altitude", "robust", "retreat", "climb_margin_m", 1.6, 1.7),
    ],
)
def test_the_certificate_knows_each_size_from_both_sides(name, filter, section, key, passes, fails):
    assert one(name, config(filter, **{section: {key: passes}})).proven
    found = one(name, config(filter, **{section: {key: fails}}))
    assert not found.proven
    assert section in found.remedy or name == "altitude"


def test_the_certificate_knows_the_gain_after_the_commit():
    slow, hard = ({"robust": {"gain_descent_1_s": gain}} for gain in (0.7, 3.0))
    same = one("drift", config(robust={"gain_over_pad_1_s": 0.7}))
    assert one("drift", config(**slow)).room == same.room != one("drift", config()).room
    assert one("position loop", config(**slow)).room == one("position loop", config()).room
    found = one("position loop", config(**hard))
    assert not found.proven
    assert found.remedy == "lower robust.gain_descent_1_s"


def test_a_longer_time_for_the_descent_is_more_time_to_drift():
    slow = {"robust": {"descent_m_s": 0.08}}
    short, long = (one("drift", config(**slow, touchdown={"timeout_s": t})) for t in (0.5, 5.0))
    assert short.room > long.room
