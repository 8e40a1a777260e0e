"""A recorder without the stack takes samples straight from Zenoh."""

from __future__ import annotations

import socket
import threading
import time

import pytest

from bridge.zenoh.zenoh_link import blocking_publisher, is_matched, open_session, pack_attachment
from logs.reader.reader import LogFile
from logs.recorder.record_zenoh import ZenohSource, topic_and_schema
from logs.recorder.recorder import RecorderError, RecorderProcess
from logs.schema import schemas
from tests.unit.logs.recorder.recorder_helpers import DEADLINE_S, timing, wait_until


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_recording_straight_from_zenoh(tmp_path):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    session = open_session(listen=[endpoint])
    try:
        source = ZenohSource([endpoint], ["cf1/**"])
        process = RecorderProcess(None, tmp_path / "flight.mcap", source)
        thread = threading.Thread(target=process.run)
        thread.start()
        try:
            known = blocking_publisher(session, "cf1/loop/timing", f"application/cdr;{schemas.LOOP_TIMING}")
            plain = blocking_publisher(session, "cf1/plain", "text/plain")
            wait_until(lambda: is_matched(known) and is_matched(plain), "the recorder's subscription")
            plain.put(b"hello")
            before_ns = time.time_ns()
            known.put(timing(3), attachment=pack_attachment(17, 123_000, bytes(16)))
            known.put(timing(4))
            counts = process._recorder.statistics
            wait_until(lambda: process._recorder._file.messages == 2, "both samples")
            wait_until(lambda: counts.skipped == 1, "the other sample")
        finally:
            process.stop()
            thread.join(DEADLINE_S)
    finally:
        session.close()
    first, second = LogFile(tmp_path / "flight.mcap").messages()
    assert (first.topic, first.schema, first.data) == ("/cf1/loop/timing", schemas.LOOP_TIMING, timing(3))
    assert (first.sequence, first.publish_time_ns) == (17, 123_000)
    assert before_ns <= first.log_time_ns <= time.time_ns()
    assert second.publish_time_ns == second.log_time_ns


def test_what_a_zenoh_sample_is():
    rmw = "0/cf1/target/odom/nav_msgs::msg::dds_::Odometry_/RIHS01_3cc9"
    assert topic_and_schema(rmw, "zenoh/bytes") == ("/cf1/target/odom", schemas.ODOMETRY)
    assert topic_and_schema("a/b", f"application/cdr;{schemas.LOG}") == ("/a/b", schemas.LOG)
    assert topic_and_schema("a/b", "application/json") is None


def test_bad_zenoh_endpoint_is_a_clear_error():
    with pytest.raises(RecorderError, match="allowed is"):
        ZenohSource(["nowhere"], ["cf1/**"])
    with pytest.raises(RecorderError, match="not allowed"):
        ZenohSource([], ["/cf1//x"])
