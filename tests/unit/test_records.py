"""Records: memory shared between views, compiled and plain code."""

from typing import Annotated

import numpy as np
import pytest

from sim.jit import jitted
from sim.records import F64, Record, cell, layout, new


class Inner(Record):
    values: Annotated[F64, 2]
    on: bool


class Outer(Record):
    count: int
    inner: Inner
    x: float


def test_layout_has_no_gaps():
    assert layout(Outer).itemsize == 8 * 5
    assert layout(Outer).names == ("count", "inner", "x")


def test_nested_records_arrays_and_cells_are_views():
    outer = new(Outer)
    inner, values, view = outer.inner, outer.inner.values, cell(outer.inner)
    values[1] = 2.5
    inner.on = True
    assert view["values"].tolist() == [[0.0, 2.5]]
    view[0] = ((7.0, 8.0), False)
    assert (outer.inner.values.tolist(), bool(outer.inner.on)) == ([7.0, 8.0], False)


def test_values_in_the_order_of_the_fields():
    outer = new(Outer, (3, ((1.0, 2.0), True), 4.0))
    assert (int(outer.count), outer.inner.values.tolist(), float(outer.x)) == (3, [1.0, 2.0], 4.0)


@jitted
def count(outer):
    outer[0].count += 1
    outer[0].inner.values[0] = outer[0].count


def test_compiled_code_changes_the_same_memory():
    outer = new(Outer)
    for _ in range(3):
        count(cell(outer))
    assert (int(outer.count), float(outer.inner.values[0])) == (3, 3.0)


class Clash(Record):
    mean: float


class Text(Record):
    name: str


def test_names_and_kinds_that_cannot_be_fields_are_refused():
    with pytest.raises(AttributeError, match="mean"):
        layout(Clash)
    with pytest.raises(TypeError, match="str"):
        layout(Text)
    assert np.dtype(layout(Inner)).names == ("values", "on")
