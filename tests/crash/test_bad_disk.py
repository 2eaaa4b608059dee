"""A disk that refuses any one call, or all calls from one on: one clear error, the old or the new, nothing half visible, nothing lost."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from appliance.calibrate.calibrations import Calibrations
from appliance.calibrate.guide import USED, AdjustmentSummary, RecordingCheck, Session
from appliance.calibrate.health import HealthFile, HealthTrend
from appliance.instrument.machine.choices import Choices
from appliance.instrument.service.remembered import ChoicesFile
from appliance.measure.light.exposure import Exposure
from appliance.store import names
from appliance.store.atomic import FileSystem, LocalFileSystem, StorageError
from appliance.store.instrument import load_calibration
from appliance.store.library import Library, LibraryFolder, PendingScan
from appliance.store.room import Room
from tests.appliance.store import scenes
from tests.appliance.store.scenes import ORIGIN, BadDisk, cloud, frames, record
from tests.crash.life import HASH, NEW, OLD, SERIAL


def prepared(root: Path) -> Path:
    Library(root).prepare()
    Room(root, LocalFileSystem()).hold(scenes.PLAN)
    return root


def on_a(disk: BadDisk, root: Path) -> Library:
    """Its scans are written into allocated space, as on the instrument."""
    return Library(root, Room(root, disk))


class Save:
    """The steps of a save: rejected, kept, or kept with a second exposure; ``go`` resumes where it was ended."""

    def __init__(self, library: Library, kind: str = "kept") -> None:
        self.scan_id = ""
        self._work = self._steps(library, kind)
        self._next: Callable[[], object] | None = next(self._work)

    def _steps(self, library: Library, kind: str) -> Iterator[Callable[[], object]]:
        begun: list[PendingScan] = []
        yield lambda: begun.append(library.begin(frames(), record(), ORIGIN))
        (scan,) = begun
        self.scan_id = scan.scan_id
        told = record(second=scenes.second_sequence()) if kind == "second" else record()
        if kind == "second":
            yield lambda: scan.add_second(frames(2), told)
        yield (
            (lambda: scan.reject("moved"))
            if kind == "rejected"
            else lambda: scan.publish(told, cloud(), scenes.PREVIEW)
        )

    def go(self) -> str:
        while self._next is not None:
            self._next()
            self._next = next(self._work, None)
        return self.scan_id


def calls_of(root: Path, kind: str = "kept") -> list[str]:
    disk = BadDisk()
    Save(on_a(disk, prepared(root)), kind).go()
    return disk.calls


def nothing_half_is_visible(root: Path) -> None:
    for shelf in (LibraryFolder.SCANS, LibraryFolder.REJECTED):
        for entry in Library(root).entries(shelf):
            assert Library(root).verify(entry.scan_id).problems == ()


@pytest.mark.parametrize(
    ("error", "kind"), [(errno.EIO, "kept"), (errno.ENOSPC, "kept"), (errno.EIO, "rejected"), (errno.EIO, "second")]
)
def test_each_call_of_a_save_fails_once_and_trying_again_succeeds(tmp_path: Path, error: int, kind: str) -> None:
    calls = calls_of(tmp_path / "count", kind)
    assert sum(name.startswith("sync") for name in calls) >= 8
    shelf = LibraryFolder.REJECTED if kind == "rejected" else LibraryFolder.SCANS
    for bad in range(len(calls)):
        root = prepared(tmp_path / f"{bad}")
        save = Save(on_a(BadDisk(bad, error=error), root), kind)
        failures = 0
        with suppress(StorageError):
            failures = 1
            save.go()
            failures = 0
        nothing_half_is_visible(root)
        # A folder that cannot grow is given the room's slack.
        helped = error == errno.ENOSPC and calls[bad].split()[0] in ("rename", "create", "make_folder")
        assert failures == (0 if helped else 1), calls[bad]
        scan_id, fresh = save.go(), Library(root)
        assert fresh.recover().failed == ()
        assert fresh.verify(scan_id).ok
        stored = fresh.load(scan_id)
        assert (stored.frames["left"] == frames()["left"]).all()
        assert ((stored.cloud() is None), (stored.second is not None)) == (kind == "rejected", kind == "second")
        found = [entry.scan_id for one in (LibraryFolder.SCANS, LibraryFolder.REJECTED) for entry in fresh.entries(one)]
        assert found == [entry.scan_id for entry in fresh.entries(shelf)] == [scan_id]


def test_a_disk_that_dies_for_good_at_each_call_keeps_what_was_there_and_shows_nothing_half(tmp_path: Path) -> None:
    calls = calls_of(tmp_path / "count")
    for bad in range(len(calls)):
        root = prepared(tmp_path / f"dead-{bad}")
        first = Save(Library(root)).go()
        with pytest.raises(StorageError):
            Save(on_a(BadDisk(bad, bad_for=10**6), root)).go()
        nothing_half_is_visible(root)
        fresh = Library(root)
        assert fresh.recover().failed == ()
        nothing_half_is_visible(root)
        assert fresh.verify(first).ok
        assert int(Save(fresh).go()) > int(first)


def test_each_call_of_a_recovery_fails_once_and_the_next_start_completes_it(tmp_path: Path) -> None:
    def unfinished(root: Path) -> Path:
        library = Library(prepared(root))
        library.begin(frames(1), record(), ORIGIN)
        (library.begin(frames(2), record(), ORIGIN).folder / "frames_left.npy").write_bytes(b"half")
        return root

    disk = BadDisk()
    Library(unfinished(tmp_path / "count"), disk).recover()
    for bad in range(len(disk.calls)):
        root = unfinished(tmp_path / f"recover-{bad}")
        first = Library(root, BadDisk(bad)).recover()
        (failed,) = first.failed
        assert "00000" in failed, disk.calls[bad]
        assert len(first.recovered) + len(first.set_aside) == 1, "one that cannot be moved keeps no other back"
        second = Library(root).recover()
        assert second.failed == ()
        assert [entry.scan_id for entry in Library(root).entries()] == ["000001"]
        assert [entry.scan_id for entry in Library(root).entries(LibraryFolder.SET_ASIDE)] == ["000002"]
        assert Library(root).verify("000001").ok


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
    store = Calibrations(root, SERIAL)
    session, found = store.session(), load_calibration(store.current).hash
    if session.solved is not None:
        assert session.in_use == (found == NEW.hash)
    if session.in_use:  # and there is a way back
        store.restore()
        assert load_calibration(store.current).hash == OLD.hash
        store.use_solved("2026-11-21")
    return found


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


@pytest.mark.parametrize(("error", "bad_for"), [(errno.EIO, 1), (errno.EROFS, 10**6)], ids=["once", "from then on"])
@pytest.mark.parametrize("name", DEEDS)
def test_a_refusal_leaves_old_or_new_and_a_retry_works(tmp_path: Path, name: str, error: int, bad_for: int) -> None:
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
            deed.do(BadDisk(bad, bad_for, error), root)
        assert str(root) in str(caught.value), "which file"
        assert caught.value.reason.startswith("injected"), "and why"
        assert deed.read(root) in (before, after), disk.calls[bad]
        deed.do(LocalFileSystem(), root)
        assert deed.read(root) == after, disk.calls[bad]


def test_each_call_refused_while_counting_gives_no_number_twice(tmp_path: Path) -> None:
    disk = BadDisk()
    names.take_number(disk, tmp_path, [])
    given = [1]
    for bad in range(len(disk.calls)):
        with pytest.raises(StorageError):
            given.append(names.take_number(BadDisk(bad), tmp_path, []))
        given.append(names.take_number(LocalFileSystem(), tmp_path, []))
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
        assert scenes.manifests_that_list_what_is_not_there(root) == [], left
    assert stopped == 5
    assert left == []
