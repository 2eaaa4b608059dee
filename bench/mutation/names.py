"""Owns who uses a name: which compiled kernels a change makes stale, and which functions run when a kernel or constant is used.

A compiled kernel keeps the callees and constants that it was compiled with, also those of other files, and no probe can stand
in it.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from bench.mutation.mutants import PACKAGES, Mutant

Function = ast.FunctionDef | ast.AsyncFunctionDef


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

    @property
    def is_function(self) -> bool:
        return isinstance(self.node, Function) and not self.is_kernel


class Names:
    """The names at the top levels of the packages' and the tests' files."""

    def __init__(self, root: Path) -> None:
        paths = [path for package in (*PACKAGES, "tests") for path in sorted((root / package).rglob("*.py"))]
        self.trees = {path.relative_to(root).as_posix(): ast.parse(path.read_text(encoding="utf-8")) for path in paths}
        self._of_file = {
            path: {name: Definition(path, name, node) for node in tree.body for name in _names(node)}
            for path, tree in self.trees.items()
        }
        for path, tree in self.trees.items():
            self._link(path, tree)

    def stale_kernels(self, mutant: Mutant) -> list[Definition]:
        """Every kernel that may have been compiled with what the mutant changes, itself among them."""
        return [one for one in self._reached(self._of(mutant), beyond_functions=True) if one.is_kernel]

    def at_work(self, mutant: Mutant) -> Iterator[tuple[str, ast.stmt]]:
        """The nearest functions that are at work whenever the mutant's kernel or constant is."""
        for one in self._reached(self._of(mutant), beyond_functions=False):
            if isinstance(one.node, ast.ClassDef) or one.is_function:
                yield from ((one.path, inner) for inner in ast.walk(one.node) if isinstance(inner, Function))

    def in_kernel(self, mutant: Mutant) -> bool:
        """Return True if the mutant stands within a kernel."""
        return any(one.is_kernel for one in self._of(mutant))

    def _of(self, mutant: Mutant) -> list[Definition]:
        line, every = mutant.statement.lineno, self._of_file[mutant.listed.path].values()
        return [one for one in every if one.node.lineno <= line <= (one.node.end_lineno or 0)]

    def _reached(self, first: list[Definition], *, beyond_functions: bool) -> list[Definition]:
        found = list(first)
        for one in found:
            if beyond_functions or not one.is_function:
                found += [user for user in dict.fromkeys(one.users) if user not in found]
        return found

    def _link(self, path: str, tree: ast.Module) -> None:
        modules: dict[str, str] = {}
        known = dict(self._of_file[path])
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                for alias in node.names:
                    name, inner = alias.asname or alias.name, self._file(f"{node.module}.{alias.name}")
                    outer = self._of_file.get(self._file(node.module) or "", {}).get(alias.name)
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
        return next((one for one in (f"{path}.py", f"{path}/__init__.py") if one in self.trees), None)


def _names(node: ast.stmt) -> list[str]:
    match node:
        case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.AnnAssign(target=ast.Name(id=name)):
            return [name]
        case ast.Assign(targets=targets):
            return [one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)]
        case _:
            return []
