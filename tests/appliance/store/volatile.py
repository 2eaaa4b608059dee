"""Owns what may be found on a disk after a loss of power: every state that the calls before it allow.

Content that was not synced is gone. Of the changes of names that were not, any subset may have reached the disk, for a file
system writes them when it likes, under two rules only: changes of one name keep their order, and a rename never takes the old
name away before the new one is there (rule 3 of soft updates, Ganger and Patt 1994; a journal keeps it as well). Between the
two a file has both names, also when they are in different folders.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain, combinations
from pathlib import Path

from appliance.store.atomic import Bytes, LocalFileSystem, WritableFile

FEW = 4
"""Up to so many changes of names that are not durable, every subset is tried."""
LATEST = 2
"""Of more: each of so many of the latest alone and left out."""
RUBBISH = b"\x5a"
"""What an earlier file left in blocks that were allocated anew."""


class PowerCut(BaseException):
    """The power went: no handler may run as if it were an error of the disk."""


@dataclass(eq=False)
class _Node:
    """A file or a folder, with what would be found after a loss of power."""

    folder: bool
    data: bytes = b""
    durable_data: bytes = b""
    names: dict[str, _Node] = field(default_factory=dict)
    durable_names: dict[str, _Node] = field(default_factory=dict)


@dataclass(eq=False)
class _Change:
    """A name in a folder becomes another node, or goes (``None``); ``after``: changes without which it cannot be found."""

    folder: _Node
    name: str
    node: _Node | None
    after: tuple[_Change, ...]
    number: int

    def apply(self, names: dict[str, _Node]) -> None:
        if self.node is None:
            names.pop(self.name, None)
        else:
            names[self.name] = self.node


Fate = frozenset[_Change]
"""The changes that survive."""
Tree = tuple[tuple[str, object], ...]


class HastyDisk(LocalFileSystem):
    """The local disk for those who look at nothing but what is written: it waits for no platter."""

    def create(self, path: Path) -> WritableFile:
        return _HastyFile(path, super().create(path))

    def reopen(self, path: Path) -> WritableFile:
        return _HastyFile(path, super().reopen(path))

    def sync_folder(self, path: Path) -> None:
        pass


class _HastyFile:
    def __init__(self, path: Path, file: WritableFile) -> None:
        self._path, self._file, self._written = path, file, 0

    def write(self, data: Bytes) -> None:
        self._file.write(data)
        self._written += len(data)

    def sync(self) -> None:
        os.truncate(self._path, self._written)

    def close(self) -> None:
        self._file.close()


class VolatileDisk(HastyDisk):
    """The local disk, with a book of what was made durable; the power goes before changing call ``cut_at``.

    ``fates`` are the states that may be left, ``survivors`` writes one of them.
    """

    def __init__(self, root: Path, cut_at: int | None = None) -> None:
        self.calls = 0
        self.cut_at = cut_at
        self._root = root
        self._top = _Node(folder=True)
        self._pending: list[_Change] = []
        self._changes = 0

    def _count(self) -> None:
        if self.calls == self.cut_at:
            raise PowerCut
        self.calls += 1

    def _node(self, path: Path) -> _Node:
        node = self._top
        for part in path.relative_to(self._root).parts:
            node = node.names[part]
        return node

    def _change(self, path: Path, node: _Node | None, *needed: _Change) -> _Change:
        folder = self._node(path.parent)
        earlier = [one for one in self._pending if one.folder is folder and one.name == path.name]
        change = _Change(folder, path.name, node, (*earlier[-1:], *needed), self._changes)
        self._changes += 1
        self._pending.append(change)
        change.apply(folder.names)
        return change

    def make_folder(self, path: Path) -> None:
        self._count()
        super().make_folder(path)
        self._change(path, _Node(folder=True))

    def create(self, path: Path) -> WritableFile:
        self._count()
        real = super().create(path)
        node = _Node(folder=False)
        self._change(path, node)
        return _VolatileFile(self, real, node)

    def allocate(self, path: Path, length_bytes: int) -> None:
        self._count()
        super().allocate(path, length_bytes)
        self._change(path, _Node(folder=False, durable_data=RUBBISH * length_bytes))

    def reopen(self, path: Path) -> WritableFile:
        self._count()
        node = self._node(path)
        node.data = b""
        return _VolatileFile(self, super().reopen(path), node)

    def rename(self, source: Path, target: Path) -> None:
        self._count()
        super().rename(source, target)
        there = self._change(target, self._node(source))
        self._change(source, None, there)

    def sync_folder(self, path: Path) -> None:
        self._count()
        super().sync_folder(path)
        self._sync_names(self._node(path))

    def _sync_names(self, node: _Node) -> None:
        durable = self._closed(change for change in self._pending if change.folder is node)
        for change in sorted(durable, key=lambda one: one.number):
            change.apply(change.folder.durable_names)
        self._pending = [change for change in self._pending if change not in durable]

    def remove(self, path: Path) -> None:
        self._count()
        super().remove(path)
        self._change(path, None)

    def fates(self) -> Iterator[Fate]:
        """States that a loss of power may leave now, no two of which are the same on the disk: every one where few changes
        of names are not durable; of many none, all, each of the latest alone, and all but each of them."""
        pending, seen = self._pending, set()
        for chosen in self._chosen(pending):
            tree = self._tree(self._top, chosen, {})
            if tree not in seen:
                seen.add(tree)
                yield chosen

    def _chosen(self, pending: list[_Change]) -> Iterator[Fate]:
        if len(pending) <= FEW:
            subsets = chain.from_iterable(combinations(pending, size) for size in range(len(pending) + 1))
            yield from (frozenset(one) for one in subsets if self._closed(one) == frozenset(one))
            return
        yield frozenset()
        yield frozenset(pending)
        for one in pending[-LATEST:]:  # each was the latest once
            yield self._closed([one])
            yield frozenset(other for other in pending if one not in self._closed([other]))

    def _closed(self, chosen: Iterable[_Change]) -> Fate:
        """The changes, and all those without which they cannot be found."""
        found: set[_Change] = set()
        waiting = list(chosen)
        while waiting:
            change = waiting.pop()
            if change not in found and change in self._pending:
                found.add(change)
                waiting += change.after
        return frozenset(found)

    def state(self, fate: Fate) -> Tree:
        """What would be found, as a value: equal for the same names, contents and links."""
        return self._tree(self._top, fate, {})

    def _tree(self, folder: _Node, fate: Fate, numbers: dict[_Node, int]) -> Tree:
        found: list[tuple[str, object]] = []
        for name, node in sorted(self._names(folder, fate).items()):
            known = node in numbers
            number = numbers.setdefault(node, len(numbers))
            content = self._tree(node, fate, numbers) if node.folder else node.durable_data
            found.append((name, number if known and not node.folder else (number, node.folder, content)))
        return tuple(found)

    def _names(self, folder: _Node, fate: Fate) -> dict[str, _Node]:
        names = dict(folder.durable_names)
        for change in sorted(fate, key=lambda one: one.number):
            if change.folder is folder:
                change.apply(names)
        return names

    def survivors(self, target: Path, fate: Fate) -> Path:
        """Write what is left after the loss of power to ``target``; two names of one file are two links."""
        shutil.rmtree(target, ignore_errors=True)
        target.mkdir()
        self._write(self._top, target, fate, {})
        return target

    def _write(self, folder: _Node, path: Path, fate: Fate, written: dict[_Node, Path]) -> None:
        for name, node in self._names(folder, fate).items():
            if node.folder:  # a folder under two names: no file system takes a link, a repair leaves either
                (path / name).mkdir()
                self._write(node, path / name, fate, written)
            elif node in written:
                os.link(written[node], path / name)
            else:
                (path / name).write_bytes(node.durable_data)
                written[node] = path / name


class _VolatileFile:
    def __init__(self, disk: VolatileDisk, file: WritableFile, node: _Node) -> None:
        self._disk, self._file, self._node = disk, file, node

    def write(self, data: Bytes) -> None:
        self._disk._count()
        self._file.write(data)
        self._node.data += bytes(data)

    def sync(self) -> None:
        self._disk._count()
        self._file.sync()
        self._node.durable_data = self._node.data

    def close(self) -> None:
        self._file.close()
