"""Small scans and disks that fail: what the storage tests share."""

from __future__ import annotations

import errno
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.scan.exposure import Exposure
from appliance.scan.verdict import Verdict
from appliance.storage import manifest as form
from appliance.storage import scan
from appliance.storage.filesystem import Bytes, LocalFileSystem, WritableFile
from appliance.storage.library import LibraryFolder
from appliance.storage.manifest import ManifestError
from appliance.storage.ply import StoredCloud
from appliance.storage.record import ScanRecord, SecondSequence, SequenceInfo
from appliance.storage.room import plan
from appliance.storage.scan import ScanOrigin

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


def second_sequence() -> SecondSequence:
    """What a record tells of a second exposure."""
    weak = Verdict("light", True, {"weak_percent": 1.5})
    return SecondSequence(Exposure(14_000), 99, {"case": 31.0}, {"flips": [{"sequence": 5}]}, (weak,))


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


ORIGIN = ScanOrigin(b'{"a": "calibration"}\n' * 40, b"[rig]\n" * 200)
PREVIEW = b"\x89PNG\r\n\x1a\n" + bytes(50)


def manifests_that_list_what_is_not_there(root: Path) -> list[str]:
    """Folders of scans, finished or not, in which a readable manifest names a file that is missing or cut short."""
    wrong = []
    for folder in [folder for shelf in LibraryFolder for folder in (root / shelf.value).glob("*")]:
        try:
            manifest = form.read(folder)
        except ManifestError:
            continue
        wrong += [f"{folder.name}: {found}" for found in scan.wrong_files(folder, manifest, checksums=True).items()]
    return wrong


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

    def append(self, path: Path) -> WritableFile:
        self._count(f"append {path.name}")
        return _BadFile(self, super().append(path), path.name)

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
