"""What is on the shelf is what was recorded; damage is seen, named and confined to its scan."""

from __future__ import annotations

import hashlib
import json
import shutil
import zlib
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from appliance.patterns.sequence import build_sequence
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.verdict import Verdict
from appliance.storage.atomic import StorageError
from appliance.storage.library import Library, LibraryFolder, UnknownScan
from appliance.storage.lock import hold_lock
from appliance.storage.record import SequenceInfo
from appliance.storage.scan import ScanError, load, size_bytes
from tests.appliance.storage.scenes import ORIGIN, PREVIEW, cloud, frames, record


@pytest.fixture
def library(tmp_path: Path) -> Library:
    made = Library(tmp_path / "deep" / "root")
    made.prepare()
    return made


def saved(library: Library, seed: int = 0) -> str:
    scan = library.begin(frames(seed), record(), ORIGIN)
    scan.publish(record(), cloud(seed=seed), PREVIEW)
    return scan.scan_id


def test_what_was_recorded_is_what_is_read(library: Library) -> None:
    scan_id = saved(library)
    assert scan_id == "000001"
    stored = library.load(scan_id)
    for side in ("left", "right"):
        assert (stored.frames[side] == frames()[side]).all()
        assert isinstance(stored.frames[side], np.memmap)
    assert stored.manifest.record == record()
    points = stored.cloud()
    assert points is not None
    assert (points.points_mm == cloud().points_mm).all()
    assert (stored.folder / "preview.png").read_bytes() == PREVIEW
    assert library.verify(scan_id).ok


def test_who_writes_into_frames_that_were_read_changes_no_file(library: Library) -> None:
    scan_id = saved(library)
    for side, array in library.load(scan_id).frames.items():
        array[:] = ~array
        assert (array == ~frames()[side]).all()
    assert all((array == frames()[side]).all() for side, array in library.load(scan_id).frames.items())
    assert library.verify(scan_id).ok


def test_kernels_take_frames_that_were_read_for_the_same_kind_of_array_as_recorded_ones(library: Library) -> None:
    """numba compiles each kernel again for arrays that cannot be written: that was an eighth of the first run."""
    typeof: Any = numba.typeof
    stored = library.load(saved(library))
    assert {typeof(array) for array in stored.frames.values()} == {typeof(frames()["left"])}


def test_a_scan_carries_the_calibration_and_the_rig_it_was_taken_with_byte_for_byte(library: Library) -> None:
    scan = library.begin(frames(), record(), ORIGIN)
    before = [(scan.folder / name).read_bytes() for name in ("calibration.json", "rig.toml")]
    folder = scan.publish(record(), cloud(), PREVIEW)
    assert before == [ORIGIN.calibration, ORIGIN.rig], "durable before the diver decides"
    manifest = load(folder).manifest
    for name, content in (("calibration.json", ORIGIN.calibration), ("rig.toml", ORIGIN.rig)):
        assert (folder / name).read_bytes() == content
        assert manifest.files[name].length == len(content)
        assert manifest.files[name].sha256 == hashlib.sha256(content).hexdigest()


def test_an_origin_that_a_loss_of_power_damaged_does_not_cost_the_frames(library: Library) -> None:
    scan = library.begin(frames(), record(), ORIGIN)
    (scan.folder / "calibration.json").write_bytes(ORIGIN.calibration[:100])
    assert library.recover().recovered == (scan.scan_id,)
    stored = library.load(scan.scan_id)
    assert library.verify(scan.scan_id).ok
    assert "rig.toml" in stored.manifest.files
    assert "calibration.json" not in stored.manifest.files
    assert (stored.folder / "calibration.json.partial").stat().st_size == 100, "nothing is deleted"


def test_the_manifest_knows_the_checksum_of_every_single_frame(library: Library) -> None:
    """So that it can be said later which of 48 images is damaged, and not only that one of them is."""
    stored = library.load(saved(library))
    for side in ("left", "right"):
        sums = [f"{zlib.crc32(frame.tobytes()):08x}" for frame in frames()[side]]
        assert list(stored.manifest.frame_crc32[f"frames_{side}.npy"]) == sums


def test_raw_frames_are_safe_but_not_listed_before_the_decision(library: Library) -> None:
    scan = library.begin(frames(), record(), ORIGIN)
    assert library.entries() == []
    assert library.count() == 0
    assert (load(scan.folder).frames["right"] == frames()["right"]).all()
    scan.publish(record())
    assert library.last_id() == scan.scan_id
    assert library.load(scan.scan_id).cloud() is None


def test_a_rejected_scan_is_kept_apart_with_its_reason(library: Library) -> None:
    scan = library.begin(frames(), record(), ORIGIN)
    scan.reject("moved 3 px")
    assert library.entries() == []
    (entry,) = library.entries(LibraryFolder.REJECTED)
    assert entry.manifest is not None
    assert entry.manifest.reason == "moved 3 px"
    assert library.verify(entry.scan_id).ok


def test_deciding_twice_changes_nothing(library: Library) -> None:
    scan = library.begin(frames(), record(), ORIGIN)
    first = scan.publish(record(), cloud(), PREVIEW)
    assert scan.publish(record()) == first
    assert scan.reject("changed my mind") == first
    assert library.verify(scan.scan_id).ok
    assert library.load(scan.scan_id).cloud() is not None


def test_the_manifest_says_what_the_diver_would_ask(library: Library) -> None:
    info = SequenceInfo.of(build_sequence(64))
    full = record(sequence=info, verdicts=(Verdict.failed("x", Fault(FaultCode.MOVED, "axial", {"shift_px": 1.8})),))
    block = np.zeros((20, 4, 4), np.uint8)
    scan = library.begin({"left": block, "right": block}, full, ORIGIN)
    scan.publish(full)
    content = json.loads((scan.folder / "manifest.json").read_text(encoding="utf-8"))
    assert content["schema"] == 1
    assert content["record"]["sequence"]["patterns"][:3] == ["bright", "dark", "gray-x-0"]
    assert content["record"]["verdicts"] == [
        {"name": "x", "passed": False, "numbers": {"shift_px": 1.8}, "text": "MOVED: axial"}
    ]
    assert content["record"]["clock_trusted"] is False
    assert set(content["files"]) == {"frames_left.npy", "frames_right.npy", "calibration.json", "rig.toml"}


def test_numbers_of_numpy_and_what_is_not_finite_are_written_as_json_knows_them(library: Library) -> None:
    numbers = {"a": np.float32(0.5), "b": np.int64(7), "c": float("nan")}
    scan = library.begin(frames(), record(cloud=numbers), ORIGIN)
    scan.publish(record(cloud=numbers))
    entry = library.verify(scan.scan_id)
    assert entry.ok
    assert entry.manifest is not None
    assert entry.manifest.record.cloud == {"a": 0.5, "b": 7.0, "c": None}


@pytest.mark.parametrize(
    "name",
    [
        "frames_left.npy",
        "frames_right.npy",
        "calibration.json",
        "rig.toml",
        "cloud.ply",
        "preview.png",
        "manifest.json",
    ],
)
def test_any_damaged_byte_range_is_found_and_leaves_the_others_fine(library: Library, name: str) -> None:
    bad, good = saved(library, 1), saved(library, 2)
    path = library.entry(bad).folder / name
    whole = path.read_bytes()
    step = max(1, len(whole) // 40)
    for start in range(0, len(whole), step):
        # Digits become letters and pixels other pixels: every value in the range changes.
        path.write_bytes(whole[:start] + bytes(b ^ 0x55 for b in whole[start : start + step]) + whole[start + step :])
        damaged = library.verify(bad)
        assert not damaged.ok
        assert name in damaged.problems[0]
        assert library.verify(good).ok
        assert [entry.scan_id for entry in library.entries()] == [bad, good]
    path.write_bytes(whole)
    assert library.verify(bad).ok


@pytest.mark.parametrize("name", ["frames_left.npy", "cloud.ply", "manifest.json"])
@pytest.mark.parametrize("cut", [0, 1, 100])
def test_a_short_or_missing_file_is_already_seen_in_the_list(library: Library, name: str, cut: int) -> None:
    scan_id = saved(library)
    path = library.entry(scan_id).folder / name
    path.write_bytes(path.read_bytes()[:-2] if cut == 1 else path.read_bytes()[:cut])
    (entry,) = library.entries()
    assert not entry.ok
    path.unlink()
    (entry,) = library.entries()
    assert "missing" in entry.problems[0]
    with pytest.raises(ScanError):
        library.load(scan_id)


def test_a_manifest_whose_number_was_edited_is_not_believed(library: Library) -> None:
    scan_id = saved(library)
    path = library.entry(scan_id).folder / "manifest.json"
    text = path.read_text(encoding="utf-8")
    assert "41.5" in text
    path.write_text(text.replace("41.5", "21.5"), encoding="utf-8")
    assert "checksum" in library.entry(scan_id).problems[0]


def test_a_manifest_of_a_newer_version_says_so(library: Library) -> None:
    scan_id = saved(library)
    path = library.entry(scan_id).folder / "manifest.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    content["schema"] = 2
    del content["sha256"]
    digest = hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
    path.write_text(json.dumps({**content, "sha256": digest}), encoding="utf-8")
    assert "schema 2; this version reads schema 1" in library.entry(scan_id).problems[0]


def test_a_scan_moved_to_another_number_is_noticed(library: Library) -> None:
    scan_id = saved(library)
    folder = library.entry(scan_id).folder
    folder.rename(folder.with_name("000077"))
    assert "000001" in library.entry("77").problems[0]


def test_an_unfinished_scan_is_recovered_and_marked_and_an_incomplete_one_set_aside(library: Library) -> None:
    whole = library.begin(frames(1), record(), ORIGIN)
    broken = library.begin(frames(2), record(), ORIGIN)
    path = broken.folder / "frames_right.npy"
    path.write_bytes(path.read_bytes()[:-5])
    (library.root / "scans" / ".000099").mkdir()
    outcome = library.recover()
    assert outcome.recovered == (whole.scan_id,)
    assert set(outcome.set_aside) == {broken.scan_id, "000099"}
    (entry,) = library.entries()
    assert entry.manifest is not None
    assert entry.manifest.recovered
    assert library.verify(entry.scan_id).ok
    assert (library.root / "set-aside" / broken.scan_id / "frames_left.npy").exists()
    assert library.recover() == type(outcome)()


def test_an_unfinished_scan_copied_under_another_number_is_not_recovered_as_a_second_scan(library: Library) -> None:
    scan = library.begin(frames(1), record(), ORIGIN)
    shutil.copytree(scan.folder, scan.folder.with_name(".000007"))
    outcome = library.recover()
    assert outcome.recovered == (scan.scan_id,)
    assert outcome.set_aside == ("000007",)
    assert [entry.scan_id for entry in library.entries()] == [scan.scan_id], "there was one recording"
    assert (library.root / "set-aside" / "000007" / "frames_left.npy").exists(), "nothing is deleted"


def test_half_a_cloud_does_not_cost_the_raw_frames(library: Library) -> None:
    scan = library.begin(frames(), record(), ORIGIN)
    published = scan.publish(record(), cloud(), PREVIEW)
    hidden = published.with_name(f".{scan.scan_id}")
    published.rename(hidden)
    (hidden / "cloud.ply").write_bytes((hidden / "cloud.ply").read_bytes()[:100])
    assert library.recover().recovered == (scan.scan_id,)
    assert library.verify(scan.scan_id).ok
    assert library.load(scan.scan_id).cloud() is None
    assert (published / "cloud.ply.partial").stat().st_size == 100
    assert (published / "preview.png").read_bytes() == PREVIEW


def test_set_aside_scans_of_the_same_number_do_not_replace_each_other(library: Library) -> None:
    for content in ("a", "b", "c"):
        folder = library.root / "scans" / ".000005"
        folder.mkdir()
        (folder / "frames_left.npy").write_text(content)
        library.recover()
    assert [entry.scan_id for entry in library.entries(LibraryFolder.SET_ASIDE)] == ["000005", "000005-2", "000005-3"]
    assert library.begin(frames(), record(), ORIGIN).scan_id == "000006"


@pytest.mark.parametrize("damage", ["missing", "empty", "garbage", "cut", "behind"])
def test_numbers_never_repeat_whatever_happens_to_the_counter(library: Library, damage: str) -> None:
    for seed in range(12):
        saved(library, seed)
    path = library.root / "next-id"
    match damage:
        case "missing":
            path.unlink()
        case "empty":
            path.write_bytes(b"")
        case "garbage":
            path.write_bytes(b"999 00000000\n")
        case "cut":
            path.write_bytes(path.read_bytes()[1:])
        case "behind":
            first = library.root / "other"
            Library(first).prepare()
            saved(Library(first))
            shutil.copy(first / "next-id", path)
    assert saved(library) == "000013"


def test_numbers_do_not_repeat_after_the_newest_scans_were_moved_away(library: Library) -> None:
    for seed in range(3):
        saved(library, seed)
    shutil.rmtree(library.root / "scans" / "000003")
    assert saved(library) == "000004"


def test_a_cloud_can_be_added_later_once(library: Library) -> None:
    scan = library.begin(frames(), record(), ORIGIN)
    scan.publish(record())
    library.add_cloud(scan.scan_id, cloud(), PREVIEW, record(calibration_hash="cd" * 32))
    assert library.verify(scan.scan_id).ok
    stored = library.load(scan.scan_id)
    assert stored.cloud() is not None
    assert stored.manifest.record.calibration_hash == "cd" * 32
    with pytest.raises(ScanError, match="has a cloud already"):
        library.add_cloud(scan.scan_id, cloud(seed=5), None, record())


def test_scans_left_keeps_the_reserve(library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    free = library._fs.free_bytes(library.root)
    one = size_bytes(24, 1600, 1200)
    assert 2 * 24 * 1600 * 1200 < one < 150_000_000
    left = library.scans_left(one, 0)
    assert left is not None
    assert abs(left - free // one) <= 1
    assert library.scans_left(one, free + 10**12) == 0
    assert Library(library.root / "nowhere").scans_left(one, 0) is None


def test_an_unknown_number_says_how_to_find_the_known_ones(library: Library) -> None:
    saved(library)
    assert library.entry("1").scan_id == "000001"
    with pytest.raises(UnknownScan, match="scans list"):
        library.entry("2")
    with pytest.raises(UnknownScan):
        library.entry("../scans/000001")


def test_frames_that_do_not_fit_the_sequence_are_refused_and_leave_nothing(library: Library) -> None:
    wrong = {side: block[:2] for side, block in frames().items()}
    with pytest.raises(ValueError, match=r"uint8 \(3, height, width\)"):
        library.begin(wrong, record(), ORIGIN)
    assert list((library.root / "scans").iterdir()) == []


def test_two_instances_do_not_write_to_one_root(library: Library) -> None:
    with hold_lock(library.root), pytest.raises(StorageError, match="another instance"), hold_lock(library.root):
        pass
    with hold_lock(library.root):
        pass


def test_an_empty_or_missing_root_lists_nothing(tmp_path: Path) -> None:
    assert Library(tmp_path / "nowhere").entries() == []
    assert Library(tmp_path / "nowhere").count() == 0
