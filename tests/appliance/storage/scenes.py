"""Small scans and disks that fail: what the storage tests share."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.capture.verdict import Verdict
from appliance.storage.filesystem import Bytes, LocalFileSystem, WritableFile
from appliance.storage.ply import StoredCloud
from appliance.storage.record import ScanRecord, SequenceInfo
from appliance.storage.room import plan
from appliance.storage.scan import Origin

FRAMES = 3


def frames(seed: int = 0) -> dict[str, NDArray[np.uint8]]:
    chance = np.random.default_rng(seed)
    return {side: chance.integers(0, 256, (FRAMES, 8, 10), np.uint8) for side in ("left", "right")}


def record(**changes: object) -> ScanRecord:
    values: dict[str, object] = {
        "sequence": SequenceInfo(16, 1024, 768, ("bright", "dark", "gray-x-0")),
        "rig_hash": "ab" * 32,
        "calibration_hash": None,
        "software_version": "0.1.0",
        "wall_time": "2031-05-06T07:08:09+00:00",
        "clock_trusted": False,
        "recorded_ns": 123456789,
        "water": {"salinity_psu": 0.0, "index": 1.3347},
        "temperatures_c": {"case": None, "projector": 41.5},
        "ledger": {"flips": [{"sequence": 1, "time_ns": 2**60}]},
        "verdicts": (Verdict("motion", True, {"shift_px": 0.25}),),
        "stage_times_s": {"capture": 0.4},
    }
    return ScanRecord(**{**values, **changes})  # type: ignore[arg-type]


PLAN = {name: min(length, 20_000) for name, length in plan(1000, 10_000).items()}
"""Of the room for one of these scans."""


def cloud(points: int = 20, seed: int = 0) -> StoredCloud:
    chance = np.random.default_rng(seed)
    return StoredCloud(
        chance.normal(0, 100, (points, 3)).astype(np.float32),
        chance.integers(0, 256, points, np.uint8),
        chance.random(points, np.float32) * np.float32(100),
        chance.random(points, np.float32) / np.float32(50),
        chance.random(points, np.float32) / np.float32(30),
    )


ORIGIN = Origin(b'{"a": "calibration"}\n' * 40, b"[rig]\n" * 200)
PREVIEW = b"\x89PNG\r\n\x1a\n" + bytes(50)


# --------------------------------------------------------------------------------------- a bad disk


class BadDisk(LocalFileSystem):
    """The local disk; changing calls number ``first_bad`` and ``bad_for - 1`` after it fail with ``error``."""

    def __init__(self, first_bad: int | None = None, bad_for: int = 1, error: int = errno.EIO) -> None:
        self.calls: list[str] = []
        self._first = first_bad
        self._for = bad_for
        self._error = error

    def _count(self, name: str) -> None:
        index = len(self.calls)
        self.calls.append(name)
        if self._first is not None and self._first <= index < self._first + self._for:
            raise OSError(self._error, f"injected at call {index} ({name})")

    def make_folder(self, path: Path) -> None:
        self._count(f"make_folder {path.name}")
        super().make_folder(path)

    def create(self, path: Path) -> WritableFile:
        self._count(f"create {path.name}")
        return _BadFile(self, super().create(path), path.name)

    def rename(self, source: Path, target: Path) -> None:
        self._count(f"rename {source.name} {target.name}")
        super().rename(source, target)

    def allocate(self, path: Path, length_bytes: int) -> None:
        self._count(f"allocate {path.name}")
        super().allocate(path, length_bytes)

    def reopen(self, path: Path) -> WritableFile:
        self._count(f"reopen {path.name}")
        return _BadFile(self, super().reopen(path), path.name)

    def sync_folder(self, path: Path) -> None:
        self._count(f"sync_folder {path.name}")
        super().sync_folder(path)

    def remove(self, path: Path) -> None:
        self._count(f"remove {path.name}")
        super().remove(path)


class _BadFile:
    def __init__(self, disk: BadDisk, file: WritableFile, name: str) -> None:
        self._disk, self._file, self._name = disk, file, name

    def write(self, data: Bytes) -> None:
        half = len(data) // 2
        try:
            self._disk._count(f"write {self._name}")
        except OSError:
            self._file.write(memoryview(data)[:half])
            raise
        self._file.write(data)

    def sync(self) -> None:
        self._disk._count(f"sync {self._name}")
        self._file.sync()

    def close(self) -> None:
        self._file.close()
        self._disk._count(f"close {self._name}")


# ----------------------------------------------------------------------------------- a loss of power


class PowerCut(BaseException):
    """The power went: no handler may run as if it were an error of the disk."""


@dataclass
class _Node:
    """A file or a folder, with what would be found after a loss of power."""

    folder: bool
    data: bytes = b""
    durable_data: bytes = b""
    names: dict[str, _Node] = field(default_factory=dict)
    durable_names: dict[str, _Node] = field(default_factory=dict)


class VolatileDisk(LocalFileSystem):
    """The local disk, with a book of what was made durable; the power goes before changing call ``cut_at``.

    ``survivors`` then builds the worst disk that the calls so far allow: data that was not fsynced is gone; names
    that were not are gone as well, or all there (``names_survive``), as a journal may have written them early.
    """

    def __init__(self, root: Path, cut_at: int | None = None) -> None:
        self.calls = 0
        self._cut_at = cut_at
        self._root = root
        self._top = _Node(folder=True)

    def _count(self) -> None:
        if self.calls == self._cut_at:
            raise PowerCut
        self.calls += 1

    def _node(self, path: Path) -> _Node:
        node = self._top
        for part in path.relative_to(self._root).parts:
            node = node.names[part]
        return node

    def make_folder(self, path: Path) -> None:
        self._count()
        super().make_folder(path)
        self._node(path.parent).names[path.name] = _Node(folder=True)

    def create(self, path: Path) -> WritableFile:
        self._count()
        real = super().create(path)
        node = self._node(path.parent).names[path.name] = _Node(folder=False)
        return _VolatileFile(self, real, node)

    def allocate(self, path: Path, length_bytes: int) -> None:
        self._count()
        super().allocate(path, length_bytes)
        # What an earlier file left in those blocks may be found there.
        self._node(path.parent).names[path.name] = _Node(folder=False, durable_data=b"\x5a" * length_bytes)

    def reopen(self, path: Path) -> WritableFile:
        self._count()
        return _VolatileFile(self, super().reopen(path), self._node(path))

    def rename(self, source: Path, target: Path) -> None:
        self._count()
        super().rename(source, target)
        self._node(target.parent).names[target.name] = self._node(source.parent).names.pop(source.name)

    def sync_folder(self, path: Path) -> None:
        self._count()
        super().sync_folder(path)
        node = self._node(path)
        node.durable_names = dict(node.names)

    def remove(self, path: Path) -> None:
        self._count()
        super().remove(path)
        del self._node(path.parent).names[path.name]

    def survivors(self, target: Path, *, names_survive: bool) -> Path:
        """Write what is left after the loss of power to ``target``."""
        shutil.rmtree(target, ignore_errors=True)
        target.mkdir()
        self._write(self._top, target, names_survive)
        return target

    def _write(self, node: _Node, path: Path, names_survive: bool) -> None:
        names: Mapping[str, _Node] = node.names if names_survive else node.durable_names
        for name, child in names.items():
            if child.folder:
                (path / name).mkdir()
                self._write(child, path / name, names_survive)
            else:
                (path / name).write_bytes(child.durable_data)


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
