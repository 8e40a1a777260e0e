"""Tests which data the live 3-D scene shows or rejects, and that a hanging viewer delays no process."""

import contextlib
import itertools
import os
import signal
import subprocess
import time
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from bridge.zenoh import zenoh_link
from flightstack.common.processes import Port
from tests.integration.runs import COMMAND, called, entities, flightstack, rrd_reader
from tests.integration.sim_processes import ROOT
from tests.processes.bounded import killed, line_of, wait_for
from tests.synthetic_flight import landing

pytestmark = pytest.mark.xdist_group("real-time")

CONFIG = ROOT / "flightstack" / "config" / "sitl-1kg.toml"
KEYS = ("controller/step", "loop/timing")
PAD_RADIUS_M = 0.5  # radius of the pad in the configuration, m
ROWS = landing().steps[::5]  # rows at 20 Hz, the published rate
PUTS = 2000  # number of samples; more than fit into all queues
PUT_TIME_MAX_S = 0.01


def test_a_flight_in_pieces_is_drawn_as_a_log_of_it_is(tmp_path):
    from logs.view.live import LiveRecording

    whole = tmp_path / "pieces.rrd"
    recording = LiveRecording(str(whole), {"cf1": None, "cf2": None})
    for begin in range(0, len(ROWS), 3):
        piece = ROWS[begin : begin + 3]
        timings = [t for t in landing().timing if piece[0].tick <= t.tick <= piece[-1].tick]
        for name in ("cf1", "cf2"):
            recording.add(name, piece, timings, "made up")
    recording.add("cf1", [], [])
    recording.close()
    rows, columns = entities(whole)
    for entity in ("/cf1/barrier/h/estimate", "/cf2/velocity/z/filtered", "/world/cf1/vehicle"):
        assert rows[entity] == rows["/world/cf2/target"] == len(ROWS)
    assert 2 * rows["/cf1/phase"] == rows["/events"] == 2 * len({r.phase for r in ROWS})
    assert any(name.startswith("LineStrips3D:strips") for name in columns["/world/cf1/vehicle_path"])
    assert any(name.startswith("Arrows3D:vectors") for name in columns["/world/cf1/velocity/nominal"])
    assert "/world/cf1/target_pad/barrier" not in columns  # the shape of the barrier was not published
    reader = rrd_reader(whole)
    assert (len(reader.recordings()), len(reader.blueprints())) == (1, 1)


@pytest.fixture
def sender():
    """Yield publishers like those of the onboard process, and their Zenoh endpoint."""
    port = Port()
    session = zenoh_link.open_session([port.endpoint], [])
    yield {key: zenoh_link.dropping_publisher(session, f"cf1/{key}") for key in KEYS}, port.endpoint
    session.close()
    port.close()


@pytest.fixture
def watching(sender, tmp_path):
    """Run ``watch --view``, which receives from ``sender``; yield the process and its recording's path."""
    out = tmp_path / "live.rrd"
    child = subprocess.Popen(
        [*COMMAND, "watch", "--connect", sender[1], "--view", str(out), "--config", str(CONFIG)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert line_of(child.stdout) == f"ready {out}\n"
        wait_for(lambda: all(map(zenoh_link.is_matched, sender[0].values())), "a viewer that listens")
        yield child, out
    finally:
        killed(child)


def test_watch_draws_with_barrier_and_pad_of_the_configuration(sender, watching):
    puts, (child, out) = sender[0], watching
    sizes, flight = set(), zip(itertools.cycle(ROWS), itertools.cycle(landing().timing), strict=False)

    def grows():
        row, timing = next(flight)
        puts["controller/step"].put(row.pack())
        puts["loop/timing"].put(timing.pack())
        time.sleep(0.02)  # 50 Hz or less, because a slow viewer drops old data
        sizes.add(out.stat().st_size)
        return len(sizes) > 20

    wait_for(grows, "a recording that grows while it flies")
    child.send_signal(signal.SIGINT)
    _, errors = child.communicate(timeout=60.0)
    assert (child.returncode, errors) == (0, "")
    rows, columns = entities(out)
    assert rows["/world/cf1/vehicle"] > 10
    assert any(name.startswith("Mesh3D") for name in columns["/world/cf1/target_pad/barrier"])
    for chunk in rrd_reader(out).store().stream().to_chunks():
        if chunk.entity_path == "/world/cf1/target/pad":
            batch = chunk.to_record_batch()
            (name,) = [n for n in batch.schema.names if n.startswith("Cylinders3D:radii")]
            assert batch.column(name).to_pylist()[0][0] == pytest.approx(PAD_RADIUS_M)


def commands():
    """Return the command lines of all processes."""
    lines = []
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):  # the process may have ended
            lines.append(file.read_bytes().split(b"\0"))
    return lines


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])  # a flight ends its view by SIGTERM
def test_the_server_of_the_web_page_ends_with_watch(sender, number):
    child = subprocess.Popen(
        [*COMMAND, "watch", "--connect", sender[1], "--view", "web"],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    try:
        port = str(urlsplit(line_of(child.stdout).removeprefix("ready ").strip()).port).encode()
        assert any(b"--serve-web" in words and port in words for words in commands())
        child.send_signal(number)
        child.wait(60.0)
        wait_for(lambda: not any(port in words for words in commands()), "the end of the server")
    finally:
        killed(child)


def test_a_viewer_that_hangs_holds_up_nobody(sender, watching):
    puts, (child, _) = sender[0], watching
    os.kill(child.pid, signal.SIGSTOP)
    try:
        payload, took_s = ROWS[50].pack(), []
        for _ in range(PUTS):
            begin_s = time.thread_time()
            puts["controller/step"].put(payload)
            took_s.append(time.thread_time() - begin_s)
        assert sorted(took_s)[-5] < PUT_TIME_MAX_S
    finally:
        os.kill(child.pid, signal.SIGCONT)
    child.send_signal(signal.SIGTERM)
    child.communicate(timeout=60.0)
    assert child.returncode == 0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--view", "scene.txt"], "web or a file that ends with .rrd"),
        (["--view", "web", "--json"], "give one of them"),
        (["--view", "x.rrd", "--config", "nonesuch"], "nonesuch"),
        (["--view", "x.rrd", *["--config", "crazyflie"] * 2], "found 2; none, or one for each --namespace"),
        (
            ["--view", "x.rrd", "--namespace", "a", "--namespace", "b", "--config", "crazyflie"],
            "needed, here 2",
        ),
    ],
)
def test_wrong_words_are_refused(tmp_path, words, told):
    done = called("watch", *words, cwd=tmp_path)
    assert done.code == 2
    assert told in done.err
    assert list(tmp_path.iterdir()) == []


def test_sitl_shows_all_vehicles_to_the_view_and_to_ros_2(tmp_path):
    port, out = Port(), tmp_path / "live.rrd"
    router = zenoh_link.open_session([port.endpoint], role=zenoh_link.Role.ROUTER)
    heard = [zenoh_link.ring_subscriber(router, f"0/cf{n}/controller/step/**", 8) for n in (1, 2, 3)]
    done = flightstack(
        "sitl", "--scenario", "fleet_3", "--lockstep", "--json", "--no-report", "--view", out,
        "--ros2", port.endpoint, "--out", tmp_path / "run",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert done.json["outcome"] == "landed"
    assert all(map(zenoh_link.drain, heard))
    router.close()
    port.close()
    rows, columns = entities(out)
    for name in ("cf1", "cf2", "cf3"):
        assert rows[f"/world/{name}/vehicle"] > 0  # lockstep is faster than the viewer, which drops old data
        assert f"/world/{name}/target_pad/barrier" in columns
