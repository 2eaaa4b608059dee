"""A disk that refuses any one call of anything that is remembered: one clear error, the old or the new, and a retry works."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from appliance.calibration import file as calibration_file
from appliance.calibration.guide import USED, AdjustmentSummary, RecordingCheck, Session
from appliance.calibration.health import HealthTrend
from appliance.machine.choices import Choices
from appliance.scan.exposure import Exposure
from appliance.storage import counter
from appliance.storage.atomic import StorageError
from appliance.storage.calibrations import Calibrations
from appliance.storage.choices import ChoicesFile
from appliance.storage.filesystem import FileSystem, LocalFileSystem
from appliance.storage.health import HealthFile
from appliance.storage.library import Library
from tests.appliance.storage.scenes import ORIGIN, BadDisk, cloud, frames, manifests_that_list_what_is_not_there, record
from tests.crash.life import HASH, NEW, OLD, SERIAL

STANDARD = Choices()
CHOSEN = Choices(Exposure(8000, 6.0), 32, 35.0, 12.5)
SESSION = Session((RecordingCheck(USED[0], None, 0.03, 900, "bar", "000001"),))


@dataclass(frozen=True)
class Deed:
    """Something that is written: what goes before it, the deed, and what is read afterwards."""

    prepare: Callable[[Path], object]
    do: Callable[[FileSystem, Path], object]
    read: Callable[[Path], object]


def with_solution(root: Path) -> None:
    store = Calibrations(root, SERIAL)
    store.install(OLD, "2026-11-20")
    session = store.write(SESSION)
    store.write_solved(NEW, replace(session, solved=AdjustmentSummary(NEW.method, 0.03, (), NEW.hash)))


def in_use(root: Path) -> str:
    return calibration_file.load(Calibrations(root, SERIAL).current).hash


def accept(fs: FileSystem, root: Path) -> None:
    """A recording of a calibration: published, and only then entered into the session."""
    library = Library(root, fs)
    scan = library.begin(frames(), record(), ORIGIN)
    scan.publish(record(), cloud())
    Calibrations(root, SERIAL, fs).write(replace(SESSION, trials=(replace(SESSION.trials[0], scan_id=scan.scan_id),)))


def accepted(root: Path) -> bool:
    """Whether the session speaks of a scan; one that it speaks of must be there and whole."""
    trials = Calibrations(root, SERIAL).session().trials
    for check in trials:
        assert check.scan_id is not None
        assert Library(root).verify(check.scan_id).ok
    return bool(trials)


DEEDS = {
    "choices": Deed(
        lambda root: ChoicesFile(root, STANDARD).write(STANDARD),
        lambda fs, root: ChoicesFile(root, STANDARD, fs).write(CHOSEN),
        lambda root: ChoicesFile(root, STANDARD).read(),
    ),
    "health": Deed(
        lambda root: HealthFile(root, HASH).write(HealthTrend(judged=1)),
        lambda fs, root: HealthFile(root, HASH, fs).write(HealthTrend(judged=2)),
        lambda root: HealthFile(root, HASH).read().judged,
    ),
    "install": Deed(
        lambda root: Calibrations(root, SERIAL).install(OLD, "2026-11-20"),
        lambda fs, root: Calibrations(root, SERIAL, fs).install(NEW, "2026-11-21"),
        in_use,
    ),
    "use": Deed(with_solution, lambda fs, root: Calibrations(root, SERIAL, fs).use_solved("2026-11-21"), in_use),
    "session": Deed(
        lambda root: None,
        lambda fs, root: Calibrations(root, SERIAL, fs).write(SESSION),
        lambda root: Calibrations(root, SERIAL).session(),
    ),
    "accept": Deed(lambda root: Library(root).prepare(), accept, accepted),
}


def root_of(folder: Path, deed: Deed) -> Path:
    folder.mkdir()
    deed.prepare(folder)
    return folder


@pytest.mark.parametrize("error", [errno.EIO, errno.EROFS], ids=errno.errorcode.get)
@pytest.mark.parametrize("name", DEEDS)
def test_each_call_refused_leaves_the_old_or_the_new_and_a_retry_works(tmp_path: Path, name: str, error: int) -> None:
    deed = DEEDS[name]
    root = root_of(tmp_path / "whole", deed)
    before = deed.read(root)
    disk = BadDisk()
    deed.do(disk, root)
    after = deed.read(root)
    assert after != before
    assert len(disk.calls) >= 4
    for bad in range(len(disk.calls)):
        root = root_of(tmp_path / f"{bad}", deed)
        with pytest.raises(StorageError) as caught:
            deed.do(BadDisk(bad, error=error), root)
        assert str(root) in str(caught.value), "which file"
        assert caught.value.reason.startswith("injected"), "and why"
        assert deed.read(root) in (before, after), disk.calls[bad]
        deed.do(LocalFileSystem(), root)
        assert deed.read(root) == after, disk.calls[bad]


def test_each_call_refused_while_counting_gives_no_number_twice(tmp_path: Path) -> None:
    disk = BadDisk()
    counter.take(disk, tmp_path, [])
    given = [1]
    for bad in range(len(disk.calls)):
        with pytest.raises(StorageError):
            given.append(counter.take(BadDisk(bad), tmp_path, []))
        given.append(counter.take(LocalFileSystem(), tmp_path, []))
    assert len(given) == len(set(given))
    assert given == sorted(given)


def test_a_write_that_takes_only_a_part_goes_on_with_the_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the kernel does when a signal comes, or the disk is nearly full."""
    whole = os.write
    monkeypatch.setattr(os, "write", lambda fd, data: whole(fd, memoryview(data)[: max(1, len(data) // 3)]))
    library = Library(tmp_path)
    library.prepare()
    scan = library.begin(frames(), record(), ORIGIN)
    scan.publish(record(), cloud())
    monkeypatch.undo()
    assert library.verify(scan.scan_id).ok


class DyingDisk(BadDisk):
    """It refuses to make the new scan's name durable, and after so many removals to remove anything."""

    def __init__(self, removals: int) -> None:
        super().__init__()
        self.removals = removals

    def before(self, call: str) -> None:
        super().before(call)
        removed = sum(call.startswith("remove") for call in self.calls)
        if call == "sync_folder scans" or removed > self.removals:
            raise OSError(errno.EIO, f"injected ({call})")


def test_half_a_discard_never_leaves_a_manifest_that_lists_missing_frames(tmp_path: Path) -> None:
    """The frames are still in memory; what stays of them on the disk must not look like a scan that lost its frames."""
    stopped = 0
    for removals in range(7):
        root = tmp_path / str(removals)
        Library(root).prepare()
        with pytest.raises(StorageError, match="cannot make durable"):
            Library(root, DyingDisk(removals)).begin(frames(), record(), ORIGIN)
        left = sorted(path.name for path in (root / "scans").glob(".*/*"))
        stopped += bool(left)
        assert manifests_that_list_what_is_not_there(root) == [], left
    assert stopped == 5
    assert left == []
