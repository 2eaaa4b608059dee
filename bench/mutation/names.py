"""Owns who uses a name: which compiled kernels a change makes stale, and which tests are to notice it.

A compiled kernel keeps the callees and constants that it was compiled with, also those of other files.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

from bench.mutation.mutants import PACKAGES, Mutant

UNITS = ("tests/appliance/", "tests/drivers/", "tests/hw_sim/")
"""Folders of tests that ask one room; whole dives take too long for one line."""
FROZEN = "tests/behaviour/test_behaviour.py"


@dataclass(slots=True, eq=False)
class Definition:
    """A name at the top level of a file, and who uses it."""

    path: str
    name: str
    node: ast.stmt
    users: list[Definition] = field(default_factory=list)

    @property
    def is_kernel(self) -> bool:
        decorators = getattr(self.node, "decorator_list", [])
        return any(word in ast.unparse(one) for one in decorators for word in ("njit", "vectorize"))


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
        """Every kernel that may have been compiled with what the mutant changes, itself among them."""
        line, every = mutant.statement.lineno, self._of_file[mutant.listed.path].values()
        found = [one for one in every if one.node.lineno <= line <= (one.node.end_lineno or 0)]
        for one in found:
            found += [user for user in dict.fromkeys(one.users) if user not in found]
        return [one for one in found if one.is_kernel]

    def tests_of(self, path: str) -> list[str]:
        """The files of tests for a file: those that import it, those of its room, and the frozen behaviour of the instrument."""
        tests = [one for one in self._trees if one.startswith(UNITS) and "/test_" in one]
        chosen = [one for one in tests if one in self._importers[path]]
        folder = f"tests/{path.rpartition('/')[0]}"
        while folder.count("/") > 1 and not any(one.startswith(f"{folder}/") for one in tests):
            folder = folder.rpartition("/")[0]
        if folder.count("/") > 1 or folder == "tests/drivers":
            chosen += [one for one in tests if one.startswith(f"{folder}/")]
        return [*dict.fromkeys(chosen), *([FROZEN] if path.startswith("appliance/") else [])]

    def _link(self, path: str, tree: ast.Module) -> None:
        modules: dict[str, str] = {}
        known = dict(self._of_file[path])
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                for alias in node.names:
                    name, inner = alias.asname or alias.name, self._file(f"{node.module}.{alias.name}")
                    whole = self._file(node.module)
                    outer = self._of_file.get(whole or "", {}).get(alias.name)
                    self._importers[inner or whole or ""].append(path)
                    if inner:
                        modules[name] = inner
                    elif outer:
                        known[name] = outer
        for top in tree.body:
            for user in (self._of_file[path][name] for name in _names(top)):
                for node in ast.walk(top):
                    used = None
                    if isinstance(node, ast.Name):
                        used = known.get(node.id)
                    elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                        used = self._of_file.get(modules.get(node.value.id, ""), {}).get(node.attr)
                    if used is not None and used is not user:
                        used.users.append(user)

    def _file(self, module: str) -> str | None:
        path = module.replace(".", "/")
        return next((one for one in (f"{path}.py", f"{path}/__init__.py") if one in self._trees), None)


def _names(node: ast.stmt) -> list[str]:
    match node:
        case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.AnnAssign(target=ast.Name(id=name)):
            return [name]
        case ast.Assign(targets=targets):
            return [one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)]
        case _:
            return []
