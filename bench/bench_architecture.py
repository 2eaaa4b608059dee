"""Readability of the code: files, lines, small files, importers, homonyms, fragments and comments of each package."""

from __future__ import annotations

import argparse
import ast
import io
import re
import subprocess
import sys
import tarfile
import tempfile
import tokenize
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.result import Measurement
from bench.runner import version

ROOT = Path(__file__).parents[1]
PAGE = Path("docs", "architecture.md")
PACKAGES = ("appliance", "drivers", "hw_sim")
BEGIN, END = "<!-- figures begin -->\n", "<!-- figures end -->\n"
SMALL_LINES = 80
FRAGMENT = re.compile(r"(Of|As|By|So|From)\b")
"""How a docstring begins that hangs on a noun elsewhere."""
NO_COMMENT = re.compile(r"#\s*(type:|noqa|fmt:|pragma)|#!")


@dataclass(frozen=True, slots=True)
class Figures:
    """Counts of one package."""

    files: int
    lines: int
    small: int
    """Files of fewer than 80 lines, without ``__init__.py``."""
    one_importer: int
    """Modules that at most one other product module imports."""
    homonyms: int
    """Class names that occur in more than one module of the package; private ones do not count."""
    docstrings: int
    """Docstrings of modules, classes, functions, fields and constants."""
    fragments: int
    """Docstrings that begin with Of, As, By, So or From."""
    comments: int
    """Lines with only a comment; directives to tools do not count."""

    @property
    def comment_percent(self) -> float:
        """Comment lines in percent of all lines."""
        return 100.0 * self.comments / max(self.lines, 1)


def figures(root: Path) -> dict[str, Figures]:
    """Count each of ``PACKAGES`` below ``root``; raises OSError, SyntaxError."""
    trees = {
        path: ast.parse(path.read_text(encoding="utf-8"), str(path))
        for package in PACKAGES
        for path in sorted((root / package).rglob("*.py"))
    }
    importers = _importers(root, trees)
    return {package: _count(root, package, trees, importers) for package in PACKAGES}


def _count(root: Path, package: str, trees: dict[Path, ast.Module], importers: Counter[str]) -> Figures:
    paths = [path for path in trees if path.relative_to(root).parts[0] == package]
    texts = {path: path.read_text(encoding="utf-8") for path in paths}
    lines = {path: text.count("\n") for path, text in texts.items()}
    modules = [path for path in paths if path.name != "__init__.py"]
    classes = Counter(
        name
        for path in paths
        for name in {node.name for node in ast.walk(trees[path]) if isinstance(node, ast.ClassDef)}
    )
    docstrings = [text for path in paths for text in _docstrings(trees[path])]
    return Figures(
        len(paths),
        sum(lines.values()),
        sum(lines[path] < SMALL_LINES for path in modules),
        sum(importers[_module(root, path)] <= 1 for path in modules),
        sum(count > 1 and not name.startswith("_") for name, count in classes.items()),
        len(docstrings),
        sum(FRAGMENT.match(text) is not None for text in docstrings),
        sum(_comment_lines(text) for text in texts.values()),
    )


def _module(root: Path, path: Path) -> str:
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _importers(root: Path, trees: dict[Path, ast.Module]) -> Counter[str]:
    """Count for each module how many others import it or a part of it."""
    names = {_module(root, path) for path in trees}
    counts: Counter[str] = Counter()
    for path, tree in trees.items():
        imported: set[str] = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                imported |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                imported |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
        counts.update(imported & names - {_module(root, path)})
    return counts


def _docstrings(tree: ast.Module) -> Iterator[str]:
    """Yield every string statement: of modules, classes and functions, and below fields and constants."""
    for node in ast.walk(tree):
        for statement in getattr(node, "body", ()) if not isinstance(node, ast.Lambda | ast.IfExp) else ():
            if (
                isinstance(statement, ast.Expr)
                and isinstance(statement.value, ast.Constant)
                and isinstance(statement.value.value, str)
            ):
                yield statement.value.value.strip()


def _comment_lines(text: str) -> int:
    lines = text.splitlines()
    return sum(
        token.type == tokenize.COMMENT
        and NO_COMMENT.match(token.string) is None
        and lines[token.start[0] - 1].lstrip().startswith("#")
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
    )


def figures_of_revision(revision: str) -> dict[str, Figures]:
    """Count a revision of the repository. Raises CalledProcessError where Git knows no such revision."""
    packed = subprocess.run(["git", "archive", revision], cwd=ROOT, check=True, capture_output=True, timeout=120).stdout
    with tempfile.TemporaryDirectory() as folder, tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        archive.extractall(folder, filter="data")
        return figures(Path(folder))


ROWS: tuple[tuple[str, Callable[[Figures], str]], ...] = (
    ("files", lambda package: str(package.files)),
    ("lines", lambda package: f"{package.lines:,}"),
    (f"files under {SMALL_LINES} lines", lambda package: str(package.small)),
    ("modules with at most one importer", lambda package: str(package.one_importer)),
    ("class names that occur twice", lambda package: str(package.homonyms)),
    ("docstrings", lambda package: f"{package.docstrings:,}"),
    ("of these, fragments (Of, As, By, So, From …)", lambda package: str(package.fragments)),
    ("comment lines", lambda package: f"{package.comment_percent:.1f} %"),
)


def table(before: dict[str, Figures] | None, after: dict[str, Figures]) -> str:
    """Return the figures as a table in Markdown, before → after where there is a before."""
    lines = [f"| | {' | '.join(f'`{name}`' for name in PACKAGES)} |", f"|---|{'---|' * len(PACKAGES)}"]
    for name, write in ROWS:
        cells = []
        for package in PACKAGES:
            now = write(after[package])
            cells.append(now if before is None else f"{write(before[package])} → {now}")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def measure() -> Iterable[Measurement]:
    """Yield the counts of each package, with the limit of fragments."""
    for package, counts in figures(ROOT).items():
        yield Measurement(f"{package}: files", counts.files, "")
        yield Measurement(f"{package}: files under {SMALL_LINES} lines", counts.small, "")
        yield Measurement(f"{package}: comment lines", counts.comment_percent, "%")
        yield Measurement(f"{package}: fragments among docstrings", counts.fragments, "", at_most=0)
        yield Measurement(f"{package}: class names that occur twice", counts.homonyms, "")


def main(arguments: Sequence[str]) -> int:
    """Run the command line: ``./dev bench architecture --help``."""
    parser = argparse.ArgumentParser(prog="./dev bench architecture", description=__doc__)
    parser.add_argument("--since", metavar="REV", help="show the figures of this revision beside those of now")
    parser.add_argument("--write-docs", action="store_true", help=f"write the table into {PAGE}")
    options = parser.parse_args(arguments)
    try:
        before = None if options.since is None else figures_of_revision(options.since)
    except subprocess.CalledProcessError as error:
        parser.error(
            f"--since {options.since}: {error.stderr.decode(errors='replace').strip()}; `git log` lists revisions"
        )
    written = table(before, figures(ROOT)) + f"\n*Figures of {version()}.*\n"
    sys.stdout.write(written)
    if options.write_docs:
        page = ROOT / PAGE
        head, remainder = page.read_text(encoding="utf-8").split(BEGIN)
        page.write_text(head + BEGIN + written + END + remainder.split(END)[1], encoding="utf-8")
    return 0
