"""Landings over a serial line and over TCP: slow, noisy, cut, and pulled out in flight."""

from __future__ import annotations

import re
import threading
import time
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from flightstack.common.processes import Child, Port
from tests.serial_relay import PtyEnd, Relay, TcpEnd

pytestmark = pytest.mark.xdist_group("real-time")

ROOT = Path(__file__).parents[3]
FLIGHT_MAX_S = 120.0
SLOW = 57_600  # baud


def fly(folder, make_near, baud, *, noise_bytes_s=0.0, cut_s=(), config="sitl-1kg"):
    """One landing of scenario ``large`` in real time; its exit status, output, relay.

    Args:
        folder: for the outputs of the processes.
        make_near: makes the relay's end at the onboard process.
        baud: of the line, None without a limit.
        noise_bytes_s: random bytes a second beside the vehicle's.
        cut_s: (after how many seconds of flight, for how many) the cable is pulled.
        config: of the onboard process.
    """
    with ExitStack() as stack:
        ports = [stack.enter_context(closing(Port())) for _ in range(2)]
        robot, onboard = (port.endpoint for port in ports)
        target = Child(
            "target", ["target", "--scenario", "large", "--listen", robot, "--connect", onboard], folder
        )
        stack.callback(target.end)
        target.wait_ready()
        vehicle = Child(
            "vehicle",
            ["vehicle", "--scenario", "large", "--url", "udpin:127.0.0.1:0", "--connect", robot],
            folder,
        )
        stack.callback(vehicle.end)
        port = int(vehicle.wait_ready().rpartition(":")[2])
        relay = Relay(make_near(folder), port, baud, noise_bytes_s=noise_bytes_s)
        stack.callback(relay.close)
        flight = Child(
            "onboard",
            ["onboard", "--vehicle", relay.near.url, "--target", "cf1/target/odom", "--connect", robot,
             "--listen", onboard, "--config", str(config), "--autopilot", "sitl"],
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


def test_lands_over_a_slow_and_noisy_serial_line(tmp_path):
    code, text, relay = fly(tmp_path, lambda folder: PtyEnd(folder, SLOW), SLOW, noise_bytes_s=100.0)
    assert code == 0, text
    assert "position and attitude at 50 Hz" in text
    assert relay.noise_bytes > 500
    (sent,) = re.findall(r"serial line in .* B/s in, (\d+) B/s out", text)
    assert 500 < int(sent) < 0.9 * SLOW / 10, "more was sent than the line carries"


def test_pulled_cable_is_told_and_the_vehicles_own_fail_safe_lands_it(tmp_path):
    code, text, _ = fly(tmp_path, lambda _: TcpEnd(), None, cut_s=(0.5, 1.0))
    assert code == 1, text
    assert "TCP connection to 127.0.0.1" in text
    assert "is lost" in text
    assert "is connected again after" in text
    assert "mode changed by someone else" in text
