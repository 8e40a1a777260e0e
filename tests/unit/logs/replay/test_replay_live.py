"""Playing a log: its time kept, paused and stepped; the right messages, and what lasts before a start."""

import itertools

import pytest
from click.testing import CliRunner

from flightstack.cli.main import main
from logs.reader.reader import LogFile
from logs.replay.live import SLICE_S, LiveOptions, Player, groups, play
from logs.replay.read import SOURCE, FlightInputs, ReplayError
from logs.schema.codec_mavlink import unpack_mavlink
from tests.golden.flights import path_of

GOLDEN = path_of("contact")
ITEMS = [(10.0 + 0.1 * n, n) for n in range(6)]


class Clock:
    """Wall time that passes only while the player waits for a key; keys come at their times."""

    def __init__(self, keys=(), end_s=100.0):
        self.now_s, self.keys, self.end_s, self.idles = 0.0, sorted(keys), end_s, 0

    def key(self, timeout_s):
        until = self.now_s + max(timeout_s, 1e-6)
        if self.keys and self.keys[0][0] <= until:
            self.now_s, pressed = self.keys.pop(0)
            return pressed
        self.now_s = until
        return ""

    def idle(self):
        self.idles += 1

    def played(self, rate=1.0, paused=False):
        sent = []
        player = Player(
            rate, paused=paused, key=self.key, idle=self.idle,
            stopped=lambda: self.now_s >= self.end_s, monotonic=lambda: self.now_s,
        )  # fmt: skip
        count = player.play(ITEMS, lambda n: sent.append((round(self.now_s, 3), n)))
        assert count == len(sent)
        return sent


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_items_come_at_their_distances(rate):
    assert Clock().played(rate) == [(pytest.approx(0.1 * n / rate, abs=1e-3), n) for n in range(6)]


def test_a_pause_moves_everything_after_it():
    sent = Clock(keys=[(0.25, " "), (1.25, "\n")]).played()
    assert [n for _, n in sent] == list(range(6))
    assert [t for t, _ in sent] == pytest.approx([0.0, 0.1, 0.2, 1.3, 1.4, 1.5], abs=2e-3)


def test_paused_at_the_start_single_steps_and_on():
    sent = Clock(keys=[(1.0, "s"), (2.0, "s"), (3.0, "x"), (4.0, " ")]).played(paused=True)
    assert [t for t, _ in sent] == pytest.approx([1.0, 2.0, 4.1, 4.2, 4.3, 4.4], abs=2e-3)


def test_a_pause_ends_with_the_replay_and_sockets_are_looked_after():
    clock = Clock(end_s=2.0)
    assert clock.played(paused=True) == []
    assert clock.idles >= 2.0 / SLICE_S - 1


def test_messages_are_grouped_by_tick_in_order_and_whole():
    flight = FlightInputs(GOLDEN)
    topics = {SOURCE, "/cf1/target/odom"}
    played = list(groups(flight, topics, 0.0))
    assert [m for _, group in played for m in group] == list(LogFile(GOLDEN).messages(topics))
    times = [at_s for at_s, _ in played]
    assert times == sorted(times)
    assert times[0] == 0.0
    assert all(len({m.log_time_ns for m in group}) == 1 for _, group in played)


def test_a_start_in_the_middle_begins_with_what_lasts():
    flight = FlightInputs(GOLDEN)
    whole = list(groups(flight, {SOURCE}, 0.0))
    (at_s, lasting), *rest = groups(flight, {SOURCE}, 3.0)
    assert rest == [g for g in whole if g[0] >= 3.0]
    assert at_s == rest[0][0]
    ids = [unpack_mavlink(m.data)[1][7] for m in lasting]
    assert {0, 245} <= set(ids) <= {0, 1, 242, 245}  # heartbeat, landed state; system status, home
    assert len(ids) == len(set(ids))
    before = itertools.chain.from_iterable(g for t, g in whole if t < 3.0)
    newest = {unpack_mavlink(m.data)[1][7]: m for m in before}
    assert lasting == [newest[n] for n in ids]


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (LiveOptions(), "--vehicle-url"),
        (LiveOptions(view=True, vehicle_url="udpin:127.0.0.1:0"), "--view"),
        (LiveOptions(vehicle_url="udpin:127.0.0.1:0", pause=True), "terminal"),
        (LiveOptions(vehicle_url="udpin:127.0.0.1:0", wait_s=0.2), "nobody has called"),
        (LiveOptions(listen=("tcp/127.0.0.1:0",), wait_s=0.2), "nobody subscribes"),
        (LiveOptions(vehicle_url="tcp:1.2.3.4:1"), "tcp:1.2.3.4:1"),
        (LiveOptions(vehicle_url="udpin:127.0.0.1:0", start_s=1e6, wait_s=0.0), "nothing to play"),
    ],
)
def test_a_replay_to_nobody_or_nowhere_says_so(options, word, monkeypatch):
    monkeypatch.setattr("sys.stdin", open("/dev/null"))  # noqa: SIM115, PTH123
    with pytest.raises(ValueError, match=word) as error:
        play(GOLDEN, options, say=lambda _: None)
    assert isinstance(error.value, ReplayError) or "tcp" in word


def test_live_and_check_exclude_each_other():
    done = CliRunner().invoke(main, ["replay", str(GOLDEN), "--live", "--check"])
    assert done.exit_code == 2
    assert "--live plays" in done.output
