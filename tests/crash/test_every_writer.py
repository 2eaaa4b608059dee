"""Whoever writes a file leaves the old or the new one whole when the power goes, and what was told as written is there afterwards.

Every writer is judged here: by its own order of calls where it makes one, else by that of the two rooms that own such an order for
all others, ``appliance.store.atomic`` and ``kingfisher_setup.durable``. A module that is new and writes otherwise is found by its source.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from appliance.calibrate.air.board import BoardDesign
from appliance.calibrate.calibrations import Calibrations
from appliance.calibrate.health import HealthFile, HealthTrend
from appliance.calibrate.pictures import ViewFolder
from appliance.cli.setup import _write as write_firmware
from appliance.desk.anew.results import Results
from appliance.desk.export.content import CAMERA_FRAME, Metadata
from appliance.desk.export.files import write_scan
from appliance.store import archive
from appliance.store import label as labels
from appliance.store import scan as stored
from appliance.store.atomic import LocalFileSystem
from appliance.store.incomplete import IncompleteRecording
from appliance.store.library import Library, LibraryFolder
from appliance.store.manifest import Decision
from appliance.store.pull.source import FolderSource
from appliance.store.room import Room
from appliance.store.scan import StoredScan
from kingfisher_setup import durable, versions
from kingfisher_transfer import serving
from tests.appliance.store.pull.instrument import instrument, pulled
from tests.appliance.store.scenes import ORIGIN, PLAN, PREVIEW, cloud, frames, record
from tests.support.power_loss import judge
from tests.support.solids import Ball, looking, seen
from tests.systemd.installation import make

FS = LocalFileSystem()
ROOT = Path(__file__).parents[2]
SCANS = (LibraryFolder.SCANS,)
ABOUT = Metadata("scan 000007", CAMERA_FRAME, ())
Writing = Iterator[None]
"""What lies there before, up to the yield; then the work, in whose middle the power goes."""


def scan_on(root: Path, number: str = "000001") -> Path:
    """A whole scan that lay there before."""
    folder = root / "scans" / number
    folder.parent.mkdir(parents=True, exist_ok=True)
    raw = stored.write_raw(FS, folder, number, frames(), record(), ORIGIN)
    stored.finish_scan(FS, folder, raw, Decision.KEPT, record(), cloud(), PREVIEW)
    return folder


def files(root: Path) -> Writing:
    (root / "old").write_bytes(b"of before")

    def library(path: Path) -> None:
        path.write_bytes(b"by a library")

    yield
    FS.replace_file(root / "old", b"new")
    FS.make_folders(root / "a" / "b")
    FS.replace_file(root / "a" / "b" / "new", b"one", b"two")
    FS.add_beside(root / "old", b"other")
    FS.add_beside(root / "c" / "old", b"other")
    FS.replace_by(root / "old", library)


def results(root: Path) -> Writing:
    yield
    made = Results.of(root / "out", {"program": "1"})
    made.publish_failure("000001-a", {"scan": "000001", "folder": "/x", "state": "failed"})
    made.publish("000002-a", {"scan": "000002", "folder": "/y", "state": "done"}, (b"points", b"!"))
    made.write_table([])


def packed(root: Path) -> Writing:
    source = scan_on(root / "source")
    (root / "source" / "calibration").mkdir()
    (root / "source" / "calibration" / "current.json").write_text("{}")
    yield
    archive.make_scan_folders(FS, root / "archive", SCANS)
    archive.copy_beside(FS, root / "source", root / "archive")
    target = root / "archive" / "scans" / "000001"
    archive.pack_scan(FS, source, target)
    archive.remove_source(FS, source, target)
    archive.make_scan_folders(FS, root / "back", SCANS)
    archive.unpack_scan(FS, target, root / "back" / "scans" / "000001")


def pulling(root: Path) -> Writing:
    there = instrument(root / ".disk")
    yield
    FS.make_folders(root / "desk")  # as the verb does it
    pulled(FolderSource(there), root / "desk")


def recordings(root: Path) -> Writing:
    """One that broke off, one of another rig, and views of a board."""
    (root / "data").mkdir()
    first, picture = {side: one[:2] for side, one in frames().items()}, np.zeros((4, 6), np.uint8)
    yield
    IncompleteRecording.keep(FS, root / "data", first, record(), ORIGIN, "the board fell silent", 0)
    StoredScan.keep(root / "foreign", frames(), record(), ORIGIN)
    folder = ViewFolder(root / "views", "KF-1", BoardDesign())
    folder.save(folder.next_name(), picture, picture)


def scans_and_labels(root: Path) -> Writing:
    room = Room(root / "data", FS)
    yield
    for fs in (FS, room):  # with and without space that was allocated before
        library = Library(root / "data", fs)
        library.prepare()
        scan = library.begin(frames(), record(), ORIGIN)
        scan.publish(record(), cloud(), PREVIEW)
        labels.Label("bollard 3").write(FS, root / "data" / "scans" / scan.scan_id)
        room.hold(PLAN)


def calibrations(root: Path) -> Writing:
    yield
    kept, health = Calibrations(root / "data", "KF-1"), HealthFile(root / "data", "ab" * 32)
    kept.write(kept.session())
    kept.begin()
    kept.write(kept.session())
    for judged in (1, 2):
        health.write(HealthTrend(judged=judged))


def exported(suffix: str, root: Path) -> Writing:
    ball = seen([Ball((3.0, -2.0, 0.0), 8.0)], looking((0.0, 0.0, -500.0)), 5, size_px=(24, 20), steepest=70.0)
    (root / f"scan{suffix}").write_bytes(b"of before")
    yield
    write_scan(root / f"scan{suffix}", ball, ABOUT)


def firmware(root: Path) -> Writing:
    (root / "board").mkdir()
    (root / "board" / "main.py").write_text("of before")
    yield
    write_firmware(root / "board", {"main.py": b"new", "lib/wire.py": b"new, too"})


def setup_files(root: Path) -> Writing:
    (root / "unit").write_text("of before")
    yield
    durable.write(root / "unit", b"new")
    durable.write(root / "etc" / "systemd" / "unit", b"in a folder that was not there")
    durable.point(root / "opt" / "current", "versions/new")
    durable.remove(root / "unit")


def version_on_trial(root: Path) -> Writing:
    there = make(root)
    yield
    versions.try_out(there.layout, "new")
    at = versions.settle(there.layout)
    assert at is not None
    versions.accept(there.layout, versions.started(there.layout, at))


def host_key(root: Path) -> Writing:
    yield
    serving.make_host_key(root / "state" / "key")


EXPORTS: dict[str, Callable[[Path], Writing]] = {
    f"export as {name}": partial(exported, f".{name}")
    for name in ("ply", "e57")  # ours, and a library's in C
}
WRITERS: dict[str, Callable[[Path], Writing]] = {
    one.__name__.replace("_", " "): one
    for one in (
        files, results, packed, pulling, recordings, scans_and_labels, calibrations, firmware, setup_files, version_on_trial, host_key,
    )
} | EXPORTS  # fmt: skip
PASSING = {"run", "drafts", "lock", "room"}
"""Locks, states of living processes, drafts and allocated space: nobody looks at them after a loss of power."""


@pytest.mark.parametrize("name", WRITERS)
def test_a_loss_of_power_leaves_nothing_half_and_takes_nothing_that_was_told(tmp_path: Path, name: str) -> None:
    if name == "host key" and shutil.which("ssh-keygen") is None:
        pytest.skip("openssh-client is not installed")
    writing = WRITERS[name](tmp_path)
    next(writing)
    seen = judge(tmp_path, lambda: next(writing, None), PASSING)
    assert len(seen.states) > 2, "the power never went in between"
    if name == "packed":
        # All frames are there once at least: a source goes only when its copy would survive.
        folder, copied = "source/scans/000001", "archive/scans/000001/"
        names = {one.removeprefix(f"{folder}/") for one in seen.states[0] if one.startswith(f"{folder}/")}
        assert len(names) > 5
        for state in seen.states:
            source = {one for one in names if f"{folder}/{one}" in state}
            copies = {one.removeprefix(copied).removesuffix(".jls") for one in state if one.startswith(copied)}
            assert source == names or copies == names


def in_place(root: Path) -> None:
    (root / "file").write_bytes(b"new")


def without_sync_of_the_file(root: Path) -> None:
    (root / ".draft").write_bytes(b"new")
    (root / ".draft").rename(root / "file")
    FS.sync_folder(root)


def in_a_new_folder(root: Path) -> None:
    (root / "new").mkdir()
    FS.replace_file(root / "new" / "file", b"new")


@pytest.mark.parametrize("work", [in_place, without_sync_of_the_file, in_a_new_folder])
def test_a_writer_that_keeps_no_order_is_found(tmp_path: Path, work: Callable[[Path], None]) -> None:
    (tmp_path / "file").write_bytes(b"of before")
    with pytest.raises(AssertionError, match="may be l"):
        judge(tmp_path, partial(work, tmp_path))


JUDGED = {
    "appliance/cli/setup.py": "firmware",
    "appliance/desk/anew/results.py": "results",
    "appliance/calibrate/pictures.py": "recordings",
    "appliance/store/pull/taking.py": "pulling",
    "appliance/store/archive.py": "packed",
    "appliance/store/atomic.py": "files",
    "appliance/calibrate/calibrations.py": "calibrations",
    "appliance/calibrate/health.py": "calibrations",
    "appliance/store/incomplete.py": "recordings",
    "appliance/store/library.py": "scans and labels",
    "appliance/store/room.py": "scans and labels",
    "appliance/store/scan.py": "scans and labels",
    "systemd/kingfisher_setup/durable.py": "setup files",
    "systemd/kingfisher_setup/versions.py": "version on trial",
    "systemd/kingfisher_transfer/serving.py": "host key",
}
"""Modules with an order of calls of their own, and the writer above that stands for it (scans more closely in ``test_power_loss.py``)."""
OTHERWISE = {
    "appliance/base/kernel_build.py": "compiled kernels: made again",
    "appliance/base/kernel_cache.py": "compiled kernels: made again",
    "appliance/cli/failures.py": "in memory: for the safe screen of this start",
    "appliance/desk/export/npz.py": "under the draft's name, from replace_by",
    "appliance/instrument/service/air_live.py": "run/status.json: worthless after a restart",
    "appliance/instrument/service/app.py": "a note and a mark in memory",
    "appliance/instrument/service/transfer.py": "a note in memory",
    "appliance/instrument/service/watchdog.py": "the folder run, which a restart makes again",
    "appliance/store/lock.py": "a lock ends with its process",
    "appliance/desk/object_store.py": "bytes for replace_file",
    "appliance/instrument/service/status.py": "run/status.json: worthless after a restart",
    "systemd/kingfisher_safe/main.py": "a count in memory",
    "systemd/kingfisher_setup/build.py": "tens of thousands of files: the whole disk is synced before the mark that says so",
}
"""Modules that change files and need no order, and why."""
_WRITES = re.compile(
    r"(?<!def )\b(?:write_new|move_folder|make_folder|create|allocate|reopen|sync_folder|write_bytes|write_text|touch|mkdir|makedirs"
    r"|symlink_to|hardlink_to|rename|imwrite|savez|savez_compressed|tofile|copyfile|copytree|copy2|copyfileobj|f?truncate)\("
    r"|\bopen\([^()]*['\"][wax][bt+]*['\"]|\.replace\([^,()=]+\)|\bos\.O_CREAT"
)
"""Calls that may change files."""


def test_no_writer_is_forgotten() -> None:
    """A new one goes through ``replace_file`` or ``durable.write``, or stands above with its own order, or says why it needs none."""
    found = {
        path.relative_to(ROOT).as_posix(): calls
        for room in ("appliance", "drivers", "systemd")
        for path in sorted((ROOT / room).rglob("*.py"))
        if (calls := _WRITES.findall(path.read_text(encoding="utf-8")))
    }
    unknown = {name: calls for name, calls in found.items() if name not in JUDGED | OTHERWISE}
    assert unknown == {}, "write these by `replace_file` or `durable.write`, or judge them above"
    assert (JUDGED | OTHERWISE).keys() - found.keys() == set(), "these write nothing any more"
    assert set(JUDGED.values()) <= set(WRITERS)
    assert JUDGED.keys() & OTHERWISE.keys() == set()
    for line in ("path.write_bytes(x)", "open(p, 'wb')", "p.open(mode='a')", "d.replace(p)", "os.open(p, os.O_CREAT)"):
        assert _WRITES.search(line)
    assert not _WRITES.search("text.replace('a', 'b'); open(p); p.open('rb'); replace(x, a=1)")
