"""Text that others wrote is shown as it is written and never obeyed: terminals, pages, viewers, files."""

import io
import re
from pathlib import Path

import pytest
from click.testing import CliRunner
from rich.table import Table
from rich.text import Text

from flightstack.cli.main import main
from flightstack.common.terminal import Terminal
from flightstack.common.text import one_line, plain
from logs.reader.flight import load_flight
from logs.recorder.mcap_file import McapFile
from logs.report.report import write_report
from logs.schema import schemas
from logs.schema.events import Severity, pack_log
from logs.verdict.verdict import judged
from tests.unit.logs.helpers import CHANNELS, EPOCH_NS, payloads

EVIL = "[bold]x[/y] :smile: \x1b[31m\x07\x9b2J\r \u202e <b onload=1>&amp; %{y} | `rm` **"
CONTROLS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e]")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a\x1b[2Jb", r"a\x1b[2Jb"),
        ("a\rb\x00\x7f\x85", r"a\rb\x00\x7f\x85"),
        ("\u202ecba\u2066\u200f", r"\u202ecba\u2066\u200f"),
        ("\udcff.mcap", r"\udcff.mcap"),  # a byte of a path that is not UTF-8
        ("a\u2028b\tc\nd", "a\\u2028b\tc\nd"),
        ("Größe ≤ 5 µm, 東京", "Größe ≤ 5 µm, 東京"),
        (Path("[test]/a"), "[test]/a"),
    ],
)
def test_control_characters_can_be_read(text, shown):
    assert plain(text) == shown
    assert one_line(text) == shown.replace("\n", "\\n").replace("\t", "\\t")


def test_a_terminal_shows_every_text_as_it_is_written(monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    out = io.StringIO()
    console = Terminal()
    console.file = out
    table = Table("[red]head[/]", title=EVIL)
    table.add_row(EVIL, Text(EVIL))
    for each in (EVIL, Text(EVIL), table):
        console.print(each, soft_wrap=True)
    assert out.getvalue().count("[bold]x[/y] :smile: \\x1b[31m\\x9b2J") == 5
    assert "[red]head[/]" in out.getvalue()
    assert not CONTROLS.search(out.getvalue())


def evil_log(path, metadata):
    file = McapFile(path)
    for name, values in metadata.items():
        file.metadata(name, values)
    channels = {n: file.channel(*CHANNELS[n]) for n in CHANNELS}
    file.write(file.channel(f"/evil\x1b[31m{EVIL}", schemas.LOG), EPOCH_NS, 0, 0, b"")
    for tick in range(40):
        now_ns = EPOCH_NS + tick * 10_000_000
        for number, payload in payloads(tick, now_ns):
            file.write(channels[number], now_ns, now_ns, tick, payload)
    file.write(channels[5], now_ns, 0, 0, pack_log(now_ns, Severity.ERROR, "<i>", EVIL + "<script>alert(1)"))
    file.close()
    return path


def test_a_log_of_others_is_shown_and_not_obeyed(tmp_path):
    run = {"scenario": EVIL, "filter": "[/x]"}
    log = evil_log(tmp_path / "[red]a.mcap", {EVIL: {"k\n": EVIL}, "run": run})
    result = CliRunner().invoke(main, ["log", "info", str(log)])
    assert result.exit_code == 0
    assert not CONTROLS.search(result.output)
    assert "[red]a.mcap" in result.output
    result = CliRunner().invoke(main, ["log", "verdict", str(log)])
    assert "[/x]" in result.output
    assert not CONTROLS.search(result.output)
    page = write_report(*judged(log), tmp_path / "page.html")[""].read_text()
    for text in ("<script>alert", "<b onload", "<i>"):
        assert text not in page.replace("<i></i>", "")
    shown = load_flight(log)
    assert shown.events[-1].text.endswith("<script>alert(1)")  # read as it was written


@pytest.mark.parametrize("name", ["../../evil", "a/b", "<b>", "a b", "x" * 65])
def test_names_of_a_log_become_no_paths(tmp_path, name):
    log = evil_log(tmp_path / "a.mcap", {"fleet": {"members": f"{name},cf2"}})
    for verb in (["report"], ["view", "--layouts", str(tmp_path / "l")], ["log", "verdict"]):
        result = CliRunner().invoke(main, [*verb, str(log)])
        assert result.exit_code == 2
        assert repr(name)[1:-1] in result.output
    assert CliRunner().invoke(main, ["log", "info", str(log)]).exit_code == 0
    other = evil_log(tmp_path / "b.mcap", {"onboard": {"namespace": '"><x/>'}})
    assert CliRunner().invoke(main, ["view", "--layouts", str(tmp_path / "l"), str(other)]).exit_code == 2
