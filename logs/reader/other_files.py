"""What is opened in place of an MCAP file, and what to do."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple


class _Format(NamedTuple):
    begins: bytes | None  # None: known by the name alone
    endings: tuple[str, ...]  # of the names of its files, for damaged ones and for those without fixed bytes
    what: str


_OURS = "logs of this stack are needed"
_FORMATS = (
    _Format(
        b"version https://git-lfs", (), "a pointer of Git LFS; fetch the file itself with `git lfs pull`"
    ),
    _Format(b"\x28\xb5\x2f\xfd", (".zst", ".zstd"), "compressed by zstd; unpack it with `zstd -d`"),
    _Format(b"\x04\x22\x4d\x18", (".lz4",), "compressed by lz4; unpack it with `lz4 -d`"),
    _Format(b"\x1f\x8b", (".gz", ".tgz"), "compressed by gzip; unpack it with `gunzip`"),
    _Format(b"BZh", (".bz2",), "compressed by bzip2; unpack it with `bunzip2`"),
    _Format(b"\xfd7zXZ", (".xz",), "compressed by xz; unpack it with `unxz`"),
    _Format(b"PK\x03\x04", (".zip",), "a ZIP archive; unpack it with `unzip`"),
    _Format(
        b"SQLite format 3",
        (".db3",),
        "an SQLite database, as rosbag2 writes .db3; `ros2 bag convert` makes MCAP of it",
    ),
    _Format(b"#ROSBAG V", (".bag",), "a bag of ROS 1; `mcap convert` makes MCAP of it"),
    _Format(b"ULog\x01", (".ulg",), "a ULog of PX4; `validate` and `identify` read logs of this stack only"),
    _Format(b"\xa3\x95", (".bin",), f"a DataFlash log of ArduPilot; {_OURS}"),
    _Format(None, (".tlog",), f"a telemetry log of MAVLink; {_OURS}"),
    _Format(b"FMT, ", (), f"a DataFlash log of ArduPilot as text; {_OURS}"),
    _Format(b"RRF", (".rrd",), "a recording of Rerun; open it with `rerun`, or give the log it was made of"),
    _Format(b"PAR1", (".parquet",), "a table in Parquet; `validate` takes its folder"),
    _Format(b"<", (".html",), "a page of HTML or XML, as of a download that failed; fetch the file again"),
)


def named(path: Path, head: bytes) -> str:
    """Name the format by a file's first bytes; by the ending of its name where these say nothing."""
    for form in _FORMATS:
        if form.begins is not None and head.startswith(form.begins):
            return f"it is {form.what}"
    begins = f"it begins with {head[:8].hex(' ')}"
    for form in _FORMATS:
        if path.suffix.lower() in form.endings:
            return f"{begins}; by its name it is {form.what}"
    return begins


def no_file(path: Path) -> str:
    """Say what is there in place of a file, and what is needed."""
    if not path.is_dir():
        return "is a pipe, socket or device; an MCAP file is needed"
    logs = sorted(path.glob("*.mcap"))
    what = "a folder of rosbag2" if (path / "metadata.yaml").is_file() else "a folder"
    return f"is {what}; an MCAP file is needed" + (f", for example {logs[0]}" if logs else "")
