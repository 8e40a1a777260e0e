"""The file of a MAVLink signing key, readable by its owner only."""

from __future__ import annotations

import os
import re
import secrets
import stat
from dataclasses import dataclass, field
from pathlib import Path

KEY_BYTES = 32  # MAVLink 2 message signing, secret key
_READ_MAX = 4096  # bytes; far more than any allowed content
_HEX = re.compile(rb"[0-9a-fA-F]{64}")
_HELP = "a key file holds 32 bytes or 64 hexadecimal characters; `flightstack key FILE` makes one"


@dataclass(frozen=True, slots=True)
class SigningKey:
    """A secret key shared by all members of a link.

    Raises ValueError: the secret has another length, or all its bytes are the same.
    """

    secret: bytes = field(repr=False)
    path: Path | None = None

    def __post_init__(self) -> None:
        if len(self.secret) != KEY_BYTES:
            raise ValueError(f"signing key has {len(self.secret)} bytes: {KEY_BYTES} are needed; {_HELP}")
        if len(set(self.secret)) == 1:
            raise ValueError(f"signing key is one byte repeated, which can be guessed; {_HELP}")


def load_key(path: Path) -> SigningKey:
    """Read a key file: an ordinary file with mode 0600 or 0400.

    Raises ValueError: another mode, or no key in it; OSError: it cannot be read.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise OSError(error.errno, f"signing key {path}: {error.strerror}; {_HELP}") from error
    try:
        mode = os.fstat(descriptor).st_mode  # mode of the opened file; the name may have changed
        if not stat.S_ISREG(mode):
            raise ValueError(f"signing key {path} is no ordinary file; {_HELP}")
        if mode & 0o077:
            raise ValueError(
                f"signing key {path} has mode {mode & 0o777:04o}: other users can access it; "
                f"restrict it with  `chmod 600 {path}`, or a new key if they may have read it"
            )
        data = os.read(descriptor, _READ_MAX)
    finally:
        os.close(descriptor)
    text = data.strip()
    if len(data) != KEY_BYTES and not _HEX.fullmatch(text):
        raise ValueError(f"signing key {path} holds {len(data)} bytes that are no key; {_HELP}")
    return SigningKey(data if len(data) == KEY_BYTES else bytes.fromhex(text.decode()), path)


def make_key(path: Path) -> None:
    """Write a new random key, as 64 hexadecimal characters, readable by its owner only.

    Raises FileExistsError: the file exists and is not overwritten; OSError: it cannot be written.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    except FileExistsError as error:
        raise FileExistsError(
            error.errno, f"{path} exists and is not overwritten; give another name"
        ) from error
    with os.fdopen(descriptor, "w") as file:
        file.write(secrets.token_hex(KEY_BYTES) + "\n")
