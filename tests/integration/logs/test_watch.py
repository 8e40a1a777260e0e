"""Tests the Zenoh keys of a flight and the subcommand ``watch``; old data are never shown as new."""

import io
import itertools
import json
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import pytest
from rich.console import Console

from bridge.zenoh import zenoh_link
from flightstack.common.processes import Port
from flightstack.core.types import Phase
from flightstack.watch import STALE_S, Watch, draw, snapshot
from logs.schema.rows import HealthRow
from tests.integration.runs import called
from tests.integration.sim_processes import ROOT
from tests.processes.bounded import PATIENCE_S, killed, line_of, wait_for
from tests.synthetic_flight import landing

KEYS = ("controller/step", "loop/timing", "health")
HEALTHY = HealthRow(
    1_700_000_000_123_456_789, 42, 0.01, 0.02, 0.5, 3.87, 0.9, 1, 2, True, True, True, True, True, False,
    100, 1, 2, 3, "inputs good again, ±",
)  # fmt: skip


class Clock:
    """A clock in seconds that a test sets."""

    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


class Sender:
    """Publishes like the onboard process, in its own session."""

    def __init__(self, endpoint, namespace="cf1"):
        self.session = zenoh_link.open_session([endpoint], [])
        self.puts = {key: zenoh_link.dropping_publisher(self.session, f"{namespace}/{key}") for key in KEYS}

    def wait(self):
        wait_for(lambda: all(map(zenoh_link.is_matched, self.puts.values())), "a subscription")


@contextmanager
def opened(namespace="cf1"):
    """Yield a sender, a watch and its clock."""
    port, clock = Port(), Clock()
    sender = Sender(port.endpoint, namespace)
    session = zenoh_link.open_session([], [port.endpoint])
    try:
        watch = Watch(session, namespace, clock=clock)
        sender.wait()
        yield sender, watch, clock
    finally:
        session.close()
        sender.session.close()
        port.close()


def until(watch, done, what):
    wait_for(lambda: done() or watch.poll(), what)


def shown(watch, *endpoints):
    console = Console(width=130, record=True, file=io.StringIO())
    console.print(draw({"cf1": watch}, "title", endpoints or ["tcp/lab:7448"]))
    return console.export_text()


def step(number=0, **values):
    rows = [r for r in landing().steps if r.phase == Phase.APPROACH]
    return rows[number]._replace(**values)


def test_old_data_is_shown_as_old_and_never_as_new():
    with opened() as (sender, watch, clock):
        assert not watch.fresh
        clock.now_s += 3.2
        assert "no data for 3.2 s" in shown(watch)
        row = step()
        sender.puts["controller/step"].put(row.pack())
        sender.puts["health"].put(HEALTHY.pack())
        sender.puts["loop/timing"].put(landing().timing[5].pack())
        until(watch, lambda: watch.step and watch.health and watch.timings, "nothing came")
        assert watch.fresh
        text = shown(watch)
        for words in ("APPROACH", f"{row.h_m:+.3f} m", " 20 ms", "3.87 V 90 %", "good again"):
            assert words in text
        assert "no data" not in text
        clock.now_s += STALE_S + 2.0
        assert not watch.fresh
        text = shown(watch)
        assert "no data for 3.0 s: connected, but no data arrives on these keys; data below is OLD" in text
        values = snapshot(watch)
        assert (values["fresh"], values["health"]["fresh"]) == (False, False)
        assert values["age_s"] == 3.0


def test_who_dials_a_router_as_its_peer_is_told_why_nothing_comes():
    port = Port()
    router = zenoh_link.open_session([port.endpoint], role=zenoh_link.Role.ROUTER)
    for role, words in (
        (zenoh_link.Role.PEER, "is a router, which passes nothing from peer to peer"),
        (zenoh_link.Role.CLIENT, "connected, but no data arrives on these keys"),
    ):
        session = zenoh_link.open_session(connect=[port.endpoint], role=role)
        watch = Watch(session, "cf1", role=role)
        until(watch, lambda: watch.connections == 1, "no connection")  # noqa: B023 (called immediately)
        assert words in shown(watch, port.endpoint)
        session.close()
    router.close()
    port.close()


def test_of_several_endpoints_the_number_of_connected_ones_is_shown():
    ports = Port(), Port()
    endpoints = [port.endpoint for port in ports]
    session, ends = zenoh_link.open_session([], endpoints), []
    watch = Watch(session, "cf1")
    for number in (0, 1):
        until(watch, lambda: watch.connections == number, "no connection")  # noqa: B023 (called immediately)
        words = f"{number} of 2 endpoints connected; the rest: not running, or access denied"
        assert words in shown(watch, *endpoints)
        ends.append(zenoh_link.open_session([endpoints[number]]))
    until(watch, lambda: watch.connections == 2, "no second connection")
    assert ": connected, but no data arrives on these keys" in shown(watch, *endpoints)
    for each in (session, *ends, *ports):
        each.close()


def test_a_client_needs_one_of_several_routers():
    ports = Port(), Port()
    endpoints = [port.endpoint for port in ports]
    router = zenoh_link.open_session(endpoints[:1], role=zenoh_link.Role.ROUTER)
    session = zenoh_link.open_session([], endpoints, role=zenoh_link.Role.CLIENT)
    watch = Watch(session, "cf1", role=zenoh_link.Role.CLIENT)
    until(watch, lambda: watch.connections == 1, "no connection")
    assert ": connected, but no data arrives on these keys" in shown(watch, *endpoints)
    for each in (session, router, *ports):
        each.close()


def test_a_sender_that_repeats_itself_is_stale():
    with opened() as (sender, watch, clock):
        payload = step().pack()
        sender.puts["controller/step"].put(payload)
        until(watch, lambda: watch.step, "nothing came")
        clock.now_s += STALE_S + 1.0
        sender.puts["controller/step"].put(payload)
        sender.puts["loop/timing"].put(landing().timing[5].pack())
        until(watch, lambda: watch.timings, "nothing came")  # timings are sent last: the step has arrived
        assert not watch.fresh
        sender.puts["controller/step"].put(step(1).pack())
        until(watch, lambda: watch.fresh, "a new step is news")


def test_what_is_not_ours_is_counted_and_shown():
    with opened() as (sender, watch, _):
        sender.puts["controller/step"].put(b"something else")
        sender.puts["health"].put(HEALTHY.pack()[:50])
        until(watch, lambda: watch.refused == 2, "not counted")
        assert watch.step is None
        assert "2 samples not readable" in shown(watch)


def test_the_end_of_a_flight_is_told():
    with opened() as (sender, watch, clock):
        sender.puts["controller/step"].put(step(phase=Phase.LANDED, finished=True).pack())
        until(watch, lambda: watch.step, "nothing came")
        sender.session.close()
        clock.now_s += 5.0
        assert "the flight is over: LANDED, 5 s ago" in shown(watch)


def command(*words):
    return [sys.executable, "-m", "flightstack.cli.main", *words]


def test_nobody_there_is_said_and_exit_status_1():
    port = Port()
    words = ("watch", "--connect", port.endpoint, "--once", "--timeout", "0.5")
    done = called(*words)
    assert done.code == 1
    assert f"no reply from {port.endpoint}" in done.out
    done = called(*words, "--json")
    assert (done.code, done.json["fresh"], done.json["connections"]) == (1, False, 0)
    port.close()


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--connect", "nonsense"], "allowed"),
        (["--namespace", "a//b"], "allowed"),
        (["--namespace", "cf1"] * 2, "--namespace: found cf1, cf1; each vehicle is given once"),
    ],
)
def test_wrong_words_are_refused(words, why):
    done = called("watch", "--once", *words)
    assert done.code == 2
    assert why in done.err


@pytest.mark.parametrize(("namespaces", "code"), [(["cf1"], 0), (["cf1", "cf2"], 1)])
def test_a_look_at_once_needs_fresh_data_of_all_vehicles(namespaces, code):
    port, ended = Port(), threading.Event()
    sender, rows = Sender(port.endpoint), itertools.count()

    def send():
        while not ended.wait(0.05):
            number = next(rows)
            sender.puts["controller/step"].put(step()._replace(tick=number).pack())
            sender.puts["health"].put(HEALTHY._replace(tick=number).pack())

    thread = threading.Thread(target=send)
    thread.start()
    words = [word for name in namespaces for word in ("--namespace", name)]
    done = called("watch", "--connect", port.endpoint, "--once", "--json", "--timeout", "2", *words)
    ended.set()
    thread.join()
    sender.session.close()
    port.close()
    fresh = {each["namespace"]: each["fresh"] for each in map(json.loads, done.out.splitlines())}
    assert (done.code, fresh) == (code, {name: name == "cf1" for name in namespaces})


def test_a_flight_in_real_time_is_watched_from_outside(tmp_path):
    """``watch`` shows a flight of ``sitl`` to scripts and on a terminal, and ends by Ctrl-C with status 0."""
    port = Port()
    sitl = subprocess.Popen(
        command("sitl", "--scenario", "straight", "--out", str(tmp_path / "run"), "--no-report", "--listen",
                port.endpoint),
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    watching = subprocess.Popen(
        command("watch", "--connect", port.endpoint, "--json"),
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        # health messages are rarer than steps, so the newest health message may be older than the arming
        seen = list(
            _lines(
                watching,
                lambda v: (
                    v["fresh"] and v.get("phase") == "APPROACH" and v["health"] and v["health"]["armed"]
                ),
            )
        )
        assert not seen[0]["fresh"]
        now = seen[-1]
        assert 3.0 < now["health"]["battery_v"] < 4.3
        assert now["health"]["target_age_s"] < 1.0
        assert now["h_m"] > -0.1
        assert len(now["command_enu_m_s"]) == 3
        once = subprocess.run(
            command("watch", "--connect", port.endpoint, "--once", "--json", "--timeout", "30"),
            cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S, check=True,
        )  # fmt: skip
        assert json.loads(once.stdout)["tick"] > now["tick"]
        page = (ROOT / "docs" / "how_to" / "live.md").read_text(encoding="utf-8")
        example = page.split("```python\n")[1].split("```")[0]
        read = subprocess.run(
            [sys.executable, "-c", example, port.endpoint],
            cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S, check=True,
        )  # fmt: skip
        assert read.stdout.split()[0] in Phase.__members__
        sitl.send_signal(signal.SIGINT)
        text, _ = sitl.communicate(timeout=PATIENCE_S)
        assert f"to watch: flightstack watch --connect {port.endpoint}" in text.replace("\n", " ")
        list(_lines(watching, lambda v: not v["fresh"] and v["age_s"] > STALE_S))
        watching.send_signal(signal.SIGINT)
        _, errors = watching.communicate(timeout=PATIENCE_S)
        assert (watching.returncode, errors) == (0, "")
    finally:
        for child in (sitl, watching):
            killed(child)
        port.close()


def _lines(child, done):
    """Yield the JSON objects that the child prints, up to the first for which ``done`` is true."""
    until_s = time.monotonic() + 3 * PATIENCE_S
    while time.monotonic() < until_s:
        line = line_of(child.stdout)
        assert line, "it ended"
        value = json.loads(line)
        yield value
        if done(value):
            return
    pytest.fail("what we wait for did not come")
