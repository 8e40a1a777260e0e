"""What every process of the simulator writes into the flight log: events on ``/rosout``."""

from __future__ import annotations

from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as dialect

from logs.recorder.feed import Feed
from logs.schema import schemas
from logs.schema.events import Severity, pack_log

_LEVELS: dict[int, Severity] = {
    dialect.MAV_SEVERITY_EMERGENCY: Severity.FATAL,
    dialect.MAV_SEVERITY_ALERT: Severity.FATAL,
    dialect.MAV_SEVERITY_CRITICAL: Severity.ERROR,
    dialect.MAV_SEVERITY_ERROR: Severity.ERROR,
    dialect.MAV_SEVERITY_WARNING: Severity.WARN,
    dialect.MAV_SEVERITY_NOTICE: Severity.INFO,
    dialect.MAV_SEVERITY_INFO: Severity.INFO,
    dialect.MAV_SEVERITY_DEBUG: Severity.DEBUG,
}


class EventLog:
    """``/rosout`` of one process."""

    def __init__(self, feed: Feed, name: str, epoch_ns: int) -> None:
        self.feed = feed
        self.epoch_ns = epoch_ns
        self._name = name
        self._channel = feed.channel("/rosout", schemas.LOG)
        self._sequence = 0

    @classmethod
    def connect(cls, path: str | Path | None, name: str, epoch_ns: int, *, lossless: bool) -> EventLog:
        """Connect to the recorder, if there is one.

        Raises:
            FeedError: nobody listens there.
        """
        return cls(Feed.connect(path, name, lossless=lossless), name, epoch_ns)

    def event(self, now_ns: int, level: int, text: str) -> None:
        """Write one event; ``now_ns`` counts from the epoch."""
        stamp_ns = self.epoch_ns + now_ns
        self._sequence += 1
        payload = pack_log(stamp_ns, level, self._name, text)
        self.feed.write(self._channel, stamp_ns, stamp_ns, self._sequence, payload)

    def statustext(self, now_ns: int, severity: int, text: str) -> None:
        """Write what the autopilot said."""
        self.event(now_ns, _LEVELS.get(severity, Severity.INFO), text)

    def close(self) -> None:
        """Send the rest and say goodbye to the recorder."""
        self.feed.close()
