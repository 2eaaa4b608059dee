"""Owns what a mutant is and which mutants a source file has: one small change of one span of its text."""

from __future__ import annotations

import ast
import hashlib
import itertools
import random
import re
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass

_COMPARISONS: dict[type[ast.cmpop], tuple[str, tuple[str, ...]]] = {
    ast.Lt: ("<", ("<=", ">=")),
    ast.LtE: ("<=", ("<", ">")),
    ast.Gt: (">", (">=", "<=")),
    ast.GtE: (">=", (">", "<")),
    ast.Eq: ("==", ("!=",)),
    ast.NotEq: ("!=", ("==",)),
    ast.Is: ("is", ("is not",)),
    ast.IsNot: ("is not", ("is",)),
    ast.In: ("in", ("not in",)),
    ast.NotIn: ("not in", ("in",)),
}
_ARITHMETIC: dict[type[ast.operator], tuple[str, str]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Mod: ("%", "+"),
    ast.Pow: ("**", "*"),
    ast.LShift: ("<<", ">>"),
    ast.RShift: (">>", "<<"),
    ast.BitAnd: ("&", "|"),
    ast.BitOr: ("|", "&"),
    ast.BitXor: ("^", "|"),
}
_OPPOSITES = {
    "min": "max",
    "max": "min",
    "any": "all",
    "all": "any",
    "minimum": "maximum",
    "maximum": "minimum",
    "floor": "ceil",
    "ceil": "floor",
}
_NOT_MUTATED = {"debug", "info", "warning", "error", "exception", "log"}
"""Methods of a logger: what is written for people is not what a test of behaviour judges."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change: ``before`` and ``after`` are the changed lines, ``start`` and ``end`` offsets into the text."""

    path: str
    line: int
    last_line: int
    within: str
    """The dotted name of the function or class that is changed; empty at the level of the module."""
    operator: str
    start: int
    end: int
    replacement: str
    before: str
    after: str

    @property
    def key(self) -> str:
        """Names the mutant wherever its line moves to: the same as long as function and line are the same."""
        parts = (self.path, self.within, self.operator, self.before, self.after)
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:12]

    def applied(self, text: str) -> str:
        """Return the file's text with the change in it."""
        return text[: self.start] + self.replacement + text[self.end :]


def mutants_of(path: str, text: str) -> list[Mutant]:
    """Return every mutant of a file, in the order of its lines. Each still parses, and differs in meaning."""
    found: dict[tuple[int, int, str], Mutant] = {}
    finder = _Finder(path, text)
    for operator, start, end, replacement in finder.edits():
        if text[start:end] == replacement or (start, end, replacement) in found:
            continue
        mutant = finder.mutant(operator, start, end, replacement)
        if mutant is not None:
            found[start, end, replacement] = mutant
    return sorted(found.values(), key=lambda one: (one.start, one.end, one.replacement))


def draw(mutants: list[Mutant], count: int, seed: int) -> list[Mutant]:
    """Return ``count`` mutants chosen by ``seed``, no second one of a line before every line has one."""
    chance = random.Random(seed)
    shuffled = chance.sample(mutants, len(mutants))
    rounds: list[list[Mutant]] = []
    seen: dict[tuple[str, int], int] = {}
    for one in shuffled:
        place = seen.get((one.path, one.line), 0)
        seen[one.path, one.line] = place + 1
        if place == len(rounds):
            rounds.append([])
        rounds[place].append(one)
    return [one for some in rounds for one in some][:count]


Edit = tuple[str, int, int, str]


class _Finder(ast.NodeVisitor):
    def __init__(self, path: str, text: str) -> None:
        self._path, self._text = path, text
        self._tree = ast.parse(text, path)
        self._tops: list[tuple[int, int, str]] = []
        self._line_starts = [0]
        for line in text.splitlines(keepends=True):
            self._line_starts.append(self._line_starts[-1] + len(line))
        self._lines = text.splitlines(keepends=True)
        self._scopes: list[tuple[int, int, str]] = []
        self._name_scopes(self._tree, "")
        for node in self._tree.body:
            top_start, top_end = self._span(node)
            for decorator in getattr(node, "decorator_list", ()):
                top_start = min(top_start, self._span(decorator)[0] - 1)
            self._tops.append((top_start, top_end, ast.dump(ast.parse(text[top_start:top_end]))))

    # ------------------------------------------------------------------------------------------------ positions

    def _at(self, line: int, column: int) -> int:
        """The offset in characters of a position of ``ast``, whose columns count bytes."""
        return self._line_starts[line - 1] + len(self._lines[line - 1].encode()[:column].decode())

    def _span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self._at(node.lineno, node.col_offset), self._at(node.end_lineno, node.end_col_offset)

    def _source(self, node: ast.expr | ast.stmt) -> str:
        start, end = self._span(node)
        return self._text[start:end]

    def _name_scopes(self, node: ast.AST, prefix: str) -> None:
        for child in ast.iter_child_nodes(node):
            name = prefix
            if isinstance(child, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
                name = f"{prefix}.{child.name}".lstrip(".")
                assert child.end_lineno is not None
                first = min([child.lineno, *(d.lineno for d in child.decorator_list)])
                self._scopes.append((first, child.end_lineno, name))
            self._name_scopes(child, name)

    def _within(self, line: int) -> str:
        inside = [(last - first, name) for first, last, name in self._scopes if first <= line <= last]
        return min(inside)[1] if inside else ""

    def mutant(self, operator: str, start: int, end: int, replacement: str) -> Mutant | None:
        """The edit as a mutant; None if the changed text does not parse or means the same."""
        top_start, top_end, plain = next(top for top in self._tops if top[0] <= start and end <= top[1])
        try:
            tree = ast.parse(self._text[top_start:start] + replacement + self._text[end:top_end])
        except SyntaxError:
            return None
        if ast.dump(tree) == plain:
            return None
        first = bisect_right(self._line_starts, start)
        last = bisect_right(self._line_starts, max(end - 1, start))
        head, tail = self._line_starts[first - 1], self._line_starts[last]
        before = self._text[head:tail]
        after = self._text[head:start] + replacement + self._text[end:tail]
        return Mutant(
            self._path,
            first,
            last,
            self._within(first),
            operator,
            start,
            end,
            replacement,
            " ".join(before.split()),
            " ".join(after.split()),
        )

    # ---------------------------------------------------------------------------------------------------- edits

    def edits(self) -> Iterator[Edit]:
        yield from self._body(self._tree.body, module=True)

    def _body(self, body: list[ast.stmt], module: bool = False) -> Iterator[Edit]:
        for statement in body:
            yield from self._statement(statement, module)

    def _statement(self, node: ast.stmt, module: bool) -> Iterator[Edit]:
        match node:
            case ast.Expr(value=ast.Constant()) | ast.Import() | ast.ImportFrom() | ast.Assert():
                return  # a docstring, names from elsewhere, a promise to the type checker
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                for default in (*node.args.defaults, *(d for d in node.args.kw_defaults if d is not None)):
                    yield from self._expression(default)
                yield from self._body(node.body)
                return
            case ast.ClassDef():
                yield from self._body(node.body, module=True)
                return
            case ast.Expr(value=ast.Call() as call):
                if _called(call) in _NOT_MUTATED or _called(call) == "assert_never":
                    return
                yield "call removed", *self._span(node), "pass"
            case ast.AugAssign():
                yield "statement removed", *self._span(node), "pass"
                yield from self._operator_of(node)
            case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]) if not module:
                yield "statement removed", *self._span(node), "pass"
            case ast.Raise():
                yield "raise removed", *self._span(node), "pass"
                return  # its message is for people
            case ast.Continue():
                yield "continue removed", *self._span(node), "pass"
                yield "continue to break", *self._span(node), "break"
            case ast.Break():
                yield "break removed", *self._span(node), "pass"
            case ast.Return(value=value) if value is not None:
                yield from self._returned(value)
            case ast.If(test=test) | ast.While(test=test) | ast.Assert(test=test):
                if ast.unparse(test) == "TYPE_CHECKING":
                    return
                yield from self._condition(test, loop=isinstance(node, ast.While))
            case ast.Delete():
                yield "statement removed", *self._span(node), "pass"
            case _:
                pass
        for field in ast.iter_fields(node):
            yield from self._children(field, node)

    def _children(self, field: tuple[str, object], node: ast.AST) -> Iterator[Edit]:
        name, value = field
        if name in {"annotation", "returns", "type_comment", "targets", "target", "pattern"}:
            return  # what is assigned to may not be changed as an expression is
        for child in value if isinstance(value, list) else [value]:
            match child:
                case ast.stmt():
                    yield from self._statement(child, module=False)
                case ast.expr():
                    yield from self._expression(child)
                case ast.excepthandler() | ast.match_case() | ast.withitem():
                    for inner in ast.iter_fields(child):
                        if inner[0] != "type":
                            yield from self._children(inner, child)
                case _:
                    pass

    def _condition(self, test: ast.expr, loop: bool) -> Iterator[Edit]:
        start, end = self._span(test)
        yield "branch removed", start, end, "False"
        if not loop:
            yield "branch always taken", start, end, "True"
            yield "condition negated", start, end, f"not ({self._text[start:end]})"

    def _returned(self, value: ast.expr) -> Iterator[Edit]:
        start, end = self._span(value)
        match value:
            case ast.Constant(value=None):
                return
            case ast.Constant(value=bool(truth)):
                yield "returned constant", start, end, str(not truth)
            case ast.Compare() | ast.BoolOp() | ast.UnaryOp(op=ast.Not()):
                yield "returned True", start, end, "True"
                yield "returned False", start, end, "False"
            case _:
                yield "returned None", start, end, "None"

    def _expression(self, node: ast.expr) -> Iterator[Edit]:
        match node:
            case ast.JoinedStr() | ast.Lambda(body=ast.Constant()):
                return  # text for people
            case ast.Compare():
                yield from self._comparison(node)
            case ast.BoolOp():
                word, other = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
                for left, right in zip(node.values, node.values[1:], strict=False):
                    yield from self._between(f"{word} to {other}", left, right, word, other)
            case ast.BinOp() | ast.AugAssign():
                yield from self._operator_of(node)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                yield "not removed", *self._span(node), f"({self._source(operand)})"
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                yield "sign removed", *self._span(node), f"({self._source(operand)})"
            case ast.IfExp(test=test):
                yield "condition negated", *self._span(test), f"not ({self._source(test)})"
            case ast.Constant():
                yield from self._constant(node)
            case ast.Call():
                yield from self._call(node)
            case ast.Slice():
                yield from self._slice(node)
            case _:
                pass
        for child in ast.iter_child_nodes(node):
            match child:
                case ast.expr():
                    yield from self._expression(child)
                case ast.keyword(value=value):
                    yield from self._expression(value)
                case ast.comprehension():
                    yield from self._expression(child.iter)
                    for test in child.ifs:
                        yield "filter removed", *self._span(test), "True"
                        yield from self._expression(test)
                case _:
                    pass

    def _comparison(self, node: ast.Compare) -> Iterator[Edit]:
        sides = [node.left, *node.comparators]
        for operator, left, right in zip(node.ops, sides, sides[1:], strict=False):
            word, others = _COMPARISONS[type(operator)]
            for other in others:
                yield from self._between(f"{word} to {other}", left, right, word, other)

    def _operator_of(self, node: ast.BinOp | ast.AugAssign) -> Iterator[Edit]:
        known = _ARITHMETIC.get(type(node.op))
        if known is None:
            return
        word, other = known
        left = node.left if isinstance(node, ast.BinOp) else node.target
        right = node.right if isinstance(node, ast.BinOp) else node.value
        if isinstance(left, ast.Constant) and isinstance(left.value, str | bytes):
            return
        yield from self._between(f"{word} to {other}", left, right, word, other)

    def _between(self, name: str, left: ast.expr, right: ast.expr, word: str, other: str) -> Iterator[Edit]:
        """The operator's word between two operands; comments and brackets may stand there too."""
        gap_start, gap_end = self._span(left)[1], self._span(right)[0]
        gap = re.sub(r"#[^\n]*", lambda found: " " * len(found.group()), self._text[gap_start:gap_end])
        pattern = re.escape(word).replace(r"\ ", r"\s+")
        found = re.search(rf"\b{pattern}\b" if word[0].isalpha() else pattern, gap)
        if found:
            yield name, gap_start + found.start(), gap_start + found.end(), other

    def _constant(self, node: ast.Constant) -> Iterator[Edit]:
        start, end = self._span(node)
        match node.value:
            case bool(truth):
                yield "truth negated", start, end, str(not truth)
            case int(number):
                yield "number + 1", start, end, str(number + 1)
                if number > 1:
                    yield "number - 1", start, end, str(number - 1)
            case float(number):
                yield "number doubled", start, end, repr(number * 2.0 if number else 1.0)
                if number:
                    yield "number halved", start, end, repr(number * 0.5)
            case _:
                pass

    def _call(self, node: ast.Call) -> Iterator[Edit]:
        name = _called(node)
        if name in _OPPOSITES:
            word = node.func if isinstance(node.func, ast.Name) else None
            end = self._span(node.func)[1]
            if word is not None or isinstance(node.func, ast.Attribute):
                yield f"{name} to {_OPPOSITES[name]}", end - len(name), end, _OPPOSITES[name]
        if name == "abs" and len(node.args) == 1:
            yield "abs removed", *self._span(node), f"({self._source(node.args[0])})"
        plain = [one for one in node.args if not isinstance(one, ast.Starred)]
        if len(plain) == len(node.args) >= 2 and name not in {"min", "max", "minimum", "maximum"}:
            for left, right in itertools.pairwise(plain):
                start, end = self._span(left)[0], self._span(right)[1]
                gap = self._text[self._span(left)[1] : self._span(right)[0]]
                yield "arguments swapped", start, end, self._source(right) + gap + self._source(left)

    def _slice(self, node: ast.Slice) -> Iterator[Edit]:
        if node.lower is not None:
            start, end = self._span(node.lower)
            yield "slice from + 1", start, end, f"({self._text[start:end]}) + 1"
        if node.upper is not None:
            start, end = self._span(node.upper)
            yield "slice to - 1", start, end, f"({self._text[start:end]}) - 1"


def _called(node: ast.Call) -> str:
    match node.func:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
        case _:
            return ""
