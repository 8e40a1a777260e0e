"""What a flight needs of a serial line, against frames that are really sent."""

import pytest

from bridge.mavlink.endpoint import dialect
from bridge.mavlink.line_budget import LineTooSlowError, bytes_per_s, plan

AGE_S = 0.2  # checks.own_age_max_s by default


def longest(message):
    """Bytes of a frame none of whose bytes is a trailing zero."""
    return len(message.pack(dialect.MAVLink(None, 1, 1)))


def test_bytes_are_those_of_frames():
    position = dialect.MAVLink_local_position_ned_message(1, *[1.1] * 6)
    assert bytes_per_s({32: 100.0}) == 100.0 * longest(position)
    assert bytes_per_s({32: 100.0}, signed=True) == 100.0 * (longest(position) + 13)
    setpoint = dialect.MAVLink_set_position_target_local_ned_message(1, 1, 1, 1, 2503, *[1.1] * 11)
    assert bytes_per_s({84: 10.0}) == 10.0 * longest(setpoint)


@pytest.mark.parametrize(
    ("baud", "signed", "state_hz", "every"),
    [
        (None, False, 100.0, 1),
        (921_600, False, 100.0, 1),
        (921_600, True, 100.0, 1),
        (115_200, False, 100.0, 1),
        (57_600, False, 50.0, 2),
        (57_600, True, 100.0 / 3.0, 2),
        (38_400, False, 100.0 / 3.0, 3),
    ],
)
def test_highest_rates_that_fit(baud, signed, state_hz, every):
    chosen = plan(baud, 100.0, AGE_S, signed=signed)
    assert (chosen.state_hz, chosen.setpoint_every) == (pytest.approx(state_hz), every)
    assert chosen.setpoint_hz == pytest.approx(100.0 / every)
    if baud is not None:
        assert chosen.capacity_bytes_s == baud / 10
        assert max(chosen.in_bytes_s, chosen.out_bytes_s) <= 0.9 * baud / 10
        assert f"{chosen.in_bytes_s:.0f} B/s in" in chosen.text


@pytest.mark.parametrize(
    ("age_s", "baud", "enough"), [(0.2, 9_600, 38_400), (0.2, 19_200, 38_400), (0.05, 57_600, 115_200)]
)
def test_too_slow_a_line_is_refused_with_the_numbers(age_s, baud, enough):
    with pytest.raises(LineTooSlowError) as refused:
        plan(baud, 100.0, age_s)
    text = str(refused.value)
    assert f"serial line of {baud} baud is too slow" in text
    assert f"checks.own_age_max_s = {age_s:g} s" in text
    assert f"carries {baud / 10:.0f} B/s" in text
    assert f"set the line to {enough} baud or more" in text
    plan(enough, 100.0, age_s)  # and that is true


def test_loop_slower_than_the_lowest_rate_is_not_made_slower():
    chosen = plan(57_600, 10.0, AGE_S)
    assert (chosen.state_hz, chosen.setpoint_every) == (10.0, 1)
    with pytest.raises(LineTooSlowError, match="at 10 Hz"):
        plan(1_200, 10.0, AGE_S)


def test_no_rate_keeps_a_hopeless_line():
    with pytest.raises(LineTooSlowError, match="use another link"):
        plan(921_600, 1e6, 1e-6)
