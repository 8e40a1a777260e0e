"""Tests signed MAVLink, and flights over slow, noisy or interrupted serial lines and TCP connections."""

from __future__ import annotations

import re
import stat
import threading
import time
from contextlib import ExitStack

import pytest

from bridge.mavlink.signing import Signer, load_key
from logs.compare import ABSENT, compare
from tests.flight_suite.room import simulated
from tests.integration.runs import flightstack, fly
from tests.integration.sim_processes import Client, is_a, terminate, verb
from tests.processes.bounded import PATIENCE_S
from tests.processes.started import StartedChild
from tests.serial_relay import PtyEnd, Relay, TcpEnd

ARMED = 128
TAKEOFF, HOLD = 0x02040000, 0x03040000


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / "fleet.key"
    made = flightstack("key", path)
    assert made.code == 0, made.err
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert load_key(path).secret.hex() not in made.out
    return path


@pytest.fixture
def vehicle():
    with ExitStack() as stack:

        def start(*arguments):
            words = ("vehicle", "--scenario", "paper_moving_1", "--url", "udpin:127.0.0.1:0", *arguments)
            child, ready = stack.enter_context(verb(*words, within_s=3 * PATIENCE_S))
            return child, ready.removeprefix("ready ")

        yield start


def signing(client, key):
    """Make a client sign its messages with pymavlink."""
    client._mav.robust_parsing = True
    client._mav.signing.secret_key = key.secret
    client._mav.signing.sign_outgoing = True
    client._mav.signing.timestamp = Signer(key, 255, 190).now()
    return client


@pytest.mark.xdist_group("real-time")
def test_signed_client_flies_and_an_unsigned_one_gets_no_reaction(key_file, vehicle):
    child, url = vehicle("--signing-key", key_file)
    pilot, stranger = signing(Client(url), load_key(key_file)), Client(url)
    disarm = stranger.command(400, 0.0, 21196.0)

    def disturb():
        stranger.hello()
        stranger.send(disarm, stranger.command(21))

    stranger.hello()
    stranger.send(stranger.command(400, 1.0))
    pilot.hello()
    beat = pilot.until(is_a("HEARTBEAT"))
    assert not beat.base_mode & ARMED
    pilot.send(pilot.command(400, 1.0), pilot.command(22))
    assert pilot.until(is_a("COMMAND_ACK", command=400)).result == 0
    assert pilot.until(is_a("COMMAND_ACK", command=22)).result == 0
    pilot.until(is_a("HEARTBEAT", custom_mode=HOLD), each=disturb)
    modes = [m.custom_mode for m in pilot.log if m.get_type() == "HEARTBEAT" and m.base_mode & ARMED]
    assert set(modes) <= {TAKEOFF, HOLD}
    assert pilot.until(is_a("LOCAL_POSITION_NED")).z < -0.3
    assert all(m.get_signed() for m in pilot.log)
    assert stranger.receive(0.2) == []
    terminate(child)
    assert "MAVLink frames rejected: unsigned " in child.stderr.read()


def test_sitl_lands_signed_and_its_log_equals_the_unsigned_one(key_file, flown, tmp_path):
    signed = fly(tmp_path / "signed", "paper_static_2", 0, "--signing-key", key_file)
    plain = flown("paper_static_2", 0)
    assert signed.json["outcome"] == plain.json["outcome"] == "landed"
    states = sorted(p.name for p in key_file.parent.glob("*.state"))
    assert states == ["fleet.key.1-1-0.state", "fleet.key.1-191-0.state"]
    different = compare(tmp_path / "signed/flight.mcap", plain.log).differences
    told = {(d.topic, d.field): (d.a, d.b) for d in different if d.topic.startswith("metadata")}
    assert told == {
        ("metadata cf1/onboard", "signed"): (repr("true"), repr("false")),
        ("metadata cf1/run", "signing_key"): (repr(str(key_file)), repr(ABSENT)),
        ("metadata fleet", "signing_key"): (repr(str(key_file)), repr(ABSENT)),
    }
    rest = [d for d in different if not d.topic.startswith("metadata")]
    assert {(d.topic, d.field) for d in rest} <= {("/cf1/run", "data")}, rest  # the rest is equal
    for each in rest:
        assert each.a.replace(f"signing_key = {key_file}\\n", "") == each.b


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--url", "udpin:0.0.0.0:0"), "--signing-key FILE"),
        (("--peer", "nowhere"), "allowed is HOST:PORT"),
        (("--peer", "127.0.0.1:14550", "--lockstep"), "in lockstep the companion calls first"),
        (("--signing-key", "/none/fleet.key"), "flightstack key FILE"),
    ],
)
def test_wrong_wires_of_the_vehicle_are_refused_with_what_to_do(arguments, words):
    done = flightstack("vehicle", "--scenario", "paper_moving_1", *arguments)
    assert done.code in (1, 2)
    assert words in done.err


FLIGHT_MAX_S = 120.0
SLOW = 57_600  # rate of the slow serial line, baud


def land_over(folder, make_near, baud, *, noise_bytes_s=0.0, cut_s=(), config="sitl-1kg"):
    """Fly scenario ``large`` in real time; return exit status, output and relay.

    ``make_near``: creates the relay's end at the onboard process; ``cut_s``: wall time from the
    approach to the disconnection of the cable, and duration of the disconnection, s; ``noise_bytes_s``: as in
    ``Relay``.
    """
    with ExitStack() as stack:
        room = stack.enter_context(simulated(folder, "large"))
        port = int(room.url.rpartition(":")[2])
        relay = Relay(make_near(folder), port, baud, noise_bytes_s=noise_bytes_s)
        stack.callback(relay.close)
        flight = StartedChild(
            "onboard",
            ["onboard", "--vehicle", relay.near.url, "--target", room.target_key, "--connect", *room.connect,
             "--listen", room.listen, "--config", str(config), "--autopilot", "sitl"],
            folder,
        )  # fmt: skip
        stack.callback(flight.end)
        flight.wait_ready()
        cutter = threading.Thread(target=_cut, args=(relay, cut_s), daemon=True)
        lines, until_s = [], time.monotonic() + FLIGHT_MAX_S
        while flight.alive() and time.monotonic() < until_s:
            lines += flight.lines(0.2)
            if cut_s and not cutter.ident and any("-> APPROACH" in line for line in lines):
                cutter.start()
        assert not flight.alive(), f"no end within {FLIGHT_MAX_S:g} s: {lines[-5:]}"
        lines += flight.lines(0.0)
        return flight.end(), "\n".join([*lines, flight.output.read_text()]), relay


def _cut(relay, cut_s):
    after_s, for_s = cut_s
    time.sleep(after_s)
    relay.pull()
    time.sleep(for_s)
    relay.plug()


@pytest.mark.xdist_group("real-time")
# runs in the stream of PX4, never beside PX4, whose threads delay the pseudo-terminal's kernel workers
@pytest.mark.xdist_group("stream 0")
def test_lands_over_a_slow_and_noisy_serial_line(tmp_path):
    code, text, relay = land_over(tmp_path, lambda folder: PtyEnd(folder, SLOW), SLOW, noise_bytes_s=100.0)
    assert code == 0, text
    assert "position and attitude at 50 Hz" in text
    assert relay.noise_bytes > 500
    (sent,) = re.findall(r"serial line in .* B/s in, (\d+) B/s out", text)
    assert 500 < int(sent) < 0.9 * SLOW / 10, "more was sent than the line carries"


@pytest.mark.xdist_group("real-time")
def test_pulled_cable_is_told_and_the_vehicles_own_fail_safe_lands_it(tmp_path):
    code, text, _ = land_over(tmp_path, lambda _: TcpEnd(), None, cut_s=(0.5, 1.0))
    assert code == 1, text
    assert "TCP connection to 127.0.0.1" in text
    assert "is lost" in text
    assert "is connected again after" in text
    assert "mode changed without a command from this stack" in text
