"""Records: memory shared between views, compiled and plain code."""

from typing import Annotated

import numpy as np
import pytest

from sim.compiled.jit import jitted
from sim.compiled.records import F64, I64, Record, cell, layout, new, reader, scalars, writer


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


class Whole(Record):
    counts: Annotated[I64, 2]
    inner: Inner
    last: int


def test_whole_numbers_beyond_what_doubles_hold():
    whole = new(Whole)
    whole.counts[1] = (1 << 53) + 1
    assert reader(whole)()[1] == (1 << 53) + 1


def test_a_reader_gives_all_numbers_of_now_in_order():
    whole = new(Whole)
    read = reader(whole)
    whole.counts[:], whole.inner.values[:], whole.last = (1, 2), (0.5, -0.0), 7
    assert repr(read()) == "(1, 2, 0.5, -0.0, 0, 7)"
    assert repr(reader(whole.inner)()) == "(0.5, -0.0, 0)"
    assert repr(reader(whole.inner.values)()) == "(0.5, -0.0)"


def test_scalars_read_and_write_the_record():
    whole = new(Whole)
    last, on = scalars(whole, "last")[0], scalars(whole.inner, "on")[0]
    last[0], on[0] = 5, True
    assert (int(whole.last), bool(whole.inner.on)) == (5, True)
    whole.last = 6
    assert last[0] == 6


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


def test_a_writer_sets_all_numbers_in_order():
    whole = new(Whole)
    writer(whole.inner)(0.5, -0.0, 1)
    assert repr(reader(whole)()) == "(0, 0, 0.5, -0.0, 1, 0)"
