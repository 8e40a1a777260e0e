"""MAVLink 2 message signing (mavlink.io, guide/message_signing): checks signature, then timestamp.

A frame without a correct signature changes no state. The ids of link, system and component identify a
stream, independent of the address; a frame replayed from another address is also rejected as old.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
import stat
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Annotated

import msgspec

from bridge.mavlink.codec.framing import FLAG_SIGNED, with_signed_flag

KEY_BYTES = 32  # length of the secret key in MAVLink 2 signing, bytes
_HEX = re.compile(rb"[0-9a-fA-F]{64}")
_HELP = "a key file holds 32 bytes or 64 hexadecimal characters; `flightstack key FILE` makes one"


@dataclass(frozen=True, slots=True)
class SigningKey:
    """Secret key shared by all members of a link."""

    secret: bytes = field(repr=False)
    path: Path | None = None


def load_key(path: Path) -> SigningKey:
    """Read a key from a regular file with mode 0600 or 0400."""
    try:
        mode = path.stat().st_mode
        if mode & 0o077:
            raise ValueError(
                f"signing key {path} has mode {mode & 0o777:04o}: other users can access it; "
                f"restrict it with  `chmod 600 {path}`, or a new key if they may have read it"
            )
        data = path.read_bytes() if stat.S_ISREG(mode) else b""  # a device or pipe may have no end
    except OSError as error:
        raise ValueError(f"signing key {path}: {error.strerror}; {_HELP}") from error
    if _HEX.fullmatch(data.strip()):
        data = bytes.fromhex(data.decode())
    if len(data) != KEY_BYTES or len(set(data)) == 1:  # one byte repeated could be guessed
        raise ValueError(f"signing key {path} holds {len(data)} bytes that are no key; {_HELP}")
    return SigningKey(data, path)


def make_key(path: Path) -> None:
    """Write a new random key as 64 hexadecimal characters; only the owner can read the file."""
    try:
        path.touch(0o600, exist_ok=False)
    except FileExistsError as error:
        raise FileExistsError(
            error.errno, f"{path} exists and is not overwritten; give another name"
        ) from error
    path.write_text(secrets.token_hex(KEY_BYTES) + "\n")


Stream = tuple[int, int, int]  # ids of link, system and component

TIMESTAMP_MAX = 2**48 - 1
_Byte = Annotated[int, msgspec.Meta(ge=0, le=255)]
_Timestamp = Annotated[int, msgspec.Meta(ge=0, le=TIMESTAMP_MAX)]
_Row = tuple[_Byte, _Byte, _Byte, _Timestamp]  # stream ids and newest timestamp


class SigningState(msgspec.Struct):
    """Content of the state file; times in units of 10 us since 2015-01-01 UTC, as in MAVLink 2 signing."""

    clock: _Timestamp  # signing clock at the time of writing
    sent: _Timestamp  # timestamp of the last signed frame
    streams: list[_Row]  # ids and newest timestamp of each stream with a frame in the last minute


def load_state(path: Path) -> SigningState:
    """Read the state file; without a file the state is empty."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=SigningState)
    except FileNotFoundError:
        return SigningState(0, 0, [])
    except (ValueError, RecursionError) as error:
        raise ValueError(
            f"signing state {path} cannot be read ({error}): delete it, and frames of the minute before "
            "could be replayed once"
        ) from error


def save_state(path: Path, state: SigningState) -> None:
    """Write a state atomically, readable only by its owner. Raises OSError: it cannot be written."""
    new = path.with_name(f"{path.name}.{os.getpid()}")
    new.touch(0o600)
    new.write_bytes(msgspec.json.encode(state))
    new.replace(path)


EPOCH_NS = 1_420_070_400_000_000_000  # 2015-01-01T00:00:00Z, time zero of signing
TICK_NS = 10_000  # unit of a signing timestamp, ns
_S = 1_000_000_000 // TICK_NS  # ticks per second
STALE_TICKS = 60 * _S  # maximum delay of a new stream behind the local clock (mavlink.io: one minute)
AHEAD_TICKS = 3600 * _S  # maximum lead of a timestamp: ArduPilot adds a minute to its clock at each start
_SAVE_S = 10.0  # time between two writes of the state, s
_LINK = bytes(1)  # link id of every endpoint of this project
_TAG = 6  # number of bytes of the SHA-256 hash in a frame
_STAMP = 12  # number of bytes from the timestamp to the end of the frame


class Refusal(Enum):
    """Reason to reject a frame; the value is the name of its counter."""

    UNSIGNED = "unsigned"
    REFLECTED = "reflected"
    BAD_SIGNATURE = "bad_signature"
    REPLAYED = "replayed"
    STALE = "stale"
    AHEAD = "ahead"


class Signer:
    """Signs the frames that one endpoint sends, and checks the frames that it receives."""

    def __init__(
        self,
        key: SigningKey,
        system_id: int,
        component_id: int,
        *,
        unix_ns: Callable[[], int] = time.time_ns,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Continue from the state of the last run.

        ``unix_ns``: system clock, which may jump; ``monotonic_ns``: clock that never goes back. Raises
        ValueError: the state file is bad; OSError: the state cannot be read or written.
        """
        self.warning: str | None = None  # text for the operator about the clock, or None
        self._own = bytes((system_id, component_id))
        self._keyed = hashlib.sha256(key.secret)
        self._unix_ns, self._monotonic_ns = unix_ns, monotonic_ns
        self._path, state = None, SigningState(0, 0, [])  # a key that is not from a file has no stored state
        if key.path is not None:
            self._path = key.path.with_name(f"{key.path.name}.{system_id}-{component_id}-{_LINK[0]}.state")
            state = load_state(self._path)
        self._sent = state.sent
        # timestamp of the last accepted frame of each stream; only holders of the key add streams
        self._streams: dict[Stream, int] = {row[:3]: row[3] for row in state.streams}
        self._start_ns = monotonic_ns()
        self._start = self._first_time(state.clock)
        self._saved_s = self._start_ns / 1e9
        if self._path is not None:
            save_state(self._path, self._snapshot())  # written at the start, to detect missing permissions

    def now(self) -> int:
        """Return the signing clock in ticks; it never goes back, not even after a restart."""
        elapsed = (self._monotonic_ns() - self._start_ns) // TICK_NS
        return max(self._system(), self._start + elapsed)

    def sign(self, frame: bytes) -> bytes:
        """Sign an unsigned frame; timestamps follow the clock and always increase."""
        self._sent = max(self._sent + 1, self.now())
        body = with_signed_flag(frame) + _LINK + self._sent.to_bytes(6, "little")
        return body + self._tag(body)

    def refusal(self, frame: bytes) -> Refusal | None:
        """Return the reason to reject a frame; None: the frame is accepted, its timestamp stored."""
        if not frame[2] & FLAG_SIGNED:
            return Refusal.UNSIGNED
        if frame[5:7] == self._own:
            return Refusal.REFLECTED  # a reflected frame has a correct signature
        if not hmac.compare_digest(self._tag(frame[:-_TAG]), frame[-_TAG:]):
            return Refusal.BAD_SIGNATURE
        stamp = int.from_bytes(frame[-_STAMP:-_TAG], "little")
        stream = (frame[-_STAMP - 1], frame[5], frame[6])
        last, now = self._streams.get(stream), self.now()
        if stamp > now + AHEAD_TICKS:
            return Refusal.AHEAD
        if last is None and stamp < now - STALE_TICKS:
            return Refusal.STALE
        if last is not None and stamp <= last:
            return Refusal.REPLAYED
        self._streams[stream] = stamp
        return None

    def save_if_due(self) -> None:
        """Write the state every ten seconds."""
        now_s = self._monotonic_ns() / 1e9
        if now_s - self._saved_s >= _SAVE_S:
            self._saved_s = now_s
            self.save()

    def save(self) -> None:
        """Write the state now; a failure does not end a flight, and the next write follows after 10 s."""
        with suppress(OSError):
            if self._path is not None:
                save_state(self._path, self._snapshot())

    def _snapshot(self) -> SigningState:
        """Return the state without streams older than a minute: replays of them are rejected as stale."""
        oldest = self.now() - STALE_TICKS
        rows = [(*ids, stamp) for ids, stamp in self._streams.items() if stamp >= oldest]
        return SigningState(self.now(), self._sent, rows)

    def _tag(self, data: bytes) -> bytes:
        keyed = self._keyed.copy()
        keyed.update(data)
        return keyed.digest()[:_TAG]

    def _system(self) -> int:
        return max(0, (self._unix_ns() - EPOCH_NS) // TICK_NS)

    def _first_time(self, stored: int) -> int:
        behind = stored - self._system()
        if behind <= 0:
            return self._system()
        self.warning = (
            f"the system clock is {behind / _S:.0f} s behind the last run with this signing key: signing "
            f"continues from that run's time; set the clock, and if that time was wrong delete {self._path}"
        )
        # As in ArduPilot, the clock starts later than all frames that followed the last write.
        return stored + STALE_TICKS
