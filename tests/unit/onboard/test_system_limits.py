"""Tests limits of the system: long socket paths, read-only caches, no shared memory, encodings."""

import codecs
import errno
import os
import re
import socket
import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner

from bridge.mavlink.transport.address import parse_peer, parse_url
from bridge.zenoh import zenoh_link
from flightstack.cli.logs import new_file
from flightstack.cli.main import main
from flightstack.common.processes import socket_folder
from flightstack.common.strict_toml import ConfigError, decoded, parse_toml, read_toml
from flightstack.compiled import jit
from flightstack.config import options
from logs.report.page import Page, ReportError, write
from tests.integration.sim_processes import COMMAND

SHIPPED = Path(options.__file__).parent / "sitl-1kg.toml"


@pytest.mark.parametrize("length", [40, 80, 101, 180])
def test_sockets_have_short_paths_however_long_tmpdir_is(tmp_path_factory, monkeypatch, length):
    base = tmp_path_factory.mktemp("b")
    place = base / ("d" * max(1, length - len(str(base)) - 1))
    place.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(place))
    folder = socket_folder()
    try:
        assert (folder.parent == place) == (len(str(place)) < 80)
        assert folder.stat().st_mode & 0o077 == 0
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(str(folder / "recorder"))
        (folder / "recorder").unlink()
    finally:
        folder.rmdir()
    assert list(place.iterdir()) == []


@pytest.mark.parametrize(
    ("closed", "chosen", "expected"),
    [
        ((), None, "package/__pycache__"),
        (("package",), None, "home/.cache/flightstack"),
        (("package", "home"), None, f"flightstack-{os.getuid()}"),
        ((), "chosen", "chosen"),
        (("chosen",), "chosen", "package/__pycache__"),
    ],
)
def test_machine_code_is_stored_in_the_first_folder_that_can_be_written(
    tmp_path, monkeypatch, closed, chosen, expected
):
    usable = jit._usable
    refused = {tmp_path / name for name in closed}
    monkeypatch.setattr(jit, "_usable", lambda d: not refused & set(d.parents) and usable(d))
    monkeypatch.setattr(jit, "HERE", tmp_path / "package")
    monkeypatch.setattr(jit, "_fingerprint", lambda: "0")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    if chosen:
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / chosen))
    assert jit.cache_directory.__wrapped__() == tmp_path / expected / "jit-0"


@pytest.mark.parametrize(
    "encode",
    [
        lambda text: text.encode(),
        lambda text: codecs.BOM_UTF8 + text.encode(),
        lambda text: text.encode("utf-16"),
        lambda text: codecs.BOM_UTF16_BE + text.encode("utf-16-be"),
        lambda text: text.encode("utf-32"),
        lambda text: text.replace("\n", "\r\n").encode("utf-16"),
    ],
)
def test_files_of_windows_editors_are_read(encode, tmp_path):
    text = "# größer\n" + SHIPPED.read_text(encoding="utf-8")
    file = tmp_path / "a.toml"
    file.write_bytes(encode(text))
    assert read_toml(file) == read_toml(SHIPPED)
    assert decoded(encode("1,2\n")).split() == ["1,2"]
    printed = CliRunner().invoke(main, ["config", str(file)])
    assert (printed.exit_code, printed.output.splitlines()) == (0, text.splitlines())
    zenoh = tmp_path / "z.json5"
    zenoh.write_bytes(encode('{ mode: "client" } // größer'))
    assert '"client"' in zenoh_link._configuration((), (), zenoh, zenoh_link.Role.PEER).get_json("mode")


@pytest.mark.parametrize("words", [
    ["check"], ["sitl", "--scenario"], ["replay"], ["log", "verdict"], ["log", "info"], ["compare", "x"],
])  # fmt: skip
def test_a_pipe_where_a_file_is_needed_is_refused_and_not_waited_for(tmp_path, words):
    os.mkfifo(tmp_path / "pipe")
    result = CliRunner().invoke(main, [*words, str(tmp_path / "pipe")])
    assert result.exit_code == 2
    assert re.search("pipe|neither a file|cannot open", result.output)


def test_files_are_utf_8_whatever_the_locale_is(tmp_path):
    """In the C locale, texts and pages are written as UTF-8; bytes that are not UTF-8 are shown escaped."""
    (tmp_path / "ä.toml").write_text("# größer\n", encoding="utf-8")
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PATH": os.environ["PATH"]}
    for verb in ("config", "scenarios"):
        done = subprocess.run(
            [*COMMAND, verb, tmp_path / "ä.toml"], env=locale, capture_output=True, check=True
        )
        assert done.stdout.decode() == "# größer\n"
    page = Page("\udcff", ("", "good"), "", (), ())
    assert "\\udcff" in write(tmp_path / "page.html", page).read_text(encoding="utf-8")


def test_a_full_disk_names_the_file_and_leaves_no_part_of_it(tmp_path):
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    place = tmp_path / "table.csv"
    with pytest.raises(OSError, match=r"No space left on device: .*table\.csv"), new_file(place, force=False):
        raise full
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ReportError, match="/dev/full: cannot be written: No space left on device"):
        write(Path("/dev/full"), Page("", ("", "good"), "", (), ()))


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ("a = 1".encode("utf-16-le"), "UTF-16"),
        ("# größer".encode("latin-1"), "encoding utf-8"),
        (codecs.BOM_UTF16_LE + b"a", "encoding utf-16"),
        (b"[" * 100_000, "not TOML"),
        (b"a = " + b"9" * 5000, "not TOML"),
    ],
)
def test_what_is_no_text_names_the_encoding(data, said):
    with pytest.raises(ConfigError, match=said):
        parse_toml(data)


@pytest.mark.parametrize(
    "url",
    ["udpin:[::1]:14550", "udpin:::1:14550", "tcp:[::1]:5760", "udpout:[fe80::1%eth0]:1", "udpin://[::]:1"],
)
def test_ipv6_is_refused_by_its_name(url):
    for parse in (parse_url, parse_peer):
        with pytest.raises(ValueError, match=re.escape("an IPv4 address (not IPv6)")):
            parse(url)
