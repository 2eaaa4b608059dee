"""How does the code lie before a reader? Files, lines, small files, importers, homonyms, fragments and comments of each package."""

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

from bench.result import Measured
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
    """What is counted of one package."""

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
    """Those that begin with Of, As, By, So or From."""
    comments: int
    """Lines that are a comment and nothing else; directives to tools do not count."""

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
    """Count for each module how many others import it or something of it."""
    names = {_module(root, path) for path in trees}
    found: Counter[str] = Counter()
    for path, tree in trees.items():
        wanted: set[str] = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                wanted |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                wanted |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
        found.update(wanted & names - {_module(root, path)})
    return found


def _docstrings(tree: ast.Module) -> Iterator[str]:
    """Yield every string that stands alone: of modules, classes and functions, and below fields and constants."""
    for node in ast.walk(tree):
        for one in getattr(node, "body", ()) if not isinstance(node, ast.Lambda | ast.IfExp) else ():
            if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant) and isinstance(one.value.value, str):
                yield one.value.value.strip()


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
    ("files", lambda one: str(one.files)),
    ("lines", lambda one: f"{one.lines:,}"),
    (f"files under {SMALL_LINES} lines", lambda one: str(one.small)),
    ("modules with at most one importer", lambda one: str(one.one_importer)),
    ("class names that occur twice", lambda one: str(one.homonyms)),
    ("docstrings", lambda one: f"{one.docstrings:,}"),
    ("of these, fragments (Of, As, By, So, From …)", lambda one: str(one.fragments)),
    ("comment lines", lambda one: f"{one.comment_percent:.1f} %"),
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


def measure() -> Iterable[Measured]:
    """The promise about fragments, and what is counted besides, of each package as it lies here."""
    for package, one in figures(ROOT).items():
        yield Measured(f"{package}: files", one.files, "")
        yield Measured(f"{package}: files under {SMALL_LINES} lines", one.small, "")
        yield Measured(f"{package}: comment lines", one.comment_percent, "%")
        yield Measured(f"{package}: fragments among docstrings", one.fragments, "", at_most=0)
        yield Measured(f"{package}: class names that occur twice", one.homonyms, "")


def main(arguments: Sequence[str]) -> int:
    """The command line: ``./dev bench architecture --help``."""
    parser = argparse.ArgumentParser(prog="./dev bench architecture", description=__doc__)
    parser.add_argument("--since", metavar="REV", help="show the figures of this revision beside those of now")
    parser.add_argument("--write-docs", action="store_true", help=f"write the table into {PAGE}")
    wanted = parser.parse_args(arguments)
    try:
        before = None if wanted.since is None else figures_of_revision(wanted.since)
    except subprocess.CalledProcessError as error:
        parser.error(
            f"--since {wanted.since}: {error.stderr.decode(errors='replace').strip()}; `git log` lists revisions"
        )
    written = table(before, figures(ROOT)) + f"\n*Figures of {version()}.*\n"
    sys.stdout.write(written)
    if wanted.write_docs:
        page = ROOT / PAGE
        head, rest = page.read_text(encoding="utf-8").split(BEGIN)
        page.write_text(head + BEGIN + written + END + rest.split(END)[1], encoding="utf-8")
    return 0
