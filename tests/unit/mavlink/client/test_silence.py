"""Why nothing is heard of a vehicle, from what its endpoint has counted."""

import pytest

from bridge.mavlink.client.silence import Arrivals, why_silent
from bridge.mavlink.endpoint import EndpointCounters, LinkCounters


@pytest.mark.parametrize(
    ("grown", "words"),
    [
        ({}, "component 1: nothing arrives"),
        ({"sent": 10}, "nothing arrives"),
        ({"bad_signature": 3, "unsigned": 1}, "3 frames are signed with another key than --signing-key"),
        ({"unsigned": 4, "received": 2}, "4 frames have no signature"),
        ({"stale": 1, "ahead": 2}, "3 signed frames are refused by their time stamps"),
        ({"reflected": 5}, "5 frames have our own ids"),
        ({"version_1": 5, "garbage_bytes": 9}, "5 frames are MAVLink 1"),
        ({"bad_crc": 1, "unknown_id": 1}, "2 frames are damaged or of unknown messages"),
        ({"garbage_bytes": 9}, "9 bytes are no MAVLink 2 frames"),
        ({"received": 9}, "other frames of it come"),
    ],
)
def test_the_cause_is_named_with_its_count(grown, words):
    assert words in why_silent(1, grown, {})


def test_who_speaks_instead_is_named():
    senders = {(255, 190): 3, (2, 1): 4}
    text = why_silent(1, {"received": 7, "unknown_id": 5, "garbage_bytes": 150}, senders)  # as beside PX4
    assert text == (
        "no heartbeat of system 1, component 1: frames come from system/component 2/1, 255/190; --system-id "
        "names the vehicle's"
    )
    many = {(system, 1): 1 for system in range(10, 20)}
    assert "10/1, 11/1, 12/1, 13/1, ...;" in why_silent(1, {"received": 7}, many)
    assert "for 12 s: nothing" in why_silent(1, {}, senders, heard_s=12.3)  # they are silent now, too


def test_only_what_is_new_counts():
    counters, arrivals = EndpointCounters(), Arrivals()
    counters.bad_signature = 5
    assert arrivals.grown(counters) == {"bad_signature": 5}
    assert arrivals.grown(counters) == {}
    counters.add("bad_signature")
    assert arrivals.grown(counters) == {"bad_signature": 1}


def test_senders_are_counted_one_by_one_but_not_without_bound():
    counters = LinkCounters()
    for system in range(1, 256):
        counters.add_foreign((system, 1))
        counters.add_foreign((1, 1))
    assert counters.foreign == 510
    assert len(counters.senders) == 16
    assert counters.senders[1, 1] == 256
