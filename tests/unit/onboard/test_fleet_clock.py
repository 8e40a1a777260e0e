"""The clock of another process is known to within a bound that holds whatever the delays are."""

from hypothesis import given
from hypothesis import strategies as st

from flightstack.onboard.fleet_clock import DRIFT, Least, Offset, OtherClock

MS = 1_000_000  # ns
delays = st.integers(0, 300 * MS)
rounds = st.lists(st.tuples(delays, delays, st.integers(1, 2000 * MS)), min_size=1, max_size=30)


@given(st.integers(-(10**18), 10**18), st.floats(-0.9, 0.9), rounds)
def test_the_bound_holds_for_all_delays_and_drifts(off_ns, drift, rounds):
    """``off_ns`` is here - there at the beginning; each round sends one message in both directions."""
    here, there, now = OtherClock(), OtherClock(), 0

    def there_ns(t_ns):
        return t_ns - off_ns - round(drift * DRIFT * t_ns)

    for go, back, pause in rounds:
        stamp = there_ns(now)
        assert here.heard(stamp, now + go, there.ahead_ns(stamp))
        now += go
        assert there.heard(now, there_ns(now + back), here.ahead_ns(now))
        now += back + pause
        found = here.offset(now)
        if found is not None:
            slack_ns = 2 + DRIFT * 2 * 300 * MS  # rounding; an echo is as old as its way was long
            assert abs(found.ns - (now - there_ns(now))) <= found.bound_ns + slack_ns


def test_on_one_computer_the_offset_is_near_zero():
    here, there = OtherClock(), OtherClock()
    for n in range(100):  # at 100 Hz, each reads 3 or 7 ms after the other one has written
        now = 10 * MS * n
        there.heard(now, now + 3 * MS, here.ahead_ns(now))
        here.heard(now + 3 * MS, now + 10 * MS, there.ahead_ns(now + 3 * MS))
    found = here.offset(1000 * MS)
    assert abs(found.ns) <= 2.1 * MS
    assert 4.9 * MS <= found.bound_ns <= 5.1 * MS


def test_with_one_direction_nothing_is_known():
    clock = OtherClock()
    assert clock.ahead_ns(0) is None
    assert clock.heard(0, 5, None)
    assert clock.offset(5) is None
    assert clock.ahead_ns(5) == 5


def test_the_least_value_ages():
    least = Least()
    assert least.at(0) is None
    least.note(5 * MS, 0)
    least.note(9 * MS, 1000 * MS)
    assert least.at(1000 * MS) == 6 * MS
    assert least.at(5000 * MS) == 10 * MS
    least.note(7 * MS, 5000 * MS)
    assert least.at(5000 * MS) == 7 * MS


def test_a_clock_that_jumps_is_told_and_learned_anew():
    clock = OtherClock()
    assert clock.heard(0, 10 * MS, 10 * MS)
    assert clock.offset(10 * MS) == Offset(0, 10 * MS)
    assert not clock.heard(100 * MS, 60 * MS, 10 * MS)
    assert clock.offset(60 * MS) is None
    assert clock.heard(110 * MS, 70 * MS, 60 * MS)
    assert clock.offset(70 * MS) == Offset(-50 * MS, 10 * MS)
