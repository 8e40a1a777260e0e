#!/usr/bin/env python3
"""A stand-in for ArduCopter's SITL program: its arguments, its TCP port, and our simulated vehicle behind it.

It stands at its home, knows no robot, and reads the parameters of its defaults file that the simulated
vehicle has.
"""

import argparse
import contextlib
import select
import signal
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

from flightstack.common.strict_toml import dumps
from sim.autopilot.profiles import PROFILES
from sim.scenarios.scenario import load

PORT, PORTS_APART = 5760, 10
FAR_M = (200.0, 200.0)  # where no robot is in the way
COMMAND = [sys.executable, "-m", "flightstack.cli.main", "vehicle"]


def scenario_file(folder: Path) -> Path:
    """A vehicle that stands at the origin."""
    found = load("grid")
    found = replace(
        found,
        start=replace(found.start, ground_position_m=(0.0, 0.0)),
        target=replace(found.target, position_m=FAR_M),
    )
    file = folder / "stand_in.toml"
    file.write_text(dumps(found))
    return file


def known_parameters(defaults: Path) -> list[str]:
    """Words of ``vehicle`` for the parameters that it has."""
    has = {p.name for p in PROFILES["ardupilot"].parameters(1) if p.low < p.high}
    pairs = [line.split() for line in defaults.read_text().splitlines()]
    return [word for name, value in pairs if name in has for word in ("--parameter", f"{name}={value}")]


def main() -> None:
    parser = argparse.ArgumentParser()
    for name in ("--model", "--speedup", "--home", "--defaults"):
        parser.add_argument(name, required=True)
    parser.add_argument("-I", dest="instance", type=int, default=0)
    given = parser.parse_args()
    assert given.model == "quad"
    assert len(given.home.split(",")) == 4
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    words = ["--scenario", str(scenario_file(Path.cwd())), "--url", "udpin:127.0.0.1:0"]
    words += ["--profile", "ardupilot", *known_parameters(Path(given.defaults))]
    vehicle = subprocess.Popen([*COMMAND, *words], stdout=subprocess.PIPE, text=True)
    with contextlib.ExitStack() as stack:
        stack.callback(vehicle.wait, 10.0)
        stack.callback(vehicle.terminate)
        assert vehicle.stdout is not None
        port = int(vehicle.stdout.readline().rsplit(":", 1)[1])
        server = stack.enter_context(socket.create_server(("127.0.0.1", PORT + PORTS_APART * given.instance)))
        udp = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        udp.connect(("127.0.0.1", port))
        while True:
            carry(server.accept()[0], udp)


def carry(tcp: socket.socket, udp: socket.socket) -> None:
    """Carry bytes both ways until the client hangs up."""
    with tcp:
        while True:
            for ready in select.select([tcp, udp], [], [])[0]:
                data = ready.recv(65536)
                if ready is tcp and not data:
                    return
                (udp if ready is tcp else tcp).sendall(data)


if __name__ == "__main__":
    main()
