"""Tests that a name selects exactly one filter, inside or outside the package."""

import sys

import pytest

from flightstack.common.strict_toml import ConfigError
from flightstack.config import load
from flightstack.core.parameters.filters import ALLOWED, FILTERS, look_here
from flightstack.core.strategies.strategy import (
    ignored,
    own_boundary,
    packaged_strategy_of,
    strategy_class,
    strategy_of,
)
from flightstack.verify.certificate import checks, problems
from tests.integration.runs import called
from tests.point_mass import World
from tests.unit.core.core_helpers import config

CONE = "examples.own_boundary:ConeFilter"
# a module outside the package that prints when it is imported; its filter Bare lacks most methods
OUTSIDE = """
from flightstack.common.strict_toml import ConfigError
from flightstack.core.strategies.packaged.paper import PaperFilter
from flightstack.core.strategies.strategy import Filter
print("imported")
class Bare(Filter):
    State = 3
class Slower(PaperFilter):
    def approach_m_s(self, at, over_pad):
        return (0.0, 0.0, -0.5)
class Picky(PaperFilter):
    certificate = "outside:nothing"
    @staticmethod
    def check_config(config):
        raise ConfigError("barrier.omega_1_s: found 0.7, a prime number is needed")
"""


@pytest.fixture
def outside(tmp_path, monkeypatch):
    (tmp_path / "outside.py").write_text(OUTSIDE)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    sys.modules.pop("outside", None)


@pytest.mark.parametrize("name", [*FILTERS, CONE])
def test_a_filter_is_found_by_its_name_and_names_its_own_checks(name):
    settings = config(name)
    assert isinstance(strategy_of(settings), strategy_class(name))
    assert checks(settings)
    assert problems(settings) == []


@pytest.mark.parametrize("name", ["best", "", "Paper", "a b:C", "a:", ":b", "a.:b", "a:b:c", "../a:b"])
def test_what_is_no_name_is_refused_with_what_is_allowed(name):
    with pytest.raises(ConfigError, match=f"filter: found .*, allowed: {ALLOWED}") as error:
        config(name)
    assert repr(name) in str(error.value)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("no_such_module:X", "module no_such_module cannot be imported"),
        ("examples.own_boundary:Kone", "module examples.own_boundary .* has no Kone"),
        ("examples.own_boundary:Cone", "no subclass of flightstack.Filter"),
        ("examples.own_boundary:certificate", "no subclass of flightstack.Filter"),
    ],
)
def test_what_is_no_filter_is_refused_where_it_would_fly(name, why):
    settings = config(name)  # the form of the name is valid; the module is imported only later
    for use in (strategy_of, checks, problems):
        with pytest.raises(ConfigError, match=why):
            use(settings)


def test_reading_a_configuration_or_a_log_imports_nothing_from_outside(outside, capsys):
    settings = config("outside:Picky")
    assert packaged_strategy_of(settings) is None
    with pytest.raises(ConfigError, match="cannot be imported"):  # as for a log without its filter
        strategy_of(settings)
    assert "outside" not in sys.modules
    assert capsys.readouterr().out == ""
    assert isinstance(packaged_strategy_of(config("paper")), strategy_class("paper"))


def test_a_filter_in_the_working_folder_is_found_from_the_users_own_file(outside, capsys):
    file = outside / "mine.toml"
    file.write_text('filter = "outside:Picky"\n[barrier]\nalpha_1_m = 1.0\nbeta_m = 1.5\n')
    settings = load(file)
    for use in (strategy_of, problems):
        with pytest.raises(ConfigError, match="a prime number is needed"):
            use(settings)
    assert capsys.readouterr().out == "imported\n"
    with pytest.raises(ConfigError, match="outside:Bare: State is 3; a dataclass is needed"):
        strategy_class("outside:Bare")


def test_a_subclass_does_not_inherit_the_proof_of_the_class_that_it_extends(outside):
    look_here("outside:Slower")
    settings = config("outside:Slower")
    (found,) = checks(settings)
    assert (found.name, found.proven) == ("certificate", False)
    assert problems(settings) == []  # a filter without a proof may fly
    done = called("check", "paper_static_1", "--filter", "outside:Slower", "--json")
    assert done.code == 1
    assert "outside:Slower has none" in done.json["checks"][0]["worst"]


def test_a_boundary_of_its_own_is_named():
    assert "flies a boundary of its own" in own_boundary(CONE)
    assert own_boundary("robust") == own_boundary("examples.own_filter:Smooth") == ""


def test_a_boundary_that_cannot_fly_is_refused_before_a_flight(outside):
    (outside / "edges.py").write_text(
        "import flightstack as fs\n"
        "class Flat:\n"
        "    def h(self, e_m): return e_m[2]\n"
        "    def evaluate(self, e_m, v): return self.h(e_m), (0.0, 0.0, 1.0), -v[2]\n"
        "class Whole(Flat):\n"
        "    def linearisation_bound_m(self, e_m, moved_m): return 0.0\n"
        "class Mine(fs.Filter):\n"
        "    def barrier(self, at): return Flat()\n"
        "class Better(fs.Filter):\n"
        "    def barrier(self, at): return Whole()\n"
    )
    look_here("edges:Mine")
    for use in (strategy_of, checks, problems):
        with pytest.raises(ConfigError, match=r"edges\.py:Mine: its boundary Flat .*linearisation_bound_m"):
            use(config("edges:Mine"))
    assert isinstance(strategy_of(config("edges:Better")), strategy_class("edges:Better"))


OTHERS = {
    "barrier.omega_1_s": {"alpha_1_m": 1.0, "beta_m": 1.5, "omega_1_s": 0.4},
    "limits.slew_max_m_s2": {"slew_max_m_s2": [3.0, 3.0, 3.0]},
    "touchdown.descent_m_s": {"descent_m_s": 0.3},
}


@pytest.mark.parametrize("key", strategy_class("robust").ignores)
def test_a_key_that_the_filter_does_not_read_is_named_and_changes_nothing(key):
    table = key.partition(".")[0]
    usual = {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5}} if table == "barrier" else {table: {}}
    changed, plain = (config("robust", **given) for given in ({table: OTHERS[key]}, usual))
    (text,) = ignored(changed)
    assert text.startswith(f"robust ignores {key}; it reads robust.")
    assert ignored(plain) == []
    wanted = [
        [(out.phase, out.wanted) for out in World(each, solid_pad=True).run(20.0).outputs]
        for each in (changed, plain)
    ]
    assert wanted[0] == wanted[1]
