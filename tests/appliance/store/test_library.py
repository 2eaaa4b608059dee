"""What is on the shelf is what was recorded, found by its number; damage is seen, named and confined to its scan, and nothing is deleted."""

from __future__ import annotations

import hashlib
import shutil
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from appliance.store.label import Label
from appliance.store.library import LOOKED_AT, Library, LibraryFolder, ScanEntry, UnknownScan
from appliance.store.manifest import Decision, Stage
from appliance.store.scan import ScanError, StoredScan, size_bytes
from tests.appliance.store.scenes import ORIGIN, PREVIEW, SoFull, cloud, frames, record, second_sequence

OF_BOTH = ("left", "right")
BOTH = replace(record(), second=second_sequence())


@pytest.fixture
def empty(tmp_path: Path) -> Library:
    made = Library(tmp_path / "deep" / "root")
    made.prepare()
    return made


@pytest.fixture
def library(empty: Library) -> Library:
    """Two kept scans and a rejected one."""
    for seed in range(2):
        saved(empty, seed)
    empty.begin(frames(2), record(), ORIGIN).reject("moved")
    return empty


def saved(library: Library, seed: int = 0, **said: object) -> str:
    scan = library.begin(frames(seed), record(**said), ORIGIN)
    scan.publish(record(**said), cloud(seed=seed), PREVIEW)
    return scan.scan_id


def test_what_was_recorded_is_what_is_read(empty: Library) -> None:
    scan_id = saved(empty)
    stored = empty.load(scan_id)
    assert (scan_id, stored.manifest.record, stored.second) == ("000001", record(), None)
    typeof: Any = numba.typeof
    for side in OF_BOTH:
        array = stored.frames[side]
        assert isinstance(array, np.memmap)
        assert typeof(array) == typeof(frames()[side]), "kernels are compiled for arrays that can be written"
        sums = [f"{zlib.crc32(frame.tobytes()):08x}" for frame in frames()[side]]
        assert list(stored.manifest.frame_crc32[f"frames_{side}.npy"]) == sums
        assert (array == frames()[side]).all()
        array[:] = ~array
        assert (array == ~frames()[side]).all()
        assert (empty.load(scan_id).frames[side] == frames()[side]).all(), "no file is changed so"
    points = stored.cloud()
    assert points is not None
    assert (points.points_mm == cloud().points_mm).all()
    contents = (("calibration.json", ORIGIN.calibration), ("rig.toml", ORIGIN.rig), ("preview.png", PREVIEW))
    for name, content in contents:
        assert (stored.folder / name).read_bytes() == content
        stamp = stored.manifest.files[name]
        assert (stamp.length, stamp.sha256) == (len(content), hashlib.sha256(content).hexdigest())
    assert empty.verify(scan_id).ok


def test_raw_frames_are_safe_but_not_listed_before_the_decision_and_that_is_made_once(empty: Library) -> None:
    scan = empty.begin(frames(), record(), ORIGIN)
    assert (empty.entries(), empty.count()) == ([], 0)
    assert (StoredScan.load(scan.folder).frames["right"] == frames()["right"]).all()
    assert (scan.folder / "rig.toml").read_bytes() == ORIGIN.rig
    first = scan.publish(record(), cloud(), PREVIEW)
    assert scan.publish(record()) == scan.reject("changed my mind") == first
    assert empty.last_id() == scan.scan_id
    assert empty.verify(scan.scan_id).ok
    assert empty.load(scan.scan_id).cloud() is not None


def test_a_rejected_scan_is_kept_apart_with_its_reason_and_what_was_known_of_it(empty: Library) -> None:
    pending = empty.begin(frames(), record(), ORIGIN)
    assert pending.folder == empty.root / "scans" / ".000001"
    there = pending.reject("moved", record(calibration_hash="cd" * 32))
    assert there == pending.folder == empty.root / "rejected" / "000001"
    assert empty.entries() == []
    (entry,) = empty.entries(LibraryFolder.REJECTED)
    manifest = entry.manifest
    assert manifest is not None
    assert (manifest.reason, manifest.decision, manifest.stage) == ("moved", Decision.REJECTED, Stage.COMPLETE)
    assert manifest.record.calibration_hash == "cd" * 32
    pending.add_second(frames(1), BOTH)
    assert empty.load("1").second is None, "it is decided"
    assert empty.verify("1").ok


def test_both_exposures_are_read_back_with_their_ledgers_and_verdicts(empty: Library) -> None:
    scan = empty.begin(frames(1), record(), ORIGIN)
    with pytest.raises(ValueError, match="second"):
        scan.add_second(frames(), record())
    scan.add_second(frames(2), BOTH)
    scan.publish(BOTH, cloud(), PREVIEW)
    assert empty.verify(scan.scan_id).ok
    stored = empty.load(scan.scan_id)
    assert stored.second is not None
    assert (stored.frames["right"] == frames(1)["right"]).all()
    assert (stored.second["right"] == frames(2)["right"]).all()
    assert stored.manifest.record.second == second_sequence()
    files = [f"frames_{side}{end}.npy" for side in OF_BOTH for end in ("", "_second")]
    assert sorted(stored.manifest.frame_crc32) == sorted(files)


FILES = ("frames_left.npy", "frames_right.npy", "calibration.json", "rig.toml", "cloud.ply", "preview.png", "manifest.json")  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_any_damaged_byte_range_is_found_and_leaves_the_others_fine(empty: Library, name: str) -> None:
    bad, good = saved(empty, 1), saved(empty, 2)
    path = empty.entry(bad).folder / name
    whole = path.read_bytes()
    step = max(1, len(whole) // 20)
    for start in range(0, len(whole), step):
        # Digits become letters and pixels other pixels: every value in the range changes.
        path.write_bytes(whole[:start] + bytes(b ^ 0x55 for b in whole[start : start + step]) + whole[start + step :])
        assert name in empty.verify(bad).problems[0]
        assert empty.verify(good).ok
    for cut in (0, 100, len(whole) - 2):
        path.write_bytes(whole[: min(cut, len(whole) - 2)])
        assert [entry.ok for entry in empty.entries()] == [False, True], "seen in the list"
    path.unlink()
    assert "missing" in empty.entries()[0].problems[0]
    with pytest.raises(ScanError):
        empty.load(bad)
    if not name.startswith(("frames", "manifest")):
        assert (StoredScan.load(empty.entry(bad).folder, only_raw=True).frames["left"] == frames(1)["left"]).all()
    path.write_bytes(whole)
    assert empty.verify(bad).ok


def test_a_scan_copied_elsewhere_is_read_under_any_name_but_another_number(library: Library, tmp_path: Path) -> None:
    library.set_label("2", Label("bollard", None))
    for name, problems in (("holiday", 0), ("000002", 0), ("000002-3", 0), ("000009", 1)):
        copied = tmp_path / "elsewhere" / name
        shutil.copytree(library.root / "scans" / "000002", copied)
        entry = ScanEntry.of(copied, checksums=True)
        assert (entry.scan_id, entry.folder_kind, len(entry.problems)) == (name, LibraryFolder.SCANS, problems)
        assert entry.label == Label("bollard", None)
        assert entry.size_bytes == sum(path.stat().st_size for path in copied.iterdir()) > 1000
    assert ScanEntry.of(tmp_path / "none", checksums=False).size_bytes == 0


def test_what_is_whole_is_recovered_and_marked_and_the_rest_set_aside(empty: Library) -> None:
    whole, broken, copied, taken, rejected = (empty.begin(frames(k), record(), ORIGIN) for k in range(1, 6))
    path = broken.folder / "frames_right.npy"
    path.write_bytes(path.read_bytes()[:-5])
    shutil.copytree(whole.folder, copied.folder.with_name(".000077"))
    shutil.copytree(taken.publish(record()), taken.folder.with_name(".000004"))
    rejected.reject("moved").rename(empty.root / "scans" / ".000005")
    (empty.root / "scans" / ".000099").mkdir()
    (whole.folder / ".manifest.json.draft").write_bytes(b"half")
    before = (taken.folder / "manifest.json").read_bytes()
    outcome = empty.recover()
    assert (outcome.recovered, outcome.rejected, outcome.failed) == (("000001", "000003"), ("000005",), ())
    assert set(outcome.set_aside) == {"000002", "000004", "000077", "000099"}, "there was one recording of each number"
    assert [entry.scan_id for entry in empty.entries()] == ["000001", "000003", "000004"]
    manifests = {number: empty.verify(number) for number in ("1", "3", "4", "5")}
    assert all(entry.ok for entry in manifests.values())
    recovered = [entry.manifest.recovered for entry in manifests.values() if entry.manifest is not None]
    assert recovered == [True, True, False, True]
    assert manifests["5"].folder_kind is LibraryFolder.REJECTED
    assert (taken.folder / "manifest.json").read_bytes() == before
    for number in ("000002", "000004", "000077"):
        assert (empty.root / "set-aside" / number / "frames_left.npy").exists(), "nothing is deleted"
    assert (empty.root / "scans" / "000001" / "manifest.json.draft.partial").read_bytes() == b"half"
    assert empty.recover() == type(outcome)()
    shutil.rmtree(taken.folder)
    with pytest.raises(ScanError, match="in no list; leave it"):
        empty.trash("000004")


@pytest.mark.parametrize("name", ["calibration.json", "cloud.ply", "frames_left_second.npy"])
def test_what_a_loss_of_power_damaged_costs_only_itself(empty: Library, name: str) -> None:
    scan = empty.begin(frames(1), record(), ORIGIN)
    if name == "cloud.ply":
        scan.publish(record(), cloud(), PREVIEW).rename(empty.root / "scans" / ".000001")
    if "second" in name:
        scan.add_second(frames(2), BOTH)
    path = empty.root / "scans" / ".000001" / name
    path.write_bytes(path.read_bytes()[:100])
    assert empty.recover().recovered == ("000001",)
    assert empty.verify("1").ok
    stored = empty.load("1")
    assert (stored.frames["left"] == frames(1)["left"]).all()
    assert (stored.second, stored.cloud(), stored.manifest.record.second) == (None, None, None)
    assert name not in stored.manifest.files
    assert "rig.toml" in stored.manifest.files
    assert (stored.folder / f"{name}.partial").stat().st_size == 100, "nothing is deleted"
    assert (stored.folder / "preview.png").exists() == (name == "cloud.ply")
    assert (stored.folder / "frames_right_second.npy.partial").exists() == ("second" in name)


def test_a_scan_is_found_by_its_number_however_it_is_spelled(library: Library) -> None:
    assert {library.entry(number).scan_id for number in ("2", "02", "000002", "0000002")} == {"000002"}
    for none in (
        "", "4", "-2", "2x", "\u00b2", "\uff12", "2 ", "..", ".000002", "../scans/000001", "1" * 5000, "0" * 5000
    ):  # fmt: skip
        with pytest.raises(UnknownScan, match="scans list --all"):
            library.entry(none)
    for name in ("00001", "1234567890123", "000001a", "a000001", "x.000009", "000009-"):
        (library.root / "scans" / name).mkdir()
    (library.root / "scans" / "000077").write_text("a file")
    assert library.ids() == ["000001", "000002"], "what is not named like a scan is none"
    for name in ("1000000", "999999", "000010"):
        (library.root / "scans" / name).mkdir()
    assert library.ids() == ["000001", "000002", "000010", "999999", "1000000"], "by number and not by name"
    assert library.last_id() == "1000000"
    assert library.begin(frames(), record(), ORIGIN).scan_id == "1000001"
    nowhere = Library(library.root / "nowhere")
    assert (nowhere.entries(), nowhere.count(), nowhere.last_id()) == ([], 0, None)


def test_no_number_is_given_twice_wherever_its_scan_is_now(library: Library) -> None:
    shutil.rmtree(library.root / "scans" / "000002")
    assert saved(library) == "000004"
    for number in ("1", "3", "4"):
        library.trash(number)
    (library.root / "next-id").unlink()
    assert saved(library) == "000005"
    for content in ("a", "b"):
        (library.root / "scans" / ".000006").mkdir()
        (library.root / "scans" / ".000006" / "frames_left.npy").write_text(content)
        library.recover()
    assert [entry.scan_id for entry in library.entries(LibraryFolder.SET_ASIDE)] == ["000006", "000006-2"]
    (library.root / "next-id").unlink()
    assert saved(library) == "000007"


def test_a_scan_is_put_away_and_taken_back_to_where_it_was_and_over_no_other(library: Library) -> None:
    assert sorted(path.name for path in library.root.iterdir() if path.is_dir()) == ["rejected", "scans", "set-aside"]
    for scan_id, shelf in (("000001", LibraryFolder.SCANS), ("000003", LibraryFolder.REJECTED)):
        assert library.entry(scan_id).folder_kind is shelf
        assert library.trash(scan_id) == library.root / "trash" / scan_id
        assert library.entry(scan_id).folder_kind is LibraryFolder.TRASH
        assert scan_id not in library.ids()
        with pytest.raises(ScanError, match="already"):
            library.trash(scan_id)
        assert library.restore(scan_id) == library.root / shelf.value / scan_id
        assert library.verify(scan_id).ok
        with pytest.raises(UnknownScan):
            library.restore(scan_id)
    assert (library.ids(), library.count(), library.last_id()) == (["000001", "000002"], 2, "000002")
    (library.trash("2") / "manifest.json").write_text("{")
    assert library.restore("2") == library.root / "scans" / "000002"
    assert not library.entry("2").ok, "its damage is seen in the list"
    library.trash("1")
    (library.root / "scans" / "000001").mkdir()
    with pytest.raises(ScanError, match="already"):
        library.restore("000001")
    assert (library.root / "trash" / "000001" / "manifest.json").exists()


def test_a_label_changes_nothing_else_of_its_scan(library: Library) -> None:
    before = {path.name: path.read_bytes() for path in library.entry("1").folder.iterdir()}
    library.set_label("1", Label("bollard 3", "north side"))
    entry = library.verify("1")
    assert (entry.label, entry.ok) == (Label("bollard 3", "north side"), True)
    assert {p.name: p.read_bytes() for p in entry.folder.iterdir() if p.name != "label.json"} == before
    (entry.folder / "label.json").write_text("{")
    assert (library.entry("1").ok, library.entry("1").label) == (True, Label()), "it is no damage to the scan"
    assert any("label.json" in problem for problem in library.verify("1").problems), "and is told all the same"


def test_the_room_left_is_counted_in_whole_scans_above_the_reserve(empty: Library) -> None:
    made = Library(empty.root, SoFull(1000))
    reserves = {0: 3, 99: 3, 100: 3, 101: 2, 399: 2, 401: 1, 999: 0, 1000: 0, 5000: 0}
    assert {reserve: made.scans_left(300, reserve) for reserve in reserves} == reserves
    assert Library(empty.root / "nowhere").scans_left(300, 0) is None
    needed = (2 * 24 + 25) * 1600 * 1200  # both cameras' frames, a point for every pixel
    assert needed + 1_500_000 < size_bytes(24, 1600, 1200) < needed + 10_000_000


def test_scans_are_found_by_their_objects_number(empty: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    assert empty.largest_object() == 0
    ids = [saved(empty, object=number) for number in (1, None, 2, 1)]
    assert (empty.scans_of_object(1), empty.scans_of_object(7), empty.objects()) == (
        [ids[0], ids[3]],
        [],
        [1, 2],
    )
    empty.begin(frames(), record(object=3), ORIGIN).reject("blurred")
    assert empty.largest_object() == 3
    empty.trash(saved(empty, object=4))
    assert empty.largest_object() == 4
    damaged = saved(empty, object=5)
    (empty.root / "scans" / damaged / "manifest.json").write_bytes(b"{}")
    assert (empty.largest_object(), empty.objects()) == (4, [1, 2]), "a damaged manifest is passed over"
    for _ in range(2):
        saved(empty)
    assert LOOKED_AT >= 100
    monkeypatch.setattr("appliance.store.library.LOOKED_AT", 2)
    assert empty.largest_object() == 0, "a start reads a bounded number of manifests"
