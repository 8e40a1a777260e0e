"""Events of PX4 in PX4's words, by the table of their numbers."""

import pytest

from bridge.mavlink.client import texts
from bridge.mavlink.client.texts import EVENT, event_text
from bridge.mavlink.codec.wide_messages import MESSAGES
from tests import tables
from tests.px4_flight import px4_or_skip


def event(number, log_levels=0x66, arguments=b""):
    return MESSAGES[EVENT](0, 0, number, 0, 0, log_levels, list(arguments.ljust(40, b"\x00")))


@pytest.mark.parametrize(
    ("number", "levels", "arguments", "wanted"),
    [
        (0x0190CAF3, 0x66, "04", (6, "Armed by external command")),
        (0x01F46777, 0x66, "07", (6, "Disarmed by auto preflight disarming")),
        (0x012F1DC7, 0x33, "0040000014", (3, "No offboard signal")),
        (0x01A9B99D, 0x22, "", (2, "Connection to mission computer lost")),
        (0x01125BEF, 0x66, "ea070b16101b34", (6, "logging: opening log file 2026-11-22/16_27_52.ulg")),
    ],
)
def test_event_is_told_in_px4s_words(number, levels, arguments, wanted):
    assert event_text(event(number, levels, bytes.fromhex(arguments))) == wanted


@pytest.mark.parametrize("levels", [0x88, 0x09, 0x3F])
def test_event_of_the_protocol_is_not_told(levels):
    assert event_text(event(0x0190CAF3, levels)) is None


def test_every_event_of_the_table_is_told_whatever_its_arguments():
    table = texts._table()
    assert len(table.events) > 300
    for number in table.events:
        for fill in (0x00, 0x01, 0x7F, 0xFF):
            severity, text = event_text(event(number, 0x04, bytes([fill]) * 40))
            assert severity == 4
            assert text
            assert text.isprintable()
            assert "{" not in text


def test_table_is_what_its_command_makes():
    metadata = px4_or_skip().parent / "etc/extras/all_events.json.xz"
    assert tables.EVENTS.read_text() == tables.events_table(metadata)
