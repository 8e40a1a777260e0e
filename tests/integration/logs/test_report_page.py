"""Tests the report of a flight in a real browser."""

import os
import re
import shutil
import subprocess
from collections import Counter
from html.parser import HTMLParser

import pytest

from logs.report.report import write_report
from logs.verdict.verdict import judged
from tests.synthetic_flight import landing, write_log

pytest.importorskip("plotly", reason="the report needs plotly: install the extra [report]")

FIGURES = 12
FLEET_FIGURES = 30  # number of figures: 3 of all three vehicles together, and 9 of each vehicle
SIZE_MAX = 6e6  # maximum size of the page of one to three vehicles, with its plotting library, bytes
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
BROWSER_LIMIT_S = 180


def find_chromium():
    """Return the path in the variable CHROMIUM, or else a browser on the search path; None: no browser."""
    named = os.environ.get("CHROMIUM")
    return named if named else next((path for name in BROWSERS if (path := shutil.which(name))), None)


@pytest.fixture
def browse(tmp_path):
    browser = find_chromium()
    if browser is None:
        pytest.skip(
            f"no Chromium here (looked for {', '.join(BROWSERS)} and $CHROMIUM); the page was not opened"
        )

    def opened(page, place=""):
        """Return the page after all scripts have run, and the lines of the browser's console."""
        result = subprocess.run(
            [
                browser, "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader",
                f"--user-data-dir={tmp_path / 'profile'}", "--no-first-run", "--disable-quic",
                "--disable-sync", "--disable-background-networking", "--disable-component-update",
                "--disable-dev-shm-usage",
                "--enable-logging=stderr", "--virtual-time-budget=30000", "--window-size=1200,1000",
                "--dump-dom", page.as_uri() + place,
            ],
            capture_output=True, text=True, timeout=BROWSER_LIMIT_S, check=True,
        )  # fmt: skip
        return result.stdout, [line for line in result.stderr.splitlines() if ":CONSOLE" in line]

    return opened


def report_of(log, out=None):
    return write_report(*judged(log), out)


class Page(HTMLParser):
    """Collects classes, attributes, links and text of a page, without its scripts."""

    def __init__(self, text):
        super().__init__()
        self.classes, self.body, self.words, self.sources, self.tags = [], {}, [], [], Counter()
        self._script = False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self._script = tag in ("script", "style")
        self.tags[tag] += 1
        self.classes += (values.get("class") or "").split()
        self.sources += [v for k, v in values.items() if k in ("src", "href") and v]
        if tag == "body":
            self.body = values

    def handle_endtag(self, tag):
        self._script = False

    def handle_data(self, data):
        if not self._script:
            self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


def errors(console):
    """Return the lines of the console that report a problem; performance hints are no problem."""
    return [
        line for line in console if re.search(r"error|exception|refused|violat|failed", line, re.IGNORECASE)
    ]


def test_every_figure_is_drawn_without_a_complaint(tmp_path, browse):
    rows = landing()
    rows.steps = [row._replace(wanted_enu_m_s=row.filtered_enu_m_s) for row in rows.steps]
    page = report_of(write_log(tmp_path / "flight.mcap", rows))
    dom, console = browse(page, "#t=2.5")
    assert errors(console) == []
    seen = Page(dom)
    assert seen.body["data-shown"] == "-0.5 5.5"  # every figure over time shows this range, s
    assert seen.body["data-figures"] == str(FIGURES)
    assert seen.body["data-figures-drawn"] == str(FIGURES)
    assert seen.tags["canvas"] >= 1  # the page has a 3-D figure
    assert "no-webgl" not in seen.classes
    assert seen.classes.count("main-svg") >= FIGURES


def test_the_page_of_a_fleet_is_drawn_without_a_complaint(tmp_path, browse, flown):
    page = report_of(flown("fleet_3", 1).log, tmp_path / "report.html")
    dom, console = browse(page)
    assert errors(console) == []
    seen = Page(dom)
    assert seen.body["data-figures"] == seen.body["data-figures-drawn"] == str(FLEET_FIGURES)
    assert seen.tags["canvas"] >= 1  # 3-D figure of the paths in the room
    for words in ("all 3 landed", "cf1–cf3", "cf3 right of way", "time since the first landing began [s]"):
        assert words in seen.text.replace("\N{WORD JOINER}", "")
    assert {"#cf1", "#cf2", "#cf3"} <= set(seen.sources)  # links to the figures of each member
    text = page.read_text(encoding="utf-8")
    assert len(text) < SIZE_MAX
    assert "Who waited for whom" not in text
    assert 'class="columns"' not in text  # one panel has the whole width


def test_a_log_that_is_cut_short_gives_a_page_that_says_so(tmp_path):
    page = Page(report_of(write_log(tmp_path / "flight.mcap", landing(), complete=False)).read_text())
    assert "Mind when reading" in page.text
    assert "cut short or damaged" in page.text


def test_a_figure_without_a_known_position_is_not_drawn(tmp_path):
    rows = landing()
    rows.truth, rows.steps = [], [row._replace(own_valid=False) for row in rows.steps]
    text = report_of(write_log(tmp_path / "flight.mcap", rows)).read_text(encoding="utf-8")
    for key in ("relative", "room", "cf1-altitude", "cf1-plan"):
        assert f'id="figure-{key}"' not in text
        assert "Not drawn" in re.search(rf'<section id="{key}">.*?</section>', text, re.DOTALL)[0]


@pytest.mark.parametrize("kind", ["bare estimate", "no steps"])
def test_poor_logs_give_a_page_that_says_so(tmp_path, browse, kind):
    rows = landing()
    if kind == "bare estimate":
        rows.truth, rows.timing, rows.odometry, rows.events = [], [], [], []
        rows.run.clear()
        expected = "The log does not name the barrier"
    else:
        rows.steps = []
        expected = "no controller steps in this log"
    page = report_of(write_log(tmp_path / "flight.mcap", rows))
    dom, console = browse(page)
    assert errors(console) == []
    seen = Page(dom)
    assert int(seen.body["data-figures"]) >= 3
    assert seen.body["data-figures"] == seen.body["data-figures-drawn"]
    assert "Mind when reading" in seen.text
    assert expected in seen.text


def test_the_page_is_whole_and_names_every_number_with_its_unit(tmp_path):
    rows = landing()
    out = report_of(write_log(tmp_path / "flight.mcap", rows), tmp_path / "there" / "report.html")
    assert out == tmp_path / "there" / "report.html"
    text = out.read_text(encoding="utf-8")
    page = Page(text)
    assert all(source.startswith(("data:", "#")) for source in page.sources)  # the page loads no other files
    assert "@@" not in page.text
    for words in (
        "Landed",
        "seed 7",
        "filter paper",
        "lockstep",
        "touchdown error",
        "cm",
        "m/s",
        "true states",
    ):
        assert words in page.text
    for figure in ("7, 10", "8, 11", "9a, 13a", "9b–d, 13b–d", "12"):
        assert f"paper Fig. {figure}" in page.text
    assert "TOUCHDOWN -> LANDED: made up" in page.text
    assert len(text) < SIZE_MAX


def test_text_from_the_log_stays_text(tmp_path):
    rows = landing()
    evil = "</script><script>document.title='x'</script><b>&"
    rows.run["scenario"] = evil
    rows.events.append((rows.steps[-1].stamp_ns, 40, evil))
    text = report_of(write_log(tmp_path / "flight.mcap", rows)).read_text(encoding="utf-8")
    assert evil not in text
    assert Page(text).text.count(evil) == 4  # the text occurs in title, headline, run table and event
