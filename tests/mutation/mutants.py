"""Small changes of the sources of the safety core, each of which one of their fast tests should notice.

A mutant is one change of one node of the syntax tree. Strings, type hints and decorators stay.
"""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import CodeType

ROOT = Path(__file__).parents[2]
UNIT = "tests/unit"

TARGETS: dict[str, tuple[str, ...]] = {
    "flightstack.core.safety.barrier": (f"{UNIT}/core/test_barrier.py",),
    "flightstack.core.safety.robust_barrier": (f"{UNIT}/core/test_barrier.py",),
    "flightstack.core.safety.qp_filter": (f"{UNIT}/core/test_safety_filter.py",),
    "flightstack.core.safety.projection": (f"{UNIT}/core/test_safety_filter.py",),
    "flightstack.core.safety.gate": (f"{UNIT}/core/test_gate.py",),
    "flightstack.core.mission.phases": (
        f"{UNIT}/core/mission/test_phases.py",
        f"{UNIT}/core/mission/test_abort_ways.py",
    ),
}


def source_file(module: str) -> Path:
    """Where the module's source is."""
    return ROOT / (module.replace(".", "/") + ".py")


BOUNDARY = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
OPPOSITE = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
ARITHMETIC = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.LShift: ast.RShift,
}  # fmt: skip
EXTREME = {"min": "max", "max": "min"}
SKIPPED_FIELDS = {"annotation", "returns", "decorator_list", "type_params"}


@dataclass(frozen=True)
class Mutant:
    """One change; ``key`` names it whatever line it stands on.

    Attributes:
        number: of the change in its file, in the order of the tree.
        line: in the file.
        kind: of the change.
        key: function, kind, text before and after, and which of several equal ones.
    """

    number: int
    line: int
    kind: str
    key: str


def _numbers(value: float) -> list[float]:
    if isinstance(value, int):
        return [value + 1, value - 1]
    return [value * 1.1, 0.0] if value else [1.0]


def _changes(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """All changes of one node: kind, and the node to stand in its place."""
    match node:
        case ast.Compare(left, ops, comparators):
            for at, op in enumerate(ops):
                for kind, table in (("boundary", BOUNDARY), ("comparison", OPPOSITE)):
                    if type(op) in table:
                        changed = [*ops[:at], table[type(op)](), *ops[at + 1 :]]
                        yield kind, ast.Compare(left, changed, comparators)
        case ast.BinOp(left, op, right) if type(op) in ARITHMETIC:
            yield "arithmetic", ast.BinOp(left, ARITHMETIC[type(op)](), right)
        case ast.AugAssign(target, op, value) if type(op) in ARITHMETIC:
            yield "arithmetic", ast.AugAssign(target, ARITHMETIC[type(op)](), value)
        case ast.UnaryOp(ast.USub() | ast.Not(), operand):
            yield "negation", operand
        case ast.BoolOp(op, values):
            yield "boolean", ast.BoolOp(ast.Or() if isinstance(op, ast.And) else ast.And(), values)
        case ast.If(test, body, orelse):
            yield "negation", ast.If(ast.UnaryOp(ast.Not(), test), body, orelse)
        case ast.IfExp(test, body, orelse):
            yield "negation", ast.IfExp(ast.UnaryOp(ast.Not(), test), body, orelse)
        case ast.Constant(bool(value)):
            yield "constant", ast.Constant(not value)
        case ast.Constant(int(value) | float(value)):
            for number in _numbers(value):
                yield "constant", ast.Constant(number)
        case ast.Call(ast.Name(name), args, keywords) if name in EXTREME:
            yield "extreme", ast.Call(ast.Name(EXTREME[name], ast.Load()), args, keywords)
        case ast.Return(value) if value is not None and not _is_none(value):
            yield "return", ast.Return(ast.Constant(None))


def _is_none(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def _text(node: ast.AST) -> str:
    text = ast.unparse(node)
    return text.splitlines()[0] if isinstance(node, ast.If) else text


def _walk(tree: ast.Module) -> Iterator[tuple[ast.AST, Callable[[ast.AST], None], str]]:
    """Every node that runs, with a way to replace it, and the function or class it stands in."""

    def down(node: ast.AST, scope: str) -> Iterator[tuple[ast.AST, Callable[[ast.AST], None], str]]:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            scope = f"{scope}.{node.name}".lstrip(".")
        for field, value in ast.iter_fields(node):
            if field in SKIPPED_FIELDS:
                continue
            if isinstance(value, ast.AST):

                def put(new: ast.AST, node: ast.AST = node, field: str = field) -> None:
                    setattr(node, field, new)

                yield value, put, scope
                yield from down(value, scope)
            elif isinstance(value, list):
                for at, item in enumerate(value):
                    if isinstance(item, ast.AST):

                        def put_at(new: ast.AST, items: list[ast.AST] = value, at: int = at) -> None:
                            items[at] = new

                        yield item, put_at, scope
                        yield from down(item, scope)

    return down(tree, "")


def mutants(source: str) -> list[Mutant]:
    """All mutants of a source text."""
    found: list[Mutant] = []
    seen: Counter[str] = Counter()
    for node, _, scope in _walk(ast.parse(source)):
        for kind, changed in _changes(node):
            key = f"{scope or 'module'}: {kind}: {_text(node)} -> {_text(changed)}"
            seen[key] += 1
            if seen[key] > 1:
                key += f" #{seen[key]}"
            found.append(Mutant(len(found), getattr(node, "lineno", 0), kind, key))
    return found


def changed_tree(source: str, number: int) -> ast.Module:
    """The source with one change made.

    Raises:
        IndexError: there is no mutant of this number.
    """
    tree = ast.parse(source)
    count = 0
    for node, put, _ in _walk(tree):
        for _, changed in _changes(node):
            if count == number:
                put(ast.copy_location(changed, node))
                return ast.fix_missing_locations(tree)
            count += 1
    raise IndexError(f"found {count} mutants, asked for number {number}")


def mutated(source: str, number: int, filename: str) -> CodeType:
    """Code of the changed source."""
    return compile(changed_tree(source, number), filename, "exec")
