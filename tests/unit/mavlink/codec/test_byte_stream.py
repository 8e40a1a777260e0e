"""Tests endpoints on serial lines and TCP, with full buffers, and with a line that is in use or missing."""

import time
from collections import Counter

import pytest

from bridge.mavlink.codec.framing import split_frames
from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.transport.transport import RETRY_S
from tests.processes.bounded import AT_ONCE_S, wait_for
from tests.serial_relay import PtyEnd, TcpEnd
from tests.unit.mavlink.codec.frames_of_messages import frames_of, position


@pytest.fixture(params=["serial", "tcp"])
def wire(request, tmp_path):
    """Yield (far end, endpoint) over a pseudo-terminal and over TCP."""
    far = PtyEnd(tmp_path, 921_600) if request.param == "serial" else TcpEnd()
    endpoint = Endpoint(far.url, 1, 191)
    yield far, endpoint
    endpoint.close()
    far.close()


def connected(far, endpoint):
    """Wait until bytes arrive in both directions."""
    came = []

    def passed():
        endpoint.send([position()])
        if far.read():
            far.write(frames_of(1)[0])
        endpoint.wait(0.01)
        came.extend(endpoint.receive())
        return came

    wait_for(passed, "the line was not connected")
    while far.read():
        pass


def test_full_line_drops_whole_messages_and_never_blocks(wire):
    far, endpoint = wire
    connected(far, endpoint)
    began, sent = endpoint.counters["sent"], 0
    longest_s = 0.0
    while endpoint.counters["outgoing_full"] < 200:
        before_s = time.monotonic()
        endpoint.send([position(float(sent % 1000))])
        longest_s = max(longest_s, time.monotonic() - before_s)
        sent += 1
        assert sent < 200_000, "the buffers have no end"
    assert longest_s < AT_ONCE_S  # generous, since a blocking write would never end
    assert endpoint.counters["sent"] - began == sent
    data, whole = bytearray(), sent - endpoint.counters["outgoing_full"]

    def drained():
        while piece := far.read():
            data.extend(piece)
        endpoint.wait(0.005)
        endpoint.send([])
        return len(split_frames(bytes(data), Counter())) >= whole

    wait_for(drained, "what waited did not come out")
    counters = Counter()
    assert len(split_frames(bytes(data), counters)) == whole
    assert counters == Counter(), "half a frame came out"


def test_serial_port_in_use_is_a_clear_error(tmp_path):
    far = PtyEnd(tmp_path, 57_600)
    first = Endpoint(far.url, 1, 191)
    try:
        with pytest.raises(OSError, match=r"another process|exclusively"):
            Endpoint(far.url, 1, 191)
    finally:
        first.close()
        far.close()


def test_vehicle_that_is_not_there_yet_is_called_until_it_is():
    far = TcpEnd()
    far.pull()
    endpoint = Endpoint(far.url, 1, 191)
    notices = []

    def told():
        endpoint.wait(0.01)
        notices.extend(endpoint.take_notices())
        return notices

    wait_for(told, "nothing was said")
    assert "cannot be opened" in notices[0]
    far.plug()
    began_s = time.monotonic()
    connected(far, endpoint)
    assert time.monotonic() - began_s < RETRY_S + AT_ONCE_S
    endpoint.close()
    far.close()


def test_peer_of_tcp_on_the_network_follows_the_policy_of_udpout():
    endpoint = Endpoint("tcp:192.0.2.1:5760", 1, 191)  # TEST-NET-1 never replies
    assert "not signed" in endpoint.warnings[0]
    before_s = time.monotonic()
    endpoint.send([position()])
    assert endpoint.receive() == []
    assert time.monotonic() - before_s < AT_ONCE_S
    endpoint.close()
