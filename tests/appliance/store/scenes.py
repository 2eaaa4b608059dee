"""Small scans and disks that fail: what the storage tests share."""

from __future__ import annotations

import errno
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.base.sealed_file import ContentError
from appliance.measure.light.exposure import Exposure
from appliance.measure.verdict import Verdict
from appliance.store import manifest as form
from appliance.store import scan
from appliance.store.atomic import Bytes, LocalFileSystem, WritableFile
from appliance.store.library import LibraryFolder
from appliance.store.manifest import ScanRecord, SecondSequence, SequenceInfo
from appliance.store.ply import StoredCloud
from appliance.store.room import Room
from appliance.store.scan import ScanOrigin
from tests.support.sealing import sealed

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


PLAN = {name: min(length, 20_000) for name, length in Room.plan(1, 40, 25).items()}
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


def padded(content: dict[str, object], length: int) -> bytes:
    """A sealed file of that length, of which some is white space."""
    data = sealed(content)
    assert len(data) <= length
    return data[:-2] + b" " * (length - len(data)) + data[-2:]


def manifests_that_list_what_is_not_there(root: Path) -> list[str]:
    """Folders of scans, finished or not, in which a readable manifest names a file that is missing or cut short."""
    wrong = []
    for folder in [folder for shelf in LibraryFolder for folder in (root / shelf.value).glob("*")]:
        try:
            manifest = form.read(folder)
        except ContentError:
            continue
        wrong += [f"{folder.name}: {found}" for found in scan.wrong_files(folder, manifest, checksums=True).items()]
    return wrong


class SoFull(LocalFileSystem):
    """A disk that says that so many bytes are free."""

    def __init__(self, free: int) -> None:
        self.free = free

    def free_bytes(self, path: Path) -> int:
        return self.free


class CountedDisk(LocalFileSystem):
    """The local disk; ``before`` is asked before each call that changes it, and may raise."""

    def before(self, call: str) -> None:
        """``call`` names what is done and the file."""

    def write(self, file: WritableFile, data: Bytes, name: str) -> None:
        self.before(f"write {name}")
        file.write(data)

    def make_folder(self, path: Path) -> None:
        self.before(f"make_folder {path.name}")
        super().make_folder(path)

    def create(self, path: Path) -> WritableFile:
        self.before(f"create {path.name}")
        return _CountedFile(self, super().create(path), path.name)

    def rename(self, source: Path, target: Path) -> None:
        self.before(f"rename {source.name} {target.name}")
        super().rename(source, target)

    def allocate(self, path: Path, length_bytes: int) -> None:
        self.before(f"allocate {path.name}")
        super().allocate(path, length_bytes)

    def reopen(self, path: Path) -> WritableFile:
        self.before(f"reopen {path.name}")
        return _CountedFile(self, super().reopen(path), path.name)

    def append(self, path: Path) -> WritableFile:
        self.before(f"append {path.name}")
        return _CountedFile(self, super().append(path), path.name)

    def sync_folder(self, path: Path) -> None:
        self.before(f"sync_folder {path.name}")
        super().sync_folder(path)

    def remove(self, path: Path) -> None:
        self.before(f"remove {path.name}")
        super().remove(path)


class _CountedFile:
    def __init__(self, disk: CountedDisk, file: WritableFile, name: str) -> None:
        self._disk, self._file, self._name = disk, file, name

    def write(self, data: Bytes) -> None:
        self._disk.write(self._file, data, self._name)

    def sync(self) -> None:
        self._disk.before(f"sync {self._name}")
        self._file.sync()

    def close(self) -> None:
        self._file.close()
        self._disk.before(f"close {self._name}")


class BadDisk(CountedDisk):
    """Changing calls number ``first_bad`` and ``bad_for - 1`` after it fail with ``error``; a write is half done then."""

    def __init__(self, first_bad: int | None = None, bad_for: int = 1, error: int = errno.EIO) -> None:
        self.calls: list[str] = []
        self._bad = range(0) if first_bad is None else range(first_bad, first_bad + bad_for)
        self._error = error

    def before(self, call: str) -> None:
        self.calls.append(call)
        if len(self.calls) - 1 in self._bad:
            raise OSError(self._error, f"injected at call {len(self.calls) - 1} ({call})")

    def write(self, file: WritableFile, data: Bytes, name: str) -> None:
        if len(self.calls) in self._bad:
            file.write(memoryview(data)[: len(data) // 2])
        super().write(file, data, name)
