"""Which room may import which: the core knows none of the others, the wires and logs never the simulator."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
ROOMS = ("flightstack", "bridge", "sim", "logs")
# the launcher of `sitl` puts rooms together; nothing else of the onboard process knows the simulator
KNOW_ALL = ("launch.py", "launch_vehicles.py")


def imported(path):
    """Modules that a file imports anywhere, also within functions."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return {name for name in found if name.split(".")[0] in ROOMS}


def rooms_of(path):
    return {name.split(".")[0] for name in imported(path)}


@pytest.mark.parametrize("room", ["bridge", "logs"])
def test_wires_and_logs_never_import_the_simulator(room):
    files = sorted((ROOT / room).rglob("*.py"))
    assert files
    assert [f for f in files if "sim" in rooms_of(f)] == []


def test_of_the_onboard_process_only_the_launcher_knows_the_simulator():
    files = sorted((ROOT / "flightstack").rglob("*.py"))
    know = [f for f in files if "sim" in rooms_of(f)]
    assert know
    assert [f.name for f in know if f.name not in KNOW_ALL] == []


def test_the_controller_and_all_it_uses_know_no_other_room():
    todo, seen = ["flightstack.core.controller"], set()
    while todo:
        path = ROOT / (todo.pop().replace(".", "/") + ".py")
        if path in seen or not path.exists():
            continue
        seen.add(path)
        assert rooms_of(path) <= {"flightstack"}, path
        todo += imported(path)
    assert len(seen) > 10
