"""Mutants of a source file: small changes of its text, identified by the line before and after the change."""

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
"""Calls that no test of behaviour notices: those of a logger, and those that never run."""
_NOT_CODE = {"annotation", "returns", "target", "targets", "pattern", "type", "decorator_list", "bases"}
Span = tuple[int, int]


@dataclass(frozen=True, slots=True)
class MutantRecord:
    """A mutant by its text, which stays valid when its line moves, with its verdict or the reason why no test can
    notice it."""

    path: str
    within: str
    """Qualified name of its function or class, or empty."""
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

    listed: MutantRecord
    span: Span
    replacement: str
    statement: ast.stmt

    def applied(self, text: str) -> str:
        return text[: self.span[0]] + self.replacement + text[self.span[1] :]


def read(file: Path) -> list[MutantRecord]:
    """Return the mutants of a file of paragraphs.

    A paragraph is path · name, - before, + after, and a verdict or a reason, indented.
    """
    mutants = []
    for place, within, lines in re.findall(r"^(\S+) ·(.*)\n((?:[-+ ] .*\n)*)", file.read_text(encoding="utf-8"), re.M):
        before, after, *verdict = lines.splitlines()
        mutants.append(
            MutantRecord(place, within.strip(), before[2:], after[2:], " ".join(line.strip() for line in verdict))
        )
    return mutants


def files(root: Path, globs: list[str]) -> list[str]:
    """Return the files of the packages that a glob matches and no glob after ``!`` does."""
    names = [path.relative_to(root).as_posix() for package in PACKAGES for path in (root / package).rglob("*.py")]
    unwanted = [glob[1:] for glob in globs if glob.startswith("!")]
    return sorted(
        name
        for name in names
        if any(fnmatch(name, glob) for glob in globs) and not any(fnmatch(name, glob) for glob in unwanted)
    )


def draw(root: Path, globs: list[str], count: int, seed: int, without: list[MutantRecord]) -> list[MutantRecord]:
    """Return ``count`` random mutants, one of each statement; a file comes again only after every other file."""
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
    drawn.sort(key=lambda pair: pair[0])
    left_out = {entry.key for entry in without}
    return [pair.listed for _, pair in drawn if pair.listed.key not in left_out][:count]


def find(root: Path, listed: MutantRecord) -> Mutant | None:
    """Return the mutant where its lines are now.

    It is in its file, else in the only other file that has the lines in that function.
    """
    for paths in ([listed.path] if (root / listed.path).exists() else [], files(root, ["*"])):
        matches = []
        for path in paths:
            text = (root / path).read_text(encoding="utf-8")
            if listed.before in " ".join(text.split()):
                moved = MutantRecord(path, listed.within, listed.before, listed.after)
                matches += [mutant for mutant in mutants_of(path, text) if mutant.listed == moved]
        if len(matches) == 1:
            return matches[0]
    return None


def mutants_of(path: str, text: str) -> list[Mutant]:
    """Return every mutant of a file that is identified by its name and its lines."""
    source = Source(path, text)
    source.visit(ast.parse(text, path), "", in_function=False)
    many = Counter(mutant.listed for mutant in source.found)
    return [mutant for mutant in source.found if many[mutant.listed] == 1]


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
        self.found.append(Mutant(MutantRecord(self.path, within, before, after), span, new, statement))

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
        """Yield the words between operands; comments and brackets may stand there, too."""
        for left, right in itertools.pairwise(operands):
            start, end = self.span(left)[1], self.span(right)[0]
            gap = re.sub(r"#[^\n]*", lambda match: " " * len(match.group()), self.text[start:end])
            match = _WORD.search(gap)
            replacement = _OPERATORS.get(" ".join(match.group().split())) if match else None
            if match and replacement:
                yield (start + match.start(), start + match.end()), replacement


def _expressions(node: ast.AST) -> Iterator[ast.AST]:
    """Yield all executed expressions of a statement, without nested statements, annotations and messages."""
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and name not in _NOT_CODE and not isinstance(child, ast.stmt | ast.JoinedStr):
                yield child
                yield from _expressions(child)
