"""Owns which mutants a source file has: one small change of its text, told by the lines before and after it."""

from __future__ import annotations

import ast
import hashlib
import random
import re
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

PACKAGES = ("appliance", "drivers", "hw_sim")
_WORDS: dict[type[ast.AST], tuple[str, str]] = {
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
    ast.And: ("and", "or"),
    ast.Or: ("or", "and"),
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Mod: ("%", "+"),
    ast.Pow: ("**", "*"),
}
_OPPOSITES = {"min": "max", "max": "min", "any": "all", "all": "any", "minimum": "maximum", "maximum": "minimum"}
_FOR_PEOPLE = {"debug", "info", "warning", "error", "exception", "log"}
"""Methods of a logger: no test of behaviour judges what they write."""
_NOT_CODE = {"annotation", "returns", "target", "targets", "pattern", "type", "decorator_list"}


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

    def same_change(self, other: Listed) -> bool:
        return (self.within, self.before, self.after) == (other.within, other.before, other.after)


@dataclass(frozen=True, slots=True)
class Mutant:
    """A listed mutant and its place in the text of its file."""

    listed: Listed
    start: int
    end: int
    replacement: str
    statement: ast.stmt
    in_function: bool
    """Or it runs when its file is imported."""

    def applied(self, text: str) -> str:
        return text[: self.start] + self.replacement + text[self.end :]


def read(text: str) -> list[Listed]:
    """Return the mutants of a text of paragraphs: file · name, - before, + after, and a verdict, indented."""
    found = []
    for paragraph in re.split(r"\n(?=\S+ ·)", text):
        place, *lines = [line for line in paragraph.splitlines() if line.strip() and not line.startswith("#")] or [""]
        if not place:
            continue
        named = re.match(r"(\S+) ·(?: (.*))?$", place)
        if named is None or [line[:2] for line in lines[:2]] != ["- ", "+ "] or any(one[0] != " " for one in lines[2:]):
            raise ValueError(f"{place!r}: wanted are 'FILE · NAME', '- before', '+ after', and a verdict, indented")
        before, after = (line[2:].strip() for line in lines[:2])
        found.append(
            Listed(named[1], (named[2] or "").strip(), before, after, " ".join(one.strip() for one in lines[2:]))
        )
    return found


def written(head: str, mutants: list[Listed]) -> str:
    """Return the text that ``read`` reads, below a head of comment lines."""
    paragraphs = [
        f"{one.path} · {one.within}\n- {one.before}\n+ {one.after}\n" + (f"  {one.verdict}\n" if one.verdict else "")
        for one in mutants
    ]
    return "\n".join([head, *paragraphs])


def files(root: Path, globs: list[str]) -> list[str]:
    """Return the files of the packages that a glob names and none with ``!`` before it does."""
    names = [path.relative_to(root).as_posix() for package in PACKAGES for path in (root / package).rglob("*.py")]
    wanted, unwanted = [one for one in globs if one[0] != "!"], [one[1:] for one in globs if one[0] == "!"]
    return sorted(
        name for name in names if any(fnmatch(name, w) for w in wanted) and not any(fnmatch(name, u) for u in unwanted)
    )


def draw(root: Path, globs: list[str], count: int, seed: int, without: list[Listed]) -> list[Listed]:
    """Return ``count`` mutants: statements by chance, of each one mutant, and no file again before every file has one."""
    chance = random.Random(seed)
    left_out = {one.key for one in without}
    by_statement: dict[tuple[str, int], list[Mutant]] = {}
    texts = {path: (root / path).read_text(encoding="utf-8") for path in files(root, globs)}
    for path, text in texts.items():
        for mutant in mutants_of(path, text):
            by_statement.setdefault((path, mutant.statement.lineno), []).append(mutant)
    waiting = chance.sample(sorted(by_statement.items(), key=lambda one: one[0]), len(by_statement))
    drawn: list[Listed] = []
    while waiting and len(drawn) < count:
        this_round: set[str] = set()
        later = []
        for (path, line), some in waiting:
            if path in this_round or len(drawn) == count:
                later.append(((path, line), some))
                continue
            one = chance.choice(some)
            if one.listed.key not in left_out and _differs(one, texts[path]):
                this_round.add(path)
                drawn.append(one.listed)
        waiting = later
    return drawn


def _differs(mutant: Mutant, text: str) -> bool:
    try:
        return ast.dump(ast.parse(mutant.applied(text))) != ast.dump(ast.parse(text))
    except SyntaxError:
        return False


def find(root: Path, listed: Listed) -> Mutant | None:
    """Return the mutant where its lines stand now: in its file, else in the only other one that has them in that function."""
    for paths in ([listed.path] if (root / listed.path).exists() else [], files(root, ["*"])):
        found = []
        for path in paths:
            text = (root / path).read_text(encoding="utf-8")
            if listed.before in " ".join(text.split()):
                found += [one for one in mutants_of(path, text) if one.listed.same_change(listed)]
        if len(found) == 1:
            return found[0]
    return None


def mutants_of(path: str, text: str) -> list[Mutant]:
    """Return every mutant of a file that its name and its lines tell from all others."""
    source = _Source(path, text)
    source.visit(ast.parse(text, path), "", in_function=False)
    many: dict[str, int] = {}
    for one in source.found:
        many[one.listed.key] = many.get(one.listed.key, 0) + 1
    return [one for one in source.found if many[one.listed.key] == 1]


class Positions:
    """From the lines and columns of ``ast``, whose columns count bytes, to offsets into a text."""

    def __init__(self, text: str) -> None:
        self.text = text
        self._lines = text.splitlines(keepends=True)
        self._starts = [0]
        for line in self._lines:
            self._starts.append(self._starts[-1] + len(line))

    def span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self._at(node.lineno, node.col_offset), self._at(node.end_lineno, node.end_col_offset)

    def _at(self, line: int, column: int) -> int:
        return self._starts[line - 1] + len(self._lines[line - 1].encode()[:column].decode())


class _Source(Positions):
    def __init__(self, path: str, text: str) -> None:
        super().__init__(text)
        self._path = path
        self.found: list[Mutant] = []

    def visit(self, node: ast.AST, within: str, *, in_function: bool) -> None:
        """Add the mutants of all statements below ``node``."""
        for child in ast.iter_child_nodes(node):
            inner, inside = within, in_function
            if isinstance(child, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
                inner, inside = f"{within}.{child.name}".lstrip("."), not isinstance(child, ast.ClassDef)
            if isinstance(child, ast.stmt) and not isinstance(child, ast.Assert | ast.Import | ast.ImportFrom):
                for start, end, replacement in self._edits(child, in_function):
                    self._add(start, end, replacement, child, inner, in_function)
            if not (isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING"):
                self.visit(child, inner, in_function=inside)

    def _add(self, start: int, end: int, new: str, statement: ast.stmt, within: str, in_function: bool) -> None:
        head = self.text.rfind("\n", 0, start) + 1
        tail = self.text.find("\n", end - 1)
        before = " ".join(self.text[head:tail].split())
        after = " ".join((self.text[head:start] + new + self.text[end:tail]).split())
        listed = Listed(self._path, within, before, after)
        self.found.append(Mutant(listed, start, end, new, statement, in_function))

    def _edits(self, node: ast.stmt, in_function: bool) -> Iterator[tuple[int, int, str]]:
        match node:
            case ast.Expr(value=ast.Call(func=ast.Attribute(attr=name) | ast.Name(id=name))):
                if name in _FOR_PEOPLE or name == "assert_never":
                    return
                yield *self.span(node), "pass"
            case ast.AugAssign() | ast.Assign(targets=[ast.Attribute() | ast.Subscript()]) | ast.Delete():
                if in_function:
                    yield *self.span(node), "pass"
            case ast.Break() | ast.Continue():
                yield *self.span(node), "pass"
            case ast.Raise():
                yield *self.span(node), "pass"
                return  # its message is for people
            case ast.Return(value=ast.expr() as value) if not isinstance(value, ast.Constant):
                yield *self.span(value), "None"
            case ast.If(test=test) | ast.While(test=test):
                yield self._negated(test)
            case _:
                pass
        if isinstance(node, ast.AugAssign):
            yield from self._word(node.op, node.target, node.value)
        for inner in _expressions(node):
            yield from self._edits_of(inner)

    def _negated(self, test: ast.expr) -> tuple[int, int, str]:
        start, end = self.span(test)
        return start, end, f"not ({self.text[start:end]})"

    def _edits_of(self, node: ast.AST) -> Iterator[tuple[int, int, str]]:
        match node:
            case ast.Compare():
                sides = [node.left, *node.comparators]
                for operator, left, right in zip(node.ops, sides, sides[1:], strict=False):
                    yield from self._word(operator, left, right)
            case ast.BoolOp():
                for left, right in zip(node.values, node.values[1:], strict=False):
                    yield from self._word(node.op, left, right)
            case ast.BinOp() if not (isinstance(node.left, ast.Constant) and isinstance(node.left.value, str | bytes)):
                yield from self._word(node.op, node.left, node.right)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                start, end = self.span(operand)
                yield *self.span(node), f"({self.text[start:end]})"
            case ast.IfExp(test=test):
                yield self._negated(test)
            case ast.comprehension(ifs=[test, *_]):
                yield *self.span(test), "True"
            case ast.Constant(value=bool(truth)):
                yield *self.span(node), str(not truth)
            case ast.Constant(value=int(number)):
                yield *self.span(node), str(number + 1)
            case ast.Constant(value=float(number)):
                yield *self.span(node), repr(number * 2.0 or 1.0)
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)) if name in _OPPOSITES:
                end = self.span(node.func)[1]
                yield end - len(name), end, _OPPOSITES[name]
            case _:
                pass

    def _word(self, operator: ast.AST, left: ast.expr, right: ast.expr) -> Iterator[tuple[int, int, str]]:
        """The operator's word between two operands; comments and brackets may stand there too."""
        word, other = _WORDS.get(type(operator), ("", ""))
        start, end = self.span(left)[1], self.span(right)[0]
        gap = re.sub(r"#[^\n]*", lambda found: " " * len(found.group()), self.text[start:end])
        pattern = re.escape(word).replace(r"\ ", r"\s+")
        found = re.search(rf"\b{pattern}\b" if word.isidentifier() or " " in word else pattern, gap)
        if word and found:
            yield start + found.start(), start + found.end(), other


def _expressions(node: ast.AST) -> Iterator[ast.AST]:
    """All expressions of a statement that run: no statement within it, no annotation, no text for people."""
    if isinstance(node, ast.ClassDef):
        return
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and name not in _NOT_CODE and not isinstance(child, ast.stmt | ast.JoinedStr):
                yield child
                yield from _expressions(child)
