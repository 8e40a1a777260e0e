"""Tests place, time and speed of the touchdown found in the vehicle's estimate, or that none is found."""

from dataclasses import replace

import numpy as np
import pytest

from flightstack.core.parameters.flight import Contact, FlightConfig, Touchdown
from flightstack.core.safety.barrier import Barrier
from flightstack.core.types import Phase
from logs.reader.flight import load_flight
from logs.verdict.estimate import find_touchdown
from logs.verdict.verdict import Outcome, judge
from tests.synthetic_flight import landing, write_log

FEET_M, PAD_M = 0.12, 0.5
LARGE = FlightConfig(
    Barrier(alpha_1_m=0.4, beta_m=3.75),
    touchdown=Touchdown(pad_radius_m=PAD_M, feet_below_reference_m=FEET_M, height_m=0.25),
    contact=Contact(gap_m=0.03),
    filter="paper",  # the touchdown heights of the robust filter suit a small vehicle
)
DT_S, CONTACT_S, DOWN_S, OFF_S = 0.01, 3.0, 2.0, 3.2  # tick; times of contact, touchdown phase, motors off, s
SLIP_M_S = (0.10, -0.05)


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """Return a synthetic landing without true states; tests replace its steps."""
    rows = landing()
    rows.truth = []
    return load_flight(write_log(tmp_path_factory.mktemp("flight") / "flight.mcap", rows))


def descent(
    flight, *, sink_m_s=0.45, d_m=0.15, noise=0.0, stops=True, feet_m=FEET_M, phase_after=Phase.LANDED
):
    """Return the steps of a straight descent with horizontal slip onto a pad that drives at 0.4 m/s."""
    rng = np.random.default_rng(3)
    t_s = np.arange(0.0, OFF_S + 2.5, DT_S)
    left_s = CONTACT_S - t_s
    flying = left_s > 0.0
    slip = np.array([*SLIP_M_S, -sink_m_s])
    e_m = np.array([d_m, 0.0, feet_m]) - np.where(flying, left_s, 0.0)[:, None] * slip
    v_m_s = np.where(flying[:, None], slip, 0.0)
    if not stops:
        e_m, v_m_s = np.array([d_m, 0.0, feet_m]) - left_s[:, None] * slip, np.tile(slip, (len(t_s), 1))
    pad_m_s = np.tile([0.4, 0.0, 0.0], (len(t_s), 1))
    pad_m = t_s[:, None] * pad_m_s + [0.0, 0.0, 0.5]
    phase = np.select(
        [t_s < DOWN_S, t_s < OFF_S], [int(Phase.APPROACH), int(Phase.TOUCHDOWN)], int(phase_after)
    )
    n, yes = len(t_s), np.ones(len(t_s), dtype=bool)
    blank = {
        name: np.zeros((n, *np.shape(values)[1:]), dtype=np.asarray(values).dtype)
        for name, values in vars(flight.steps).items()
        if name in flight.steps.__dataclass_fields__
    }
    return type(flight.steps)(
        **blank
        | {
            "t_s": t_s, "tick": np.arange(n), "phase": phase, "own_valid": yes, "target_valid": yes,
            "own_position_enu_m": pad_m + e_m + noise * rng.standard_normal((n, 3)),
            "own_velocity_enu_m_s": pad_m_s + v_m_s + 3.0 * noise * rng.standard_normal((n, 3)),
            "target_position_enu_m": pad_m, "target_velocity_enu_m_s": pad_m_s,
            "h_m": np.full(n, 0.3),
        }
    )  # fmt: skip


def judged(flight, steps, config=LARGE):
    return judge(
        replace(flight, steps=steps, config=config, pad_radius_m=config.touchdown.pad_radius_m, events=())
    )


@pytest.mark.parametrize("noise", [0.0, 0.003])
@pytest.mark.parametrize("sink_m_s", [0.1, 0.45, 0.8])
def test_where_and_how_fast_it_was_just_before_the_pad_stopped_it(flight, sink_m_s, noise):
    found = find_touchdown(descent(flight, sink_m_s=sink_m_s, noise=noise), LARGE, 0)
    assert found.t_s == pytest.approx(CONTACT_S, abs=DT_S if not noise else 0.03)
    assert found.e_m[:2] == pytest.approx([0.15, 0.0], abs=1e-3 + 3.0 * noise)
    assert found.e_m[2] == pytest.approx(FEET_M, abs=sink_m_s * DT_S + 3.0 * noise)
    assert found.velocity_m_s == pytest.approx([*SLIP_M_S, -sink_m_s], abs=1e-6 + 8.0 * noise)


def test_pad_and_feet_are_those_of_the_configuration(flight):
    verdict = judged(flight, descent(flight))
    assert verdict.outcome is Outcome.LANDED, verdict.reason
    assert verdict.touchdown_error_m == pytest.approx(0.15, abs=1e-3)
    assert verdict.touchdown_speed_vertical_m_s == pytest.approx(0.45, abs=1e-3)
    assert verdict.touchdown_speed_horizontal_m_s == pytest.approx(np.hypot(*SLIP_M_S), abs=1e-3)
    assert verdict.time_to_land_s == pytest.approx(CONTACT_S, abs=DT_S)
    small = replace(LARGE, touchdown=replace(LARGE.touchdown, pad_radius_m=0.1))
    assert "from the pad's centre" in judged(flight, descent(flight), small).reason
    low = replace(LARGE, touchdown=replace(LARGE.touchdown, feet_below_reference_m=0.0))
    assert judged(flight, descent(flight), low).outcome is Outcome.TIMEOUT


def test_a_log_of_a_real_flight_gives_the_pad_of_its_configuration(tmp_path):
    from flightstack.common.strict_toml import dumps
    from logs.recorder.recording import McapFile

    rows = landing()
    rows.run = {}
    path = tmp_path / "flight.mcap"
    real = McapFile.close

    def close(self):
        self.attachment("onboard.toml", "application/toml", 0, dumps(LARGE).encode())
        real(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(McapFile, "close", close)
        write_log(path, rows)
    assert load_flight(path).pad_radius_m == PAD_M


def test_a_descent_that_nothing_stops_is_no_touchdown(flight):
    steps = descent(flight, stops=False, phase_after=Phase.APPROACH)
    assert find_touchdown(steps, LARGE, 0) is None
    verdict = judged(flight, steps)
    assert (verdict.outcome, verdict.touchdown_error_m) == (Outcome.TIMEOUT, None)


def test_motors_off_without_a_contact_that_shows_gives_no_speeds(flight):
    steps = descent(flight, sink_m_s=0.03)  # the end of such a slow descent cannot be detected
    verdict = judged(flight, steps)
    assert verdict.outcome is Outcome.LANDED
    assert verdict.touchdown_error_m == pytest.approx(0.15, abs=1e-6)
    assert verdict.touchdown_speed_vertical_m_s is None
    assert verdict.touchdown_speed_horizontal_m_s is None


@pytest.mark.parametrize(("rate_hz", "lag_s"), [(100, 0.06), (50, 0.03), (25, 0.05)])
@pytest.mark.parametrize("sink_m_s", [0.25, 0.57])
def test_contact_speed_of_a_state_that_lags_and_comes_seldom(flight, rate_hz, lag_s, sink_m_s):
    """The contact speed is the sink rate before a lagging velocity decreases, which takes several steps."""
    steps = descent(flight, sink_m_s=sink_m_s)
    every, own = round(1.0 / (rate_hz * DT_S)), steps.own_velocity_enu_m_s.copy()
    for k in range(1, len(own)):
        own[k] = own[k - 1] + DT_S / lag_s * (own[k] - own[k - 1])
    for shift in range(every):
        held = own[(np.arange(len(own)) - shift) // every * every + shift]
        found = find_touchdown(replace(steps, own_velocity_enu_m_s=held), LARGE, 0)
        assert -found.velocity_m_s[2] == pytest.approx(sink_m_s, abs=0.05)


@pytest.mark.parametrize(("pad_carries", "outcome"), [(True, Outcome.TIMEOUT), (False, Outcome.LANDED)])
def test_on_a_floor_without_a_pad_the_vehicle_rests_in_the_world(flight, pad_carries, outcome):
    """If the target has no real pad, a vehicle at rest on a floor at the pad's height has landed."""
    steps = descent(flight)
    down = steps.t_s >= CONTACT_S
    at_m = steps.own_position_enu_m[np.flatnonzero(down)[0]]
    own_m = np.where(down[:, None], at_m, steps.own_position_enu_m)
    still = np.where(down[:, None], 0.0, steps.own_velocity_enu_m_s)
    stays = replace(
        steps, own_position_enu_m=own_m, own_velocity_enu_m_s=still,
        h_m=np.where(steps.t_s > CONTACT_S + 1.0, -0.3, 0.3),
    )  # fmt: skip
    verdict = judged(replace(flight, pad_carries=pad_carries), stays)
    assert (verdict.outcome, verdict.violation) == (outcome, pad_carries)
    assert verdict.touchdown_error_m == pytest.approx(0.15, abs=1e-3)
    slides = replace(stays, own_velocity_enu_m_s=np.where(down[:, None], [0.2, 0.0, 0.0], still))
    sinks = replace(
        stays, own_position_enu_m=own_m - np.where(steps.t_s > 4.0, 0.3, 0.0)[:, None] * [0, 0, 1]
    )
    for moved in (slides, sinks):
        assert judged(replace(flight, pad_carries=pad_carries), moved).outcome is Outcome.TIMEOUT
    low = replace(
        stays,
        h_m=np.where(steps.t_s > CONTACT_S - 1.0, -0.3, 0.3),
        own_position_enu_m=own_m + np.array([0.5, 0.0, 0.0]),
    )
    assert judged(replace(flight, pad_carries=pad_carries), low).violation is True


@pytest.mark.parametrize(
    ("heave_m", "floor_m", "outcome"),
    [(0.3, 0.0, Outcome.LANDED), (-0.3, 0.0, Outcome.LANDED), (0.0, -0.2, Outcome.TIMEOUT)],
)
def test_a_floor_without_a_pad_neither_heaves_with_the_target_nor_is_lower(flight, heave_m, floor_m, outcome):
    """A vehicle at rest on a floor has landed if only the target heaves, but not if the floor is too low."""
    steps = descent(flight)
    down = steps.t_s >= CONTACT_S
    at_m = steps.own_position_enu_m[np.flatnonzero(down)[0]]
    own_m = np.where(down[:, None], at_m, steps.own_position_enu_m) + np.array([0.0, 0.0, floor_m])
    still = np.where(down[:, None], 0.0, steps.own_velocity_enu_m_s)
    pad_m = steps.target_position_enu_m + np.where(steps.t_s > 4.0, heave_m, 0.0)[:, None] * [0, 0, 1]
    flown = replace(steps, own_position_enu_m=own_m, own_velocity_enu_m_s=still, target_position_enu_m=pad_m)
    assert judged(replace(flight, pad_carries=False), flown).outcome is outcome


@pytest.mark.parametrize("lost", ["own_valid", "target_valid"])
def test_a_state_that_is_missing_at_the_contact_and_after_is_never_a_landing(flight, lost):
    steps = descent(flight)
    gone = replace(steps, **{lost: steps.t_s < CONTACT_S - 0.2})
    verdict = judged(flight, gone)
    assert verdict.outcome is Outcome.TIMEOUT
    assert verdict.touchdown_error_m is None
    assert verdict.violation is None


@pytest.mark.parametrize(("lost_s", "outcome"), [(0.4, Outcome.LANDED), (0.6, Outcome.TIMEOUT)])
def test_a_state_that_is_missing_for_a_moment_while_it_rests_is_looked_for_beside_it(flight, lost_s, outcome):
    steps = descent(flight)
    off_s = float(steps.t_s[steps.phase == Phase.LANDED][0])
    gone = replace(steps, own_valid=np.abs(steps.t_s - off_s - 2.0) > lost_s)
    assert judged(flight, gone).outcome is outcome


def test_after_an_abort_that_has_flown_clear_h_no_longer_counts(flight):
    """A negative h is a violation until the vehicle has flown clear after an abort, and none afterwards."""
    steps = descent(flight, d_m=0.6, stops=False, phase_after=Phase.ABORT)
    clear_m = LARGE.checks.clearance_m
    away = steps.t_s >= OFF_S + 1.0
    own_m = steps.own_position_enu_m + np.where(away, 2.0 * clear_m, 0.0)[:, None] * [1.0, 0.0, 0.0]
    late, early = steps.t_s > OFF_S + 1.1, (steps.t_s > OFF_S + 0.5) & (steps.t_s < OFF_S + 0.6)
    for low, violation in ((late, False), (early, True)):
        flown = replace(steps, own_position_enu_m=own_m, h_m=np.where(low, -0.3, 0.3))
        verdict = judged(flight, flown)
        assert verdict.outcome is Outcome.ABORTED
        assert verdict.violation is violation
