"""Output files of the log tools: a file is complete, or it does not exist."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def new_file(path: Path, *, force: bool) -> Iterator[Path]:
    """Yield a temporary name next to ``path``; after success the file gets its final name."""
    _refuse(path, force)
    number, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
    os.close(number)
    part = Path(name)
    try:
        with of_file(path):
            yield part
        with part.open("rb") as stream:
            os.fsync(stream.fileno())
        part.chmod(0o666 & ~_umask())
        _refuse(path, force)  # another process may have created it meanwhile
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def of_file(path: Path) -> Iterator[None]:
    """Let an error of the system, such as a full disk, name the file."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno is not None:
            error.filename = str(path)
        raise


def _refuse(path: Path, force: bool) -> None:
    if path.exists() and not force:
        raise FileExistsError(f"{path} exists and is not overwritten; give another name or --force")


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
