"""Records samples directly from Zenoh, for a log without the rest of the stack.

A sample is recorded if its type is known, from the encoding ``application/cdr;TYPE`` or from a key in the
form of rmw_zenoh, ``DOMAIN/TOPIC/PACKAGE::msg::dds_::NAME_/HASH``. Other samples are counted.
"""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from pathlib import Path

from bridge.zenoh.zenoh_link import ZenohLinkError, drain, open_session, parse_attachment, ring_subscriber
from logs.recorder.recording import Recorder, RecorderError

CDR_ENCODING = "application/cdr;"  # Zenoh's form of an encoding with a schema
_RMW_KEY = re.compile(r"\d+/(?P<topic>.+)/(?P<package>\w+)::msg::dds_::(?P<name>\w+)_/[^/]+")
_CAPACITY = 4096  # samples between two polls a few milliseconds apart; the recorder never blocks a sender


class ZenohSource:
    """Receives the samples of the given keys for a recorder."""

    def __init__(self, connect: Sequence[str], keys: Sequence[str], config_file: Path | None = None) -> None:
        """Open a session and subscribe."""
        try:
            self._session = open_session(connect=connect, config_file=config_file)
        except (ValueError, ZenohLinkError) as error:
            raise RecorderError(str(error)) from error
        try:
            self._subscribers = [ring_subscriber(self._session, key, _CAPACITY) for key in keys]
        except ValueError as error:
            self._session.close()
            raise RecorderError(str(error)) from error

    def poll(self, recorder: Recorder) -> None:
        """Record the received samples; the log time is now, the publish time is the sender's."""
        for subscriber in self._subscribers:
            for sample in drain(subscriber):
                key, encoding, attachment = str(sample.key_expr), str(sample.encoding), sample.attachment
                told = attachment.to_bytes() if attachment is not None else None
                _record(recorder, key, encoding, sample.payload.to_bytes(), told)

    def close(self) -> None:
        self._session.close()


def topic_and_schema(key: str, encoding: str) -> tuple[str, str] | None:
    """Return ROS topic and type of a sample; None if neither key nor encoding contains the type."""
    if match := _RMW_KEY.fullmatch(key):
        return f"/{match['topic']}", f"{match['package']}/msg/{match['name']}"
    if encoding.startswith(CDR_ENCODING):
        return f"/{key}", encoding.removeprefix(CDR_ENCODING)
    return None


def _record(recorder: Recorder, key: str, encoding: str, payload: bytes, attachment: bytes | None) -> None:
    log_time_ns = time.time_ns()
    sequence, publish_time_ns = parse_attachment(attachment) or (0, log_time_ns)
    known = topic_and_schema(key, encoding)
    if known is None or payload[:2] not in (b"\x00\x01", b"\x00\x00"):  # CDR, either byte order
        recorder.statistics.skipped += 1
        return
    try:
        recorder.message(*known, log_time_ns, publish_time_ns, sequence & 0xFFFFFFFF, payload)
    except ValueError:  # an unknown type, or a time before 1970
        recorder.statistics.skipped += 1
