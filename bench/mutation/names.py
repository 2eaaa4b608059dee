"""Users of a name: the compiled kernels that a change makes stale, and the tests that should notice it.

A compiled kernel keeps the callees and constants that it was compiled with, also those of other files.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

from bench.mutation.mutants import PACKAGES, Mutant

UNITS = ("tests/appliance/", "tests/drivers/", "tests/hw_sim/")
"""Folders of the tests of single packages; tests of whole dives take too long for one mutant."""
FROZEN = "tests/behaviour/test_behaviour.py"


@dataclass(slots=True, eq=False)
class Definition:
    """A name at the top level of a file, and its users."""

    path: str
    name: str
    node: ast.stmt
    users: list[Definition] = field(default_factory=list)

    @property
    def is_kernel(self) -> bool:
        decorators = getattr(self.node, "decorator_list", [])
        return any(word in ast.unparse(decorator) for decorator in decorators for word in ("njit", "vectorize"))


class Names:
    """The names at the top levels of the packages' and the tests' files."""

    def __init__(self, root: Path) -> None:
        paths = [path for package in (*PACKAGES, "tests") for path in sorted((root / package).rglob("*.py"))]
        self._trees = {path.relative_to(root).as_posix(): ast.parse(path.read_text(encoding="utf-8")) for path in paths}
        self._of_file = {
            path: {name: Definition(path, name, node) for node in tree.body for name in _names(node)}
            for path, tree in self._trees.items()
        }
        self._importers: dict[str, list[str]] = defaultdict(list)
        for path, tree in self._trees.items():
            self._link(path, tree)

    def stale_kernels(self, mutant: Mutant) -> list[Definition]:
        """Return every kernel that may have been compiled with the changed statement, its own among them."""
        line, every = mutant.statement.lineno, self._of_file[mutant.listed.path].values()
        definitions = [
            definition for definition in every if definition.node.lineno <= line <= (definition.node.end_lineno or 0)
        ]
        for definition in definitions:
            definitions += [user for user in dict.fromkeys(definition.users) if user not in definitions]
        return [definition for definition in definitions if definition.is_kernel]

    def tests_of(self, path: str) -> list[str]:
        """Return the test files for a file: those that import it, those of its room, and the frozen behaviour."""
        tests = [file for file in self._trees if file.startswith(UNITS) and "/test_" in file]
        chosen = [file for file in tests if file in self._importers[path]]
        folder = f"tests/{path.rpartition('/')[0]}"
        while folder.count("/") > 1 and not any(file.startswith(f"{folder}/") for file in tests):
            folder = folder.rpartition("/")[0]
        if folder.count("/") > 1 or folder == "tests/drivers":
            chosen += [file for file in tests if file.startswith(f"{folder}/")]
        return [*dict.fromkeys(chosen), *([FROZEN] if path.startswith("appliance/") else [])]

    def _link(self, path: str, tree: ast.Module) -> None:
        modules: dict[str, str] = {}
        definitions = dict(self._of_file[path])
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                for alias in node.names:
                    name, inner = alias.asname or alias.name, self._file(f"{node.module}.{alias.name}")
                    source_file = self._file(node.module)
                    outer = self._of_file.get(source_file or "", {}).get(alias.name)
                    self._importers[inner or source_file or ""].append(path)
                    if inner:
                        modules[name] = inner
                    elif outer:
                        definitions[name] = outer
        for top in tree.body:
            for user in (self._of_file[path][name] for name in _names(top)):
                for node in ast.walk(top):
                    used = None
                    if isinstance(node, ast.Name):
                        used = definitions.get(node.id)
                    elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                        used = self._of_file.get(modules.get(node.value.id, ""), {}).get(node.attr)
                    if used is not None and used is not user:
                        used.users.append(user)

    def _file(self, module: str) -> str | None:
        path = module.replace(".", "/")
        return next(
            (candidate for candidate in (f"{path}.py", f"{path}/__init__.py") if candidate in self._trees), None
        )


def _names(node: ast.stmt) -> list[str]:
    match node:
        case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.AnnAssign(target=ast.Name(id=name)):
            return [name]
        case ast.Assign(targets=targets):
            return [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
        case _:
            return []
