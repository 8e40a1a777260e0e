"""MAVSDK flies the vehicle process: its C library and Python package, over its own UDP."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.integration.autopilots.real_clients import (
    DOCUMENTATION,
    HOLD,
    LAND,
    OFFBOARD,
    ON_GROUND,
    STEP_MAX_S,
    TAKEOFF,
    Observer,
    Program,
    vehicle,
)
from tests.processes.ports import free_port

pytestmark = pytest.mark.xdist_group("real-time")

CLIENT = Path(__file__).with_name("mavsdk_client.py")
STORY_MAX_S = 180.0


@contextmanager
def story(name: str, directory: Path) -> Iterator[tuple[Program, Observer, int]]:
    """MAVSDK calls the vehicle and plays a story; somebody else watches. The other way: the example."""
    with vehicle() as port:
        watch = Observer(port)
        try:
            with Program([sys.executable, str(CLIENT), f"udpout://127.0.0.1:{port}", name], watch) as client:
                yield client, watch, port
                client.expect(r"step done\n", STORY_MAX_S)
                assert client.end() == 0
        finally:
            watch.close()


def test_whole_flight(tmp_path: Path, flight_number: int) -> None:
    with story("flight", tmp_path) as (client, watch, _):
        client.expect(r"step parameters \d+\n")
        client.expect("step offboard")
        square = len(watch.log)
        client.expect("step east", 4 * STEP_MAX_S)
        positions = watch.all("LOCAL_POSITION_NED", square)
        client.expect("step down")
    assert watch.modes() == [HOLD, TAKEOFF, HOLD, OFFBOARD, HOLD, LAND, HOLD]
    assert watch.armings() == [False, True, False]
    north = [p.x for p in positions]
    east = [p.y for p in positions]
    for way in (north, east):  # half a metre, and the way the vehicle needs to stop
        assert 0.5 < max(way) - min(way) < 0.9
    assert all(0.3 < -p.z < 0.7 for p in positions)
    assert 0.3 < max(p.vx for p in positions) < 0.51  # the paper's gains overshoot by a third
    assert -0.51 < min(p.vy for p in positions) < -0.3
    assert watch.last("EXTENDED_SYS_STATE").landed_state == ON_GROUND
    assert -watch.last("LOCAL_POSITION_NED").z < 0.05


def test_documented_example(tmp_path: Path, flight_number: int) -> None:
    block = re.search(r"^```python\n(.*?)^```", DOCUMENTATION.read_text(), re.MULTILINE | re.DOTALL)
    assert block is not None
    port_there = free_port(udp=True)
    script = tmp_path / "example.py"
    script.write_text(block.group(1).replace("0.0.0.0:14540", f"127.0.0.1:{port_there}"))
    with vehicle("--peer", f"127.0.0.1:{port_there}") as port:
        watch = Observer(port)
        with Program([sys.executable, str(script)], watch) as client:
            assert client.end(STORY_MAX_S) == 0
        watch.close()
    # HOLD between two of them may be shorter than a tick.
    assert [mode for mode in watch.modes() if mode != HOLD] == [TAKEOFF, OFFBOARD, LAND]
    assert watch.armings() == [False, True, False]
    assert max(p.x for p in watch.all("LOCAL_POSITION_NED")) > 0.0
