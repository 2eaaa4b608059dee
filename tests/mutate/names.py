"""Owns who uses a name: which definitions of the project a change of one definition can reach, kernels above all.

A compiled kernel keeps the callees and constants that it was compiled with, also those of other files, and its lines
never show in a trace. So two questions are answered here: which compiled kernels are stale when a definition has
changed, and which plain functions must run for a kernel or a constant to be at work.
"""

from __future__ import annotations

import ast
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

PACKAGES = ("appliance", "drivers", "hw_sim")

Name = tuple[str, str]
"""The path of a file, and a name that is defined at its top level."""


@dataclass(slots=True)
class Definition:
    """What stands at the top level of a file under one name."""

    path: str
    name: str
    first: int
    last: int
    function: bool
    """Or a class."""
    kernel: bool
    body: int
    """The line from which on a function runs when it is called; a constant's and a class's run at import."""
    uses: set[Name] = field(default_factory=set)


class Names:
    """The top-level definitions of the project and who refers to whom."""

    def __init__(self, root: Path) -> None:
        self.definitions: dict[Name, Definition] = {}
        self._in_file: dict[str, list[Definition]] = {}
        trees = {
            path.relative_to(root).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
            for package in PACKAGES
            for path in sorted((root / package).rglob("*.py"))
        }
        for path, tree in trees.items():
            for node in tree.body:
                self._define(path, node)
        for one in self.definitions.values():
            self._in_file.setdefault(one.path, []).append(one)
        for path, tree in trees.items():
            self._link(path, tree, trees)
        self._users: dict[Name, set[Name]] = {}
        for name, one in self.definitions.items():
            for used in one.uses:
                self._users.setdefault(used, set()).add(name)

    def at(self, path: str, line: int) -> Definition | None:
        """The definition that a line belongs to."""
        for one in self._in_file.get(path, ()):
            if one.first <= line <= one.last:
                return one
        return None

    def stale_kernels(self, changed: Definition) -> set[Name]:
        """Every kernel that may have been compiled with the definition in it, itself among them."""
        found, waiting = {(changed.path, changed.name)}, deque([(changed.path, changed.name)])
        while waiting:
            for user in self._users.get(waiting.popleft(), ()):
                if user not in found:
                    found.add(user)
                    waiting.append(user)
        return {name for name in found if self.definitions[name].kernel}

    def workers(self, changed: Definition) -> list[Definition]:
        """The nearest plain functions and classes that are at work whenever the definition is."""
        found, waiting, reached = {(changed.path, changed.name)}, deque([(changed.path, changed.name)]), []
        while waiting:
            for user in sorted(self._users.get(waiting.popleft(), ())):
                if user in found:
                    continue
                found.add(user)
                one = self.definitions[user]
                if one.function and not one.kernel:
                    reached.append(one)
                else:
                    waiting.append(user)
        return reached

    def _define(self, path: str, node: ast.stmt) -> None:
        names: list[str] = []
        function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        kernel = False
        first = node.lineno
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                names = [node.name]
                kernel = any(word in ast.unparse(d) for d in node.decorator_list for word in ("njit", "vectorize"))
                first = min([first, *(d.lineno for d in node.decorator_list)])
            case ast.Assign(targets=targets):
                names = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
            case ast.AnnAssign(target=ast.Name(id=name)):
                names = [name]
            case _:
                pass
        for name in names:
            assert node.end_lineno is not None
            body = node.body[0].lineno if isinstance(node, ast.FunctionDef) else node.end_lineno + 1
            self.definitions[path, name] = Definition(path, name, first, node.end_lineno, function, kernel, body)

    def _link(self, path: str, tree: ast.Module, known: dict[str, ast.Module]) -> None:
        modules: dict[str, str] = {}
        names: dict[str, Name] = {one.name: (path, one.name) for one in self._in_file.get(path, ())}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                for alias in node.names:
                    inner = _file_of(f"{node.module}.{alias.name}", known)
                    outer = _file_of(node.module, known)
                    if inner:
                        modules[alias.asname or alias.name] = inner
                    elif outer:
                        names[alias.asname or alias.name] = (outer, alias.name)
            elif isinstance(node, ast.Import):
                for alias in node.names:
                    inner = _file_of(alias.name, known)
                    if inner:
                        modules[alias.asname or alias.name] = inner
        for top in tree.body:
            users = [one for one in self._named_by(path, top) if one in self.definitions]
            if not users:
                continue
            used: set[Name] = set()
            for node in ast.walk(top):
                if isinstance(node, ast.Name) and node.id in names:
                    used.add(names[node.id])
                elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
                    used.add((modules[node.value.id], node.attr))
            for user in users:
                self.definitions[user].uses |= (used & self.definitions.keys()) - {user}

    @staticmethod
    def _named_by(path: str, node: ast.stmt) -> list[Name]:
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                return [(path, name)]
            case ast.Assign(targets=targets):
                return [(path, n.id) for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
            case ast.AnnAssign(target=ast.Name(id=name)):
                return [(path, name)]
            case _:
                return []


def _file_of(module: str, known: dict[str, ast.Module]) -> str | None:
    path = module.replace(".", "/")
    return next((one for one in (f"{path}.py", f"{path}/__init__.py") if one in known), None)
