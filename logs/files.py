"""Output files of the log tools: a file is complete, or it does not exist."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def new_file(path: Path, *, force: bool) -> Iterator[Path]:
    """Yield a temporary name next to ``path``; after success the file gets its final name."""
    if path.exists() and not force:
        raise FileExistsError(f"{path} exists and is not overwritten; give another name or --force")
    part = path.with_name(f".{path.name}.part")
    try:
        with of_file(path):
            yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def of_file(path: Path) -> Iterator[None]:
    """Add the name of the file to an error of the system, such as a full disk."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno is not None:
            error.filename = str(path)
        raise
