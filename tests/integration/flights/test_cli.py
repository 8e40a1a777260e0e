"""The command line: wrong input, help, listing."""

import subprocess
import sys

import pytest

from flightstack.cli.main import GROUPS, VERBS
from tests.integration.runs import called, flightstack


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["sitl"], ["--scenario"]),
        (["sitl", "--scenario", "nowhere"], ["nowhere", "paper_moving_1"]),
        (["sitl", "--scenario", "paper_moving_1", "--seed", "-1"], ["--seed", "-1"]),
        (["sitl", "--scenario", "paper_moving_1", "--filter", "best"], ["best", "paper", "robust"]),
        (["sitl", "--scenario", "paper_moving_1", "--duration", "0"], ["--duration"]),
        (["vehicle", "--scenario", "paper_moving_1", "--url", "serial:/dev/x"], ["serial:", "udpin:HOST"]),
        (["target", "--scenario", "paper_moving_1", "--listen", "here"], ["here", "tcp/127.0.0.1:7447"]),
        (["report", "absent.mcap"], ["absent.mcap"]),
        (["fly"], ["fly"]),
    ],
)  # fmt: skip
def test_wrong_input_is_status_2_and_one_clear_line(arguments, words, tmp_path):
    run = flightstack if arguments[0] in ("target", "vehicle") else called
    result = run(*arguments, cwd=tmp_path)
    assert result.code == 2, result.err
    assert "Traceback" not in result.err
    for word in words:
        assert word in result.err
    assert list(tmp_path.iterdir()) == []  # nothing is left behind


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (("omega_1_s = 0.7", "omega_s = 0.7"), "wrong unit"),
        (("gain_1_s = [1.0, 1.0, 1.0]", "gains = [1.0, 1.0, 1.0]"), "unknown key"),
        (("velocity_max_m_s = [0.2, 0.2, 0.5]", "velocity_max_m_s = [0.05, 0.05, 0.05]"), "outruns the box"),
        (("speed_m_s = 0.1\n", "speed_m_s = 0.5\n"), "speed_max_m_s"),
    ],
)  # fmt: skip
def test_a_scenario_that_must_not_fly_is_refused_before_anything_starts(change, word, tmp_path):
    text = flightstack("scenarios", "paper_moving_1").out
    assert change[0] in text
    file = tmp_path / "changed.toml"
    file.write_text(text.replace(*change))
    result = called("sitl", "--scenario", file, "--lockstep", "--json", "--out", tmp_path / "out")
    assert result.code == 2
    assert word in result.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("verb", VERBS)
def test_help_of_each_verb(verb):
    result = flightstack(verb, "--help")
    assert result.code == 0
    assert len(result.out.splitlines()) >= 5


def test_help_lists_every_verb_with_a_line_in_the_group_of_its_folder():
    found, title = {}, ""
    for line in flightstack("--help").out.splitlines():
        if line.endswith(":") and not line.startswith(" "):
            title = line.removesuffix(":")
        elif title in GROUPS and line.strip():
            name, *words = line.split()
            assert words, name
            assert words[-1].endswith("."), name  # whole: neither cut nor continued on another line
            found.setdefault(title, []).append(name)
    assert found == {title: list(verbs) for title, verbs in GROUPS.items()}
    folders = {
        title: {verb.place.partition(".")[0] for verb in verbs.values()} for title, verbs in GROUPS.items()
    }
    assert folders == {"Fly": {"fly"}, "Prove": {"prove"}, "Logs": {"logs"}, "Real things": {"real"}}


def test_a_verb_loads_nothing_of_the_others():
    code = (
        "import sys; from flightstack.cli.main import main; main(['key', '--help'], standalone_mode=False); "
        "print(*{name.partition('.')[0] for name in sys.modules})"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0, check=True
    )
    assert not {"numpy", "rich", "pymavlink", "sim", "logs", "bridge"} & set(done.stdout.split())


def test_scenarios_lists_the_papers_runs():
    out = flightstack("scenarios").out
    for name in ("paper_static_1", "paper_static_2", "paper_moving_1", "paper_moving_2"):
        assert name in out
