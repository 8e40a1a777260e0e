"""Imitates ArduCopter's SITL program: accepts its arguments and serves the fake autopilot on its TCP port."""

import argparse
import select
import signal
import socket
import sys
import time
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as dialect

from tests.fake_autopilot import PERIOD_S, FakeAutopilot
from tests.unit.onboard.safe_parameters import ARDUPILOT_46, packed

PORT, PORTS_APART = 5760, 10


def main():
    parser = argparse.ArgumentParser()
    for name in ("--model", "--speedup", "--home", "--defaults"):
        parser.add_argument(name, required=True)
    parser.add_argument("-I", dest="instance", type=int, default=0)
    given = parser.parse_args()
    assert (given.model, len(given.home.split(","))) == ("quad", 4)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    lines = [line.split() for line in Path(given.defaults).read_text().splitlines()]
    wanted = {name: float(value) for name, value in lines if name in ARDUPILOT_46}
    fake = FakeAutopilot("ardupilot", packed("4.6"), ARDUPILOT_46 | wanted)
    wire, begin_s = dialect.MAVLink(None, 1, 1), time.monotonic()
    with socket.create_server(("127.0.0.1", PORT + PORTS_APART * given.instance)) as server:
        while True:
            with server.accept()[0] as tcp:
                fly(fake, tcp, wire, begin_s)


def fly(fake, tcp, wire, begin_s):
    """Serve one client until it disconnects."""
    while True:
        messages = fake.step(time.monotonic() - begin_s)
        if select.select([tcp], [], [], PERIOD_S)[0]:
            if not (data := tcp.recv(65536)):
                return
            for message in wire.parse_buffer(data) or []:
                messages += fake.handle(message)
        tcp.sendall(b"".join(message.pack(wire) for message in messages))


if __name__ == "__main__":
    main()
