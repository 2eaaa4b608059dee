"""Owns how any writer of files is judged by what a loss of power may leave: seen at its system calls, whatever it writes with.

The book is that of ``tests.appliance.store.volatile``. It is kept by watching the functions of Python's ``os`` and ``io`` modules, so
that a writer needs no port for it; what a library writes from C is found where it is synced or renamed, and counts as lost until then.
"""

from __future__ import annotations

import builtins
import io
import os
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from tests.appliance.store.volatile import Fate, VolatileDisk, _Change, _Node

State = Mapping[str, bytes | None]
"""Files by their path below the root; ``None`` for a folder."""
_CREATING = frozenset("wax+")
_OPEN, _IO_OPEN, _RENAME, _FSYNC = os.open, io.open, os.rename, os.fsync


@dataclass(slots=True)
class Seen:
    """Everything that was seen of a piece of work."""

    states: list[State] = field(default_factory=list)
    """What the power may leave, before each call and after the last; no two are the same."""
    final: list[State] = field(default_factory=list)
    """The same once the work has returned."""
    contents: dict[str, set[bytes | None]] = field(default_factory=dict)
    """What each file was, whole: before, when it got its name, and at the end."""
    published: list[tuple[str, frozenset[str]]] = field(default_factory=list)
    """Folders that got their name by a rename, and what was in them."""


def judge(root: Path, work: Callable[[], object], passing: Collection[str] = ()) -> Seen:
    """Do ``work`` below ``root`` and fail where a loss of power in any moment of it, or after it, could leave something half.

    At any moment a file under a name without a dot is what was there before or the new one, whole, and a folder that was published by a
    rename has all that is in it; once ``work`` has returned, all of it is there. ``passing``: names of folders and files that nobody
    looks at after a loss of power.
    """
    seen = Seen()

    def counts(path: str) -> bool:
        return not any(part.startswith(".") or part in passing for part in path.split("/"))

    before = _real(root)
    for path, data in before.items():
        seen.contents.setdefault(path, set()).add(data)
    book = WatchedDisk(root, seen)
    with pytest.MonkeyPatch.context() as patch:
        book.watch(patch)
        work()
    book.note(last=True)
    end = {path: data for path, data in _real(root).items() if counts(path)}
    for path, data in end.items():
        seen.contents.setdefault(path, set()).add(data)
    for state in seen.states:
        for path, data in state.items():
            if data is not None and counts(path):
                assert data in seen.contents.get(path, ()), (
                    f"{path} may be left half: {data[:40]!r} of {len(data)} bytes"
                )
        for folder, inside in seen.published:
            if folder in state and counts(folder):
                new = {f"{folder}/{name}" for name in inside} & end.keys()
                old = {name for name in before if name.startswith(f"{folder}/")}
                whole = new <= state.keys() or (folder in before and old <= state.keys())
                assert whole, f"{folder} may be left without {sorted(new - state.keys())}"
    for state in seen.final:
        lost = [path for path, data in end.items() if data is not None and state.get(path) != data]
        assert not lost, f"may be lost after it was told as written: {lost}"
    return seen


def _real(root: Path) -> dict[str, bytes | None]:
    """What lies below a folder now; a link is what it leads to."""
    found: dict[str, bytes | None] = {}
    for path in root.rglob("*"):
        name = path.relative_to(root).as_posix()
        found[name] = _led(path) if path.is_symlink() else None if path.is_dir() else path.read_bytes()
    return found


def _led(link: Path) -> bytes:
    return b"-> " + os.fsencode(link.readlink())


class WatchedDisk(VolatileDisk):
    """The book of all that this process asks of the disk below ``root``, and what each moment may leave."""

    def __init__(self, root: Path, seen: Seen) -> None:
        super().__init__(root)
        self._seen = seen
        self._noted: set[object] = set()
        self._adopt(root, self._top)

    def _adopt(self, path: Path, node: _Node) -> None:
        """What lies there before was written long ago."""
        for child in path.iterdir():
            folder = child.is_dir() and not child.is_symlink()
            data = b"" if folder else _led(child) if child.is_symlink() else child.read_bytes()
            inside = _Node(folder, data, data)
            node.names[child.name] = node.durable_names[child.name] = inside
            if folder:
                self._adopt(child, inside)

    def note(self, *, last: bool = False) -> None:
        """Remember what the power may leave now."""
        for fate in self.fates():
            state = self._files(self._top, fate, "")
            if last:
                self._seen.final.append(state)
            key = frozenset(state.items())
            if key not in self._noted:
                self._noted.add(key)
                self._seen.states.append(state)

    def _files(self, folder: _Node, fate: Fate, above: str) -> dict[str, bytes | None]:
        found: dict[str, bytes | None] = {}
        for name, node in self._names(folder, fate).items():
            found[above + name] = None if node.folder else node.durable_data
            if node.folder:
                found |= self._files(node, fate, f"{above}{name}/")
        return found

    # ------------------------------------------------------------------------------------------ calls

    def watch(self, patch: pytest.MonkeyPatch) -> None:
        """Let every call that changes the disk be written down, after it was carried out."""
        for name in ("mkdir", "unlink", "remove", "rmdir", "symlink"):
            patch.setattr(os, name, self._watched(name, getattr(os, name)))
        for name in ("rename", "replace"):
            patch.setattr(os, name, self._renamed)
        patch.setattr(os, "open", self._opened)
        patch.setattr(os, "fsync", self._synced)
        patch.setattr(os, "fdatasync", self._synced)
        for where in (io, builtins):
            patch.setattr(where, "open", self._opened_by_python)

    def _inside(self, path: Any, folder: int | None = None) -> Path | None:
        """The path, absolute, if it lies below the root."""
        if isinstance(path, int):
            return None
        whole = Path(os.fsdecode(path))
        if folder is not None:
            whole = Path(f"/proc/self/fd/{folder}").readlink() / whole
        whole = whole.absolute()
        return whole if whole.is_relative_to(self._root) and whole != self._root else None

    def _known(self, path: Path) -> _Node:
        """The node of what lies there; what a library made without a word is entered now."""
        with suppress(KeyError):
            return self._node(path)
        self._known(path.parent) if path.parent != self._root else None
        return self._entered(path).node or _Node(folder=False)

    def _entered(self, path: Path) -> _Change:
        data = _led(path) if path.is_symlink() else b""
        return self._change(path, _Node(path.is_dir() and not path.is_symlink(), data, data))

    def _watched(self, name: str, real: Callable[..., None]) -> Callable[..., None]:
        def call(path: Any, *rest: Any, dir_fd: int | None = None, **more: Any) -> None:
            given = {} if dir_fd is None else {"dir_fd": dir_fd}
            real(path, *rest, **given, **more)
            changed = self._inside(rest[0] if name == "symlink" else path, dir_fd)
            if changed is None:
                return
            if name in ("mkdir", "symlink"):
                self._entered(changed)
            else:
                self._change(changed, None)
            self.note()

        return call

    def _renamed(self, source: Any, target: Any) -> None:
        old, new = self._inside(source), self._inside(target)
        _RENAME(source, target)
        if old is None or new is None:
            return
        try:
            node = self._node(old)
        except KeyError:  # a library made it
            node = _Node(new.is_dir() and not new.is_symlink())
            self._change(old, node)
        name = new.relative_to(self._root).as_posix()
        inside = {} if new.is_symlink() or not new.is_dir() else _real(new)
        for path, data in inside.items():
            self._seen.contents.setdefault(f"{name}/{path}", set()).add(data)
        if node.folder:
            self._seen.published.append((name, frozenset(inside)))
        else:
            content = _led(new) if new.is_symlink() else new.read_bytes()
            self._seen.contents.setdefault(name, set()).add(content)
        there = self._change(new, node)
        self._change(old, None, there)
        self.note()

    def _opened(self, path: Any, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
        file = self._inside(path, dir_fd)
        there = file is not None and os.path.lexists(file)
        descriptor = _OPEN(path, flags, mode, dir_fd=dir_fd)
        if file is not None:
            self._written(file, there, made=bool(flags & os.O_CREAT), emptied=bool(flags & os.O_TRUNC))
        return descriptor

    def _opened_by_python(self, path: Any, mode: str = "r", *rest: Any, **more: Any) -> Any:
        file = self._inside(path)
        there = file is not None and os.path.lexists(file)
        opened = _IO_OPEN(path, mode, *rest, **more)
        if file is not None and _CREATING & set(mode):
            self._written(file, there, made=True, emptied="w" in mode)
        return opened

    def _written(self, file: Path, there: bool, *, made: bool, emptied: bool) -> None:
        if made and not there:
            self._known(file)
        elif emptied:
            self._known(file).durable_data = b""  # the worst of what may have reached the disk
        self.note()

    def _synced(self, descriptor: int) -> None:
        _FSYNC(descriptor)
        path = self._inside(Path(f"/proc/self/fd/{descriptor}").readlink())
        if path is None and Path(f"/proc/self/fd/{descriptor}").readlink() != self._root:
            return
        node = self._top if path is None else self._known(path)
        if node.folder:
            self._sync_names(node)
        elif path is not None:
            with _IO_OPEN(path, "rb") as file:
                node.durable_data = file.read()
        self.note()
