"""Owns which mutants a source file has: one small change of its text, told by the lines before and after it."""

from __future__ import annotations

import ast
import hashlib
import itertools
import random
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

PACKAGES = ("appliance", "drivers", "hw_sim")
_PAIRS = (
    ("<", "<="),
    (">", ">="),
    ("==", "!="),
    ("is", "is not"),
    ("in", "not in"),
    ("and", "or"),
    ("+", "-"),
    ("*", "/"),
)
_OPERATORS = {**dict(_PAIRS), **{right: left for left, right in _PAIRS}, "//": "*", "**": "*", "%": "+"}
_FUNCTIONS = {"min": "max", "max": "min", "any": "all", "all": "any", "minimum": "maximum", "maximum": "minimum"}
_WORD = re.compile(r"is\s+not|not\s+in|is|in|and|or|[<>=!]=|//|\*\*|[-+*/%<>]")
_FOR_PEOPLE = {"debug", "info", "warning", "error", "exception", "log", "assert_never"}
"""Calls of a logger, which no test of behaviour judges, and of what never runs."""
_NOT_CODE = {"annotation", "returns", "target", "targets", "pattern", "type", "decorator_list", "bases"}
Span = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Listed:
    """A mutant by its text alone, which lasts when its line moves, and what became of it or why nothing can notice it."""

    path: str
    within: str
    """The qualified name of its function or class, or nothing."""
    before: str
    after: str
    verdict: str = ""

    @property
    def key(self) -> str:
        return hashlib.sha256("\0".join((self.path, self.within, self.before, self.after)).encode()).hexdigest()[:12]

    def __str__(self) -> str:
        lines = f"{self.path} · {self.within}\n- {self.before}\n+ {self.after}\n"
        return lines + (f"  {self.verdict}\n" if self.verdict else "")


@dataclass(frozen=True, slots=True)
class Mutant:
    """A listed mutant and its place in the text of its file."""

    listed: Listed
    span: Span
    replacement: str
    statement: ast.stmt

    def applied(self, text: str) -> str:
        return text[: self.span[0]] + self.replacement + text[self.span[1] :]


def read(file: Path) -> list[Listed]:
    """Return the mutants of a file of paragraphs: path · name, - before, + after, and a verdict or an argument, indented."""
    found = []
    for place, within, rest in re.findall(r"^(\S+) ·(.*)\n((?:[-+ ] .*\n)*)", file.read_text(encoding="utf-8"), re.M):
        before, after, *verdict = rest.splitlines()
        found.append(Listed(place, within.strip(), before[2:], after[2:], " ".join(line.strip() for line in verdict)))
    return found


def files(root: Path, globs: list[str]) -> list[str]:
    """Return the files of the packages that a glob names and none with ``!`` before it does."""
    names = [path.relative_to(root).as_posix() for package in PACKAGES for path in (root / package).rglob("*.py")]
    unwanted = [one[1:] for one in globs if one.startswith("!")]
    return sorted(
        name
        for name in names
        if any(fnmatch(name, one) for one in globs) and not any(fnmatch(name, one) for one in unwanted)
    )


def draw(root: Path, globs: list[str], count: int, seed: int, without: list[Listed]) -> list[Listed]:
    """Return ``count`` mutants: statements by chance, one mutant of each, and no file again before every file has one."""
    chance = random.Random(seed)
    texts = {path: (root / path).read_text(encoding="utf-8") for path in files(root, globs)}
    by_statement: dict[tuple[str, int], list[Mutant]] = {}
    for path, text in texts.items():
        for mutant in mutants_of(path, text):
            by_statement.setdefault((path, mutant.statement.lineno), []).append(mutant)
    drawn, of_file = [], Counter[str]()
    for (path, _), mutants in chance.sample(list(by_statement.items()), len(by_statement)):
        of_file[path] += 1
        drawn.append((of_file[path], chance.choice(mutants)))
    drawn.sort(key=lambda one: one[0])
    left_out = {one.key for one in without}
    return [one.listed for _, one in drawn if one.listed.key not in left_out][:count]


def find(root: Path, listed: Listed) -> Mutant | None:
    """Return the mutant where its lines stand now: in its file, else in the only other one that has them in that function."""
    for paths in ([listed.path] if (root / listed.path).exists() else [], files(root, ["*"])):
        found = []
        for path in paths:
            text = (root / path).read_text(encoding="utf-8")
            if listed.before in " ".join(text.split()):
                moved = Listed(path, listed.within, listed.before, listed.after)
                found += [one for one in mutants_of(path, text) if one.listed == moved]
        if len(found) == 1:
            return found[0]
    return None


def mutants_of(path: str, text: str) -> list[Mutant]:
    """Return every mutant of a file that its name and its lines tell from all others."""
    source = Source(path, text)
    source.visit(ast.parse(text, path), "", in_function=False)
    many = Counter(one.listed for one in source.found)
    return [one for one in source.found if many[one.listed] == 1]


class Source:
    """The text of a file, and its mutants after ``visit``."""

    def __init__(self, path: str, text: str) -> None:
        self.path, self.text = path, text
        self.found: list[Mutant] = []
        self._lines = text.splitlines(keepends=True)
        self._starts = list(itertools.accumulate((len(line) for line in self._lines), initial=0))

    def span(self, node: ast.expr | ast.stmt) -> Span:
        """Return the first and the last offset of a node, whose columns count bytes."""
        return self._at(node.lineno, node.col_offset), self._at(node.end_lineno or 0, node.end_col_offset or 0)

    def _at(self, line: int, column: int) -> int:
        return self._starts[line - 1] + len(self._lines[line - 1].encode()[:column].decode())

    def visit(self, node: ast.AST, within: str, *, in_function: bool) -> None:
        """Add the mutants of all statements below ``node``."""
        for child in ast.iter_child_nodes(node):
            inner, inside = within, in_function
            if isinstance(child, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
                inner, inside = f"{within}.{child.name}".lstrip("."), not isinstance(child, ast.ClassDef)
            if isinstance(child, ast.stmt) and not isinstance(child, ast.Assert | ast.Import | ast.ImportFrom):
                for span, replacement in self._edits(child, in_function):
                    self._add(span, replacement, child, inner)
            if not (isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING"):
                self.visit(child, inner, in_function=inside)

    def _add(self, span: Span, new: str, statement: ast.stmt, within: str) -> None:
        head, tail = self.text.rfind("\n", 0, span[0]) + 1, self.text.find("\n", span[1] - 1)
        before = " ".join(self.text[head:tail].split())
        after = " ".join((self.text[head : span[0]] + new + self.text[span[1] : tail]).split())
        self.found.append(Mutant(Listed(self.path, within, before, after), span, new, statement))

    def _edits(self, node: ast.stmt, in_function: bool) -> Iterator[tuple[Span, str]]:
        match node:
            case ast.Expr(value=ast.Call(func=ast.Attribute(attr=name) | ast.Name(id=name))) if name in _FOR_PEOPLE:
                return
            case ast.Raise():
                yield self.span(node), "pass"
                return  # its message is for people
            case ast.Break() | ast.Continue() | ast.Delete() | ast.Expr(value=ast.Call()):
                yield self.span(node), "pass"
            case ast.AugAssign() | ast.Assign(targets=[ast.Attribute() | ast.Subscript()]) if in_function:
                yield self.span(node), "pass"
            case ast.Return(value=ast.expr() as value) if not isinstance(value, ast.Constant):
                yield self.span(value), "None"
            case ast.If(test=test) | ast.While(test=test):
                yield self._within(test, "not ({})")
            case _:
                pass
        if isinstance(node, ast.AugAssign):
            yield from self._operators([node.target, node.value])
        for inner in _expressions(node):
            yield from self._edits_of(inner)

    def _edits_of(self, node: ast.AST) -> Iterator[tuple[Span, str]]:
        match node:
            case ast.Compare(left=left, comparators=others):
                yield from self._operators([left, *others])
            case ast.BoolOp(values=values):
                yield from self._operators(values)
            case ast.BinOp(left=left, right=right) if not isinstance(getattr(left, "value", None), str | bytes):
                yield from self._operators([left, right])
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                yield self.span(node), self._within(operand, "({})")[1]
            case ast.IfExp(test=test):
                yield self._within(test, "not ({})")
            case ast.comprehension(ifs=[test, *_]):
                yield self.span(test), "True"
            case ast.Constant(value=bool(truth)):
                yield self.span(node), str(not truth)
            case ast.Constant(value=int(number)):
                yield self.span(node), str(number + 1)
            case ast.Constant(value=float(number)):
                yield self.span(node), repr(number * 2.0 or 1.0)
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)) if name in _FUNCTIONS:
                end = self.span(node.func)[1]
                yield (end - len(name), end), _FUNCTIONS[name]
            case _:
                pass

    def _within(self, node: ast.expr, pattern: str) -> tuple[Span, str]:
        start, end = self.span(node)
        return (start, end), pattern.format(self.text[start:end])

    def _operators(self, operands: list[ast.expr]) -> Iterator[tuple[Span, str]]:
        """The words between operands; comments and brackets may stand there too."""
        for left, right in itertools.pairwise(operands):
            start, end = self.span(left)[1], self.span(right)[0]
            gap = re.sub(r"#[^\n]*", lambda found: " " * len(found.group()), self.text[start:end])
            found = _WORD.search(gap)
            other = _OPERATORS.get(" ".join(found.group().split())) if found else None
            if found and other:
                yield (start + found.start(), start + found.end()), other


def _expressions(node: ast.AST) -> Iterator[ast.AST]:
    """All expressions of a statement that run: no statement within it, no annotation, no text for people."""
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and name not in _NOT_CODE and not isinstance(child, ast.stmt | ast.JoinedStr):
                yield child
                yield from _expressions(child)
