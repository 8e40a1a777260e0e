"""Packs ``/rosout`` events (``rcl_interfaces/msg/Log``), and defines the contact bits of true states."""

from __future__ import annotations

from enum import IntEnum, IntFlag

from logs.schema.rows import LogRow
from logs.schema.schemas import STRING, packer

ONBOARD, CONTROLLER = "onboard", "controller"  # sources of events; a replay compares the controller's events
CAUSE = "cause of the abort: "  # prefix of the event that reports the autopilot's reason

_pack_string = packer(STRING)


class Severity(IntEnum):
    """Levels of ``rcl_interfaces/msg/Log``."""

    DEBUG = 10
    INFO = 20
    WARN = 30
    ERROR = 40
    FATAL = 50


class ContactBit(IntFlag):
    """Contacts of the simulated vehicle: bits of ``TrueState.contacts``."""

    PAD = 1
    GROUND = 2
    ROBOT = 4
    PAD_EDGE = 8
    TUMBLED = 16
    VEHICLE = 32


def pack_log(stamp_ns: int, level: int, name: str, text: str) -> bytes:
    """Return an event as CDR; ``name``: source of the event, a process or the controller."""
    return LogRow(stamp_ns, level, name, text, "", "", 0).pack()


def pack_string(text: str) -> bytes:
    return _pack_string((text,))
