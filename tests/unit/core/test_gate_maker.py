"""The gate is the only maker of set-points, and nobody changes what it made."""

import ast
import copy
from pathlib import Path

import pytest

from flightstack.core.safety.gate import ApprovedSetpoint, Gate
from flightstack.core.types import ZERO

GATE = Gate(0.7, (0.2, 0.3, 0.5), 3.0, 0.01)
_, CHECKED = GATE.check(
    (0.1, 0.0, -0.1), (0.1, 0.0, -0.1), 0.0,
    own_fresh=True, target_fresh=True, altitude_m=1.0, barrier_check=None,
)  # fmt: skip


@pytest.mark.parametrize("key", [object(), None, 0, True, "key", ApprovedSetpoint, GATE])
def test_nobody_else_makes_an_approved_set_point(key):
    with pytest.raises(TypeError, match="gate only"):
        ApprovedSetpoint(key, ZERO, 0.0)


@pytest.mark.parametrize("approved", [CHECKED, GATE.stop(0.3, own_fresh=True)])
def test_an_approved_set_point_is_not_changed(approved):
    before = (approved.velocity_enu_m_s, approved.yaw_rad)
    for name, value in (("velocity_enu_m_s", (9.0, 0.0, 0.0)), ("yaw_rad", 1.0), ("other", 1)):
        with pytest.raises(AttributeError, match=f"not changed: {name}"):
            setattr(approved, name, value)
        with pytest.raises(AttributeError, match=f"not changed: {name}"):
            delattr(approved, name)
    with pytest.raises(AttributeError):
        copy.copy(approved)
    assert (approved.velocity_enu_m_s, approved.yaw_rad) == before


def test_no_other_source_makes_or_changes_an_approved_set_point():
    """Only the gate's file calls the maker or names its key; nobody writes into one."""
    root = Path(__file__).parents[3]
    files = [f for room in ("flightstack", "bridge", "sim", "logs") for f in (root / room).rglob("*.py")]
    assert len(files) > 50
    found = []
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            name = getattr(node, "attr", getattr(node, "id", None))
            if isinstance(node, ast.ImportFrom):
                if node.module == "flightstack.core.safety.gate" and {a.name for a in node.names} & {
                    "_KEY",
                    "*",
                }:
                    found.append((file.name, "imports the key"))
            elif isinstance(node, ast.Call) and "ApprovedSetpoint" in ast.unparse(node.func):
                found.append((file.name, "makes one"))
            elif isinstance(node, ast.Name | ast.Attribute) and name == "_KEY":
                found.append((file.name, "names the key"))
            elif isinstance(node, ast.Assign | ast.AugAssign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                if any("setpoint.velocity_enu_m_s" in ast.unparse(t) for t in targets):
                    found.append((file.name, "writes into one"))
    assert {name for name, _ in found} == {"gate.py"}
    assert found.count(("gate.py", "makes one")) == 2  # a checked velocity, and the stop
