"""MAVSDK flies the vehicle process: its C library and Python package, over its own UDP."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from tests.integration.autopilots.real_clients import (
    DOCUMENTATION,
    HOLD,
    LAND,
    OFFBOARD,
    TAKEOFF,
    Observer,
    Program,
    vehicle,
)
from tests.processes.ports import free_port

pytestmark = pytest.mark.xdist_group("real-time")

EXAMPLE_MAX_S = 180.0


def test_documented_example(tmp_path: Path, flight_number: int) -> None:
    block = re.search(r"^```python\n(.*?)^```", DOCUMENTATION.read_text(), re.MULTILINE | re.DOTALL)
    assert block is not None
    port_there = free_port(udp=True)
    script = tmp_path / "example.py"
    script.write_text(block.group(1).replace("0.0.0.0:14540", f"127.0.0.1:{port_there}"))
    with vehicle("--peer", f"127.0.0.1:{port_there}") as port:
        watch = Observer(port)
        with Program([sys.executable, str(script)], watch) as client:
            assert client.end(EXAMPLE_MAX_S) == 0
        watch.close()
    # HOLD between two of them may be shorter than a tick.
    assert [mode for mode in watch.modes() if mode != HOLD] == [TAKEOFF, OFFBOARD, LAND]
    assert watch.armings() == [False, True, False]
    assert max(p.x for p in watch.all("LOCAL_POSITION_NED")) > 0.0
