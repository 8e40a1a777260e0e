"""Tests that the controller still makes the decisions recorded in the golden logs.

After an intended change of the decisions, ``python -m tests.golden update`` shows the differences and records
new logs.
"""

import pytest

from logs.replay.replay import replay
from tests.golden.__main__ import main, phases
from tests.golden.flights import FLIGHTS, path_of

pytestmark = pytest.mark.slow

HELP = "; if this is meant: python -m tests.golden update"


@pytest.mark.parametrize("name", FLIGHTS)
def test_a_golden_log_is_decided_as_it_was(name):
    result = replay(path_of(name))
    wire = result.wire.first if result.wire is not None else []
    assert result.equal, "\n".join(map(str, result.outputs.first + result.states.first + wire)) + HELP
    assert set(FLIGHTS[name].phases) <= phases(result)
    assert (result.wire is not None) == FLIGHTS[name].wire
    assert result.compared > 200


def test_the_command_checks_and_refuses_unknown_names(capsys):
    assert main(["check", "contact"]) == 0
    assert "contact: " in capsys.readouterr().out
    assert main(["check", "nothing"]) == 2
    assert main(["burn"]) == 2
