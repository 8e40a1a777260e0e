"""Tests campaigns: rows equal those of single runs, also if workers fail; users' filters; tier limits."""

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from sim.campaign.rows import read_rows, row_of
from sim.campaign.run import plan
from sim.campaign.summary import count
from sim.runners.landing import land
from tests.benchmarks.tiers import LIMITS, Tier, misses
from tests.integration.runs import WALL_MAX_S, Background, called, flightstack
from tests.processes.bounded import gone, wait_for

RUNS = 6
# shorter versions of scenarios for these tests
SHORT = ("stop_and_go", "--runs", RUNS, "--seed", 40, "--no-report")


def campaign(*arguments, check=True):
    done = flightstack("campaign", *arguments)
    if check:
        assert done.code == 0, done.err
    return done


def untimed(folder):
    return [row.untimed() for row in read_rows(folder / "rows.csv")]


shared = pytest.mark.xdist_group("campaign")  # one worker runs this group, so the campaign is flown once


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Fly an undisturbed campaign; return its folder and its result."""
    folder = tmp_path_factory.mktemp("whole")
    done = campaign(*SHORT[:-1], "--workers", 2, "--out", folder, "--json")
    return folder, done


@shared
def test_complete(whole):
    folder, done = whole
    told = done.json
    assert told == json.loads((folder / "summary.json").read_text())
    assert (
        told["runs"]
        == RUNS
        == sum(told[key] for key in ("landed", "declared_aborts", "undeclared_misses", "crashes"))
    )
    assert [row.seed for row in untimed(folder)] == list(range(40, 40 + RUNS))
    assert told["realtime_factor"] > 0.0
    page = (folder / "campaign.html").read_text()
    assert page.count('class="figure"') == 6
    assert told["worst"][0]["command"] in page
    assert re.search(r"@@[A-Z]+@@", page) is None


@shared
def test_the_command_of_a_seed_repeats_it(whole, tmp_path):
    folder, done = whole
    command = done.json["worst"][0]["command"].split()
    assert command[0] == "flightstack"
    told = flightstack(*command[1:], "--json", "--no-report", "--out", tmp_path).json
    row = next(r for r in untimed(folder) if r.seed == told["seed"])
    for key in ("outcome", "reason", "violation", "h_min_m", "h_min_outside_pad_m", "touchdown_error_m"):
        assert told[key] == getattr(row, key), key


def begun(folder, *arguments):
    """Start a campaign in the background; return the process after the second landing."""
    running, path = Background("campaign", *arguments, "--out", folder), folder / "rows.csv"

    def some():
        assert running.process.poll() is None, running.lines
        return path.exists() and len(read_rows(path)) >= 2

    wait_for(some, "two rows", WALL_MAX_S)
    return running


@shared
def test_a_killed_worker_costs_no_row(whole, tmp_path):
    running = begun(tmp_path, *SHORT, "--workers", 2)
    os.kill(running.pids()[0], signal.SIGKILL)
    assert running.end() == 0, running.lines
    assert untimed(tmp_path) == untimed(whole[0])


@shared
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_campaign_goes_on(whole, tmp_path, number):
    longer = (*SHORT[:2], 2 * RUNS, *SHORT[3:])  # more landings than can end before the signal
    running = begun(tmp_path, *longer, "--workers", 2)
    workers = running.pids()
    # otherwise the first campaign could end before the second campaign starts
    running.process.send_signal(signal.SIGSTOP)
    second = called("campaign", *longer, "--out", tmp_path)
    running.process.send_signal(number)
    running.process.send_signal(signal.SIGCONT)
    code = running.end()
    assert second.code == 2
    assert "another campaign runs there" in second.err
    if number != signal.SIGKILL:
        assert code == 1, running.lines
        assert running.said("landings are missing")
        assert not running.said("Traceback")
    for pid in workers:
        assert gone(pid)
    kept = untimed(tmp_path)
    assert 2 <= len(kept) < 2 * RUNS
    if number == signal.SIGINT:
        assert all(row.seed >= 40 + RUNS or row in untimed(whole[0]) for row in kept)
        return  # another test checks that a campaign continues
    campaign(*longer, "--workers", 2, "--out", tmp_path)
    rows = untimed(tmp_path)
    assert [row.seed for row in rows] == list(range(40, 40 + 2 * RUNS))
    assert rows[:RUNS] == untimed(whole[0])
    assert all(row in rows for row in kept)


@shared
def test_more_runs_extend_it_and_fewer_are_refused(whole, tmp_path):
    folder = shutil.copytree(whole[0], tmp_path / "more")
    campaign(*SHORT[:2], RUNS + 1, *SHORT[3:], "--workers", 1, "--out", folder)
    assert untimed(folder)[:RUNS] == untimed(whole[0])
    assert [row.seed for row in untimed(folder)] == list(range(40, 41 + RUNS))
    done = called("campaign", "stop_and_go", "--runs", 2, "--seed", 40, "--out", folder)
    assert done.code == 2
    assert f"at least {RUNS + 1} runs" in done.err


@shared
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("stop_and_go", "--seed", 41), "another first seed"),
        (("stop_and_go", "--seed", 40, "--filter", "paper"), "another filter"),
        (("straight", "--seed", 40), "another scenario"),
    ],
)
def test_a_changed_campaign_is_refused(whole, arguments, said):
    done = called("campaign", *arguments, "--runs", RUNS, "--out", whole[0])
    assert done.code == 2
    assert said in done.err
    assert "--out" in done.err


@shared
def test_a_cluster_that_loses_a_worker_ends_complete_and_equal(whole, tmp_path):
    scheduler = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0",
         "--no-dashboard", "--scheduler-file", str(tmp_path / "scheduler.json")],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    started = [scheduler]
    try:
        file, told = tmp_path / "scheduler.json", {}

        def listens():
            with contextlib.suppress(FileNotFoundError, json.JSONDecodeError):  # no complete file yet
                told.update(json.loads(file.read_text()))
            return told

        wait_for(listens, "the scheduler's address")
        address = told["address"]
        for number in range(2):
            started.append(
                subprocess.Popen(
                    [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1",
                     "--no-dashboard", "--no-nanny", "--host", "127.0.0.1",
                     "--local-directory", str(tmp_path / f"worker{number}")],
                    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                )
            )  # fmt: skip
        running = begun(tmp_path / "out", *SHORT, "--cluster", address)
        started[1].kill()
        assert running.end() == 0, running.lines
        assert untimed(tmp_path / "out") == untimed(whole[0])
    finally:
        for process in reversed(started):
            process.kill()
            process.wait(30.0)


ROOT = Path(__file__).parents[3]


@pytest.fixture
def elsewhere(tmp_path):
    """Return a working folder that contains the filter of the examples under another module name."""
    shutil.copy(ROOT / "examples" / "own_boundary.py", tmp_path / "mine.py")
    return tmp_path


def test_a_filter_named_in_the_scenario_flies_and_its_code_must_stay_the_same(elsewhere):
    scenario = elsewhere / "scenario.toml"
    scenario.write_text('base = "paper_moving_1"\nname = "named"\n[onboard]\nfilter = "mine:ConeFilter"\n')
    words = ("campaign", scenario, "--runs", 1, "--workers", 1, "--no-report", "--json", "--out", "named")
    done = flightstack(*words, cwd=elsewhere)
    assert done.code == 0, done.err
    assert "mine:ConeFilter flies a boundary of its own" in done.json["judged_apart"]
    assert [row.outcome for row in read_rows(elsewhere / "named" / "rows.csv")] == ["landed"]
    (elsewhere / "mine.py").write_text((elsewhere / "mine.py").read_text() + "# other code\n")
    other = flightstack(*words, cwd=elsewhere)
    assert other.code != 0
    assert "another filter's code" in other.err


@pytest.mark.parametrize("verb", [("sitl", "--scenario", "lab"), ("campaign", "lab"), ("check", "lab")])
def test_a_filter_that_there_is_not_is_refused_with_what_is_allowed(verb):
    done = called(*verb, "--filter", "best")
    assert done.code == 2
    assert "filter: found 'best', allowed: paper, robust, or MODULE:NAME" in done.err
    done = called(*verb, "--filter", "examples.own_boundary:Kone")
    assert done.code == 2
    assert "has no Kone\n" in done.err


TIER_RUNS = 30  # landings of each tier; docs/reference/results.md has 10,000
PAPER_RUNS = 10  # landings with the paper's filter; enough for a median


def rows_of(tier, runs, filter_name):
    """Fly a tier's campaign with the seeds 0 to ``runs`` - 1 in this process; return its rows."""
    scenario = plan(tier.value, runs, 0, filter_name).scenario
    return [row_of(land(scenario, seed)) for seed in range(runs)]


@pytest.mark.parametrize("tier", list(Tier), ids=lambda tier: tier.value)
def test_the_robust_filter_meets_the_limits(tier):
    compared = LIMITS[tier].slower_max is not None
    rows = rows_of(tier, TIER_RUNS, "robust")
    assert misses(tier, rows, rows_of(tier, PAPER_RUNS, "paper") if compared else None) == []
    found = count(rows)
    assert found["crashes"] == found["violations"] == 0
