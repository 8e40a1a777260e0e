"""Tests landings, logs and tables of the public interface, ``import flightstack as fs``."""

import math
import subprocess
import sys
from functools import partial

import numpy as np
import pytest

import flightstack as fs
from flightstack.common.strict_toml import ConfigError

NO_SEEDS = (-1, 1.5, math.nan, math.inf, "3", None, True, np.float64(2.0))


def test_the_import_is_light_and_names_what_is_missing():
    code = (
        "import sys, flightstack as fs\n"
        "assert not {'numpy', 'sim', 'logs'} & set(sys.modules)\n"
        "assert 'land' in dir(fs)\n"
        "sys.modules['mujoco'] = None\n"
        "try: fs.land\n"
        "except ModuleNotFoundError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "flightstack.land needs mujoco" in done.stdout
    assert "-m pip install 'crazyflie-flightstack[sim]'" in done.stdout
    with pytest.raises(AttributeError, match="it has At, Campaign"):
        _ = fs.nothing


def test_a_landing_equals_the_log_of_the_same_seed(flown):
    logged, landing = fs.read_log(flown("lab", 7).log), fs.land("lab", seed=7)
    assert landing.verdict == logged.verdict
    about = f"landed, no violation, lowest h {landing.verdict.h_min_m:.3f} m, touchdown error "
    about += f"{landing.verdict.touchdown_error_m:.3f} m)"
    assert repr(landing) == f"Landing(lab, seed 7: {about}"
    assert repr(logged) == f"Landing({logged.flight.path}: {about}"
    for part in ("steps", "truth"):
        here, there = getattr(landing.flight, part), getattr(logged.flight, part)
        for name, values in vars(there).items():
            if isinstance(values, np.ndarray):
                assert np.array_equal(getattr(here, name), values, equal_nan=values.dtype.kind == "f"), name
    assert landing.flight.barrier == logged.flight.barrier
    assert landing.flight.pad_radius_m == logged.flight.pad_radius_m
    assert {trace.type for trace in landing.plot().data} >= {"surface", "scatter3d"}


def test_a_table_has_a_column_for_each_axis():
    steps = fs.land("lab", seed=7).log
    table = fs.frame(steps)
    assert len(table) == len(steps.t_s)
    assert table["command_enu_m_s_z"].to_numpy().tolist() == steps.command_enu_m_s[:, 2].tolist()
    assert np.array_equal(table["d_m"].to_numpy(), steps.d_m, equal_nan=True)
    assert set(table["phase"]) >= {"APPROACH", "LAND", "LANDED"}
    assert set(table["gate"]) >= {"APPROVED"}
    with pytest.raises(TypeError, match="frame: found int"):
        fs.frame(3)


def test_without_a_library_for_tables_the_extra_is_named(monkeypatch):
    monkeypatch.setattr("flightstack.api.frames.find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match=r"pandas or polars.*-m pip install '.*\[export\]'"):
        fs.frame({"h_m": np.zeros((2, 3))})


def test_changed_keys_are_flown_and_judged():
    made = fs.scenario("lab", {"wind.mean_m_s": np.float64(0.5), "barrier.alpha_1_m": 1.2}, filter="paper")
    assert (made.wind.mean_m_s, made.onboard.filter) == (0.5, "paper")
    assert made.judge is None
    assert made.judged_by.alpha_1_m == made.onboard.barrier.alpha_1_m == 1.2
    apart = fs.scenario("lab", {"barrier.alpha_1_m": 1.2, "judge.alpha_1_m": 1.1, "judge.beta_m": 1.5})
    assert apart.judged_by.alpha_1_m == 1.1
    assert fs.scenario(made) is made


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"wind.mean": 1.0}, r"wind.mean: no unit; the key is wind.mean_m_s"),
        ({"wind.mean_m_s": "much"}, "allowed: 0 to 10"),
        (
            {"nothing": 1},
            r"nothing: unknown key; allowed: (?!.*\b(others|member|base)\b).*, wind$",
        ),
        ({3: 1}, "found the key 3"),
    ],
)
def test_wrong_keys_are_named(changes, text):
    with pytest.raises(ConfigError, match=text):
        fs.land("lab", changes=changes)


def local():
    class Slower(fs.Filter):
        def filter(self, nominal, at):
            return 0.5 * nominal

    return Slower


def test_a_campaign_is_a_table_and_equals_single_landings():
    result = fs.campaign("lab", seeds=[7, 1], filter=local(), workers=2)
    assert result.table["seed"].tolist() == [1, 7]
    for row in result.rows:
        verdict = fs.land("lab", row.seed, filter=local()).verdict
        assert (row.outcome, row.violation, row.h_min_m) == (
            verdict.outcome,
            verdict.violation,
            verdict.h_min_m,
        )
    assert len(result) == 2
    assert repr(result).startswith("Campaign(lab: ")
    assert len(repr(result)) < 100


SCRIPT = """
import threading
import flightstack as fs
ends = threading.Event()
threading.Thread(target=ends.wait).start()
class Slower(fs.Filter):
    def filter(self, nominal, at):
        return 0.5 * nominal
print(fs.campaign("lab", seeds=[1], filter=Slower).rows[0].violation)
ends.set()
"""


def test_a_script_with_threads_needs_no_guard(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, tmp_path / "script.py"], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == ["True"]


def test_a_sweep_judges_by_the_barrier_that_flew():
    grid = {"barrier.alpha_1_m": [1.0, 1.3], "wind.mean_m_s": [0]}
    sweep = fs.sweep("lab", grid, seeds=[3], filter="paper", workers=1)
    assert sweep.table["barrier.alpha_1_m"].tolist() == [1.0, 1.3]
    for (alpha_1_m, _), campaign in sweep.points:
        (member,) = campaign.scenario.members
        assert member.judged_by.alpha_1_m == member.onboard.barrier.alpha_1_m == alpha_1_m
    assert [point["landed"] for point in sweep.rates()] == [1.0, 1.0]
    assert list(fs.frame(sweep.rates())["landed"]) == [1.0, 1.0]
    assert len(sweep.plot().data) == 2


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (lambda: fs.sweep("lab", {}), "a key and values"),
        (lambda: fs.sweep("lab", {"wind.mean": [1]}), "the key is wind.mean_m_s"),
        (lambda: fs.campaign("lab", seeds=[]), "whole numbers"),
        (lambda: fs.campaign("lab", seeds=[2, 1, 2]), "seeds: found 2 more than once"),
        *((partial(fs.land, "lab", bad), "seed: found .*a whole number from 0") for bad in NO_SEEDS),
        *((partial(fs.campaign, "lab", [bad]), "seeds: found .*a whole number") for bad in NO_SEEDS),
        *((partial(fs.campaign, "lab", bad), "seeds: found .*whole numbers from") for bad in (5, None)),
        *(
            (partial(fs.campaign, "lab", [1], workers=bad), "workers: found .*from 1 on")
            for bad in (0, -1, 1.5, math.nan, "2", True)
        ),
        *(
            (partial(fs.sweep, "lab", bad, [1]), "sweep: found")
            for bad in (None, {"wind.mean_m_s": 1.0}, {"wind.mean_m_s": "12"}, {"wind.mean_m_s": iter(())})
        ),
        (lambda: fs.campaign("nothing"), "neither a file nor one of"),
    ],
)
def test_bad_input_is_named(wrong, text):
    with pytest.raises(ConfigError, match=text):
        wrong()
