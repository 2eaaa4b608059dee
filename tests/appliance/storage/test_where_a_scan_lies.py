"""A scan is found by its number however it is spelled, put away and taken back; the limits of what may be chosen are the told ones."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from appliance.checksummed_file import with_checksum
from appliance.machine.choices import Choices
from appliance.scan.exposure import Exposure
from appliance.storage.choices import FILE, ChoicesFile
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.label import Label
from appliance.storage.library import Library, LibraryFolder, UnknownScan, entry_of
from appliance.storage.manifest import Decision, Stage
from appliance.storage.scan import ScanError, load, size_bytes
from tests.appliance.storage.scenes import ORIGIN, PREVIEW, cloud, frames, record, second_sequence


@pytest.fixture
def library(tmp_path: Path) -> Library:
    made = Library(tmp_path)
    made.prepare()
    for seed in range(2):
        made.begin(frames(seed), record(), ORIGIN).publish(record(), cloud(seed=seed), PREVIEW)
    made.begin(frames(2), record(), ORIGIN).reject("moved")
    return made


@pytest.mark.parametrize(("spelled", "found"), [("2", "000002"), ("000002", "000002"), ("0000002", "000002")])
def test_a_scan_is_found_by_its_number_however_it_is_spelled(library: Library, spelled: str, found: str) -> None:
    assert library.entry(spelled).scan_id == found
    assert library.load(spelled).manifest.scan_id == found


@pytest.mark.parametrize("spelled", ["", "4", "-2", "2x", "abc", "\u00b2", "\uff12", "2 ", "..", ".000002"])
def test_what_is_no_number_of_a_scan_finds_none(library: Library, spelled: str) -> None:
    with pytest.raises(UnknownScan, match="scans list --all"):
        library.entry(spelled)


def test_a_scan_is_put_away_and_taken_back_to_where_it_was(library: Library) -> None:
    for scan_id, shelf in (("000001", LibraryFolder.SCANS), ("000003", LibraryFolder.REJECTED)):
        assert library.entry(scan_id).shelf is shelf
        away = library.trash(scan_id)
        assert away == library.root / "trash" / scan_id
        assert library.entry(scan_id).shelf is LibraryFolder.TRASH
        assert scan_id not in library.ids()
        with pytest.raises(ScanError, match="in the trash already"):
            library.trash(scan_id)
        assert library.restore(scan_id) == library.root / shelf.value / scan_id
        assert library.verify(scan_id).ok
        with pytest.raises(UnknownScan, match="scans list --trash"):
            library.restore(scan_id)
    assert library.ids() == ["000001", "000002"]
    assert (library.count(), library.last_id()) == (2, "000002")


def test_a_number_in_the_trash_is_not_given_again(library: Library) -> None:
    library.trash("2")
    library.trash("3")
    (library.root / "next-id").unlink()
    assert library.begin(frames(), record(), ORIGIN).scan_id == "000004"


def test_a_scan_does_not_take_the_place_of_another(library: Library) -> None:
    library.trash("1")
    (library.root / "scans" / "000001").mkdir()
    with pytest.raises(ScanError, match="is there already; move one of them elsewhere"):
        library.restore("000001")
    assert (library.root / "trash" / "000001" / "manifest.json").exists()


def test_a_damaged_scan_comes_back_to_the_list_where_its_damage_is_seen(library: Library) -> None:
    (library.trash("000002") / "manifest.json").write_text("{")
    assert library.restore("2") == library.root / "scans" / "000002"
    assert not library.entry("2").ok


def test_a_label_changes_nothing_else_of_its_scan(library: Library) -> None:
    before = {path.name: path.read_bytes() for path in library.entry("1").folder.iterdir()}
    library.set_label("1", Label("bollard 3", "north side"))
    entry = library.verify("1")
    assert (entry.label, entry.ok) == (Label("bollard 3", "north side"), True)
    after = {path.name: path.read_bytes() for path in entry.folder.iterdir() if path.name != "label.json"}
    assert after == before
    (entry.folder / "label.json").write_text("{")
    assert library.entry("1").ok, "a damaged label is no damage to the scan"
    assert any("label.json" in problem for problem in library.verify("1").problems), "and is told all the same"


def test_the_room_of_a_scan_holds_all_that_it_writes() -> None:
    """Both cameras' 24 frames, a point for every pixel, and at least 1.5 MB for the rest."""
    pixels = 1600 * 1200
    needed = 2 * 24 * pixels + 25 * pixels
    assert needed + 1_500_000 < size_bytes(24, 1600, 1200) < needed + 10_000_000


def test_scans_left_are_what_fits_above_the_reserve(library: Library) -> None:
    free = LocalFileSystem().free_bytes(library.root)
    left = library.scans_left(1_000_000, free // 2)
    assert left == pytest.approx(free // 2 // 1_000_000, rel=0.05)
    assert library.scans_left(1_000_000, 2 * free) == 0, "less than nothing is none"


RIG = Choices(Exposure(12_000), 16, 0.0, 20.0)


@pytest.mark.parametrize(
    ("name", "allowed", "refused"),
    [
        ("exposure_us", (50, 16_600), (49, 16_601)),
        ("gain_db", (0.0, 48.0), (-0.1, 48.1)),
        ("salinity_psu", (0.0, 45.0), (-0.1, 45.1)),
        ("water_c", (-2.0, 40.0), (-2.1, 40.1)),
    ],
)
def test_choices_are_taken_to_their_limits_and_not_beyond(
    tmp_path: Path, name: str, allowed: tuple[float, float], refused: tuple[float, float]
) -> None:
    for value in (*allowed, *refused):
        (tmp_path / FILE).write_bytes(with_checksum({"schema": 1, "chosen": {name: value}}))
        choices, fault = ChoicesFile(tmp_path, RIG).read()
        assert (fault is None) == (value in allowed)
        if fault is None:
            exposure = {"exposure_us": choices.exposure.time_us, "gain_db": choices.exposure.gain_db}
            assert exposure.get(name, getattr(choices, name, None)) == value
        else:
            assert f"{name} {value!r}; allowed are {allowed[0]:g}..{allowed[1]:g}" in fault.detail


# ---------------------------------------------------------------------------------------------- folders and what they hold


class OneRefused(LocalFileSystem):
    """Renames everything but one folder."""

    def __init__(self, name: str) -> None:
        self._name = name

    def rename(self, source: Path, target: Path) -> None:
        if source.name == self._name and target.parent != source:
            raise OSError(5, "Input/output error")
        super().rename(source, target)


class SoMuchFree(LocalFileSystem):
    def free_bytes(self, path: Path) -> int:
        return 1000


def test_one_scan_that_cannot_be_moved_does_not_keep_the_others_from_the_list(tmp_path: Path) -> None:
    made = Library(tmp_path)
    made.prepare()
    for seed in range(3):
        made.begin(frames(seed), record(), ORIGIN)
    outcome = Library(tmp_path, OneRefused(".000002")).recover()
    assert outcome.recovered == ("000001", "000003")
    assert (outcome.rejected, outcome.set_aside) == ((), ())
    assert len(outcome.failed) == 1
    assert "scans/000002" in outcome.failed[0]
    assert Library(tmp_path).recover().recovered == ("000002",)


def test_a_scan_that_the_diver_rejected_before_the_power_went_is_rejected_after_it(tmp_path: Path) -> None:
    made = Library(tmp_path)
    made.prepare()
    made.begin(frames(), record(), ORIGIN).reject("moved")
    (tmp_path / "rejected" / "000001").rename(tmp_path / "scans" / ".000001")
    outcome = made.recover()
    assert (outcome.recovered, outcome.rejected) == ((), ("000001",))
    entry = made.verify("000001")
    assert (entry.shelf, entry.ok) == (LibraryFolder.REJECTED, True)
    assert entry.manifest is not None
    assert (entry.manifest.reason, entry.manifest.recovered) == ("moved", True)


def test_an_unfinished_scan_whose_number_is_taken_is_set_aside(library: Library) -> None:
    shutil.copytree(library.root / "scans" / "000001", library.root / "scans" / ".000001")
    before = (library.root / "scans" / "000001" / "manifest.json").read_bytes()
    assert library.recover().set_aside == ("000001",)
    assert (library.root / "scans" / "000001" / "manifest.json").read_bytes() == before
    assert (library.root / "set-aside" / "000001" / "frames_left.npy").exists()
    shutil.rmtree(library.root / "scans" / "000001")
    with pytest.raises(ScanError, match="nothing to put away"):
        library.trash("000001")


def test_drafts_that_a_loss_of_power_left_are_kept_under_a_name_that_says_so(tmp_path: Path) -> None:
    made = Library(tmp_path)
    made.prepare()
    folder = made.begin(frames(), record(), ORIGIN).folder
    (folder / ".manifest.json.draft").write_bytes(b"half")
    made.recover()
    assert sorted(path.name for path in (tmp_path / "scans" / "000001").iterdir()) == [
        "calibration.json",
        "frames_left.npy",
        "frames_right.npy",
        "manifest.json",
        "manifest.json.draft.partial",
        "rig.toml",
    ]


@pytest.mark.parametrize("name", ["00001", "1234567890123", "000001a", "a000001", "x.000009", "000009-"])
def test_what_is_not_named_like_a_scan_is_none(library: Library, name: str) -> None:
    (library.root / "scans" / name).mkdir()
    (library.root / "scans" / "000077").write_text("a file")
    assert library.ids() == ["000001", "000002"]
    assert library.begin(frames(), record(), ORIGIN).scan_id == "000004"


def test_scans_are_listed_by_number_and_not_by_name(library: Library) -> None:
    for name in ("1000000", "999999", "000010"):
        (library.root / "scans" / name).mkdir()
    assert library.ids() == ["000001", "000002", "000010", "999999", "1000000"]
    assert library.last_id() == "1000000"
    assert library.begin(frames(), record(), ORIGIN).scan_id == "1000001"
    assert Library(library.root / "nowhere").last_id() is None


def test_the_room_left_is_counted_in_whole_scans(tmp_path: Path) -> None:
    made = Library(tmp_path, SoMuchFree())
    assert [made.scans_left(300, reserve) for reserve in (0, 99, 100, 101, 399, 401, 999, 1000, 5000)] == [
        *(3, 3, 3, 2, 2, 1, 0, 0, 0)
    ]


def test_a_scan_copied_elsewhere_is_read_under_any_name_but_another_number(library: Library, tmp_path: Path) -> None:
    library.set_label("2", Label("bollard", None))
    for name, problems in (("holiday", 0), ("000002", 0), ("000002-3", 0), ("000009", 1)):
        copied = tmp_path / "elsewhere" / name
        shutil.copytree(library.root / "scans" / "000002", copied)
        entry = entry_of(copied, checksums=True)
        assert (entry.scan_id, entry.shelf, len(entry.problems)) == (name, LibraryFolder.SCANS, problems)
        assert entry.label == Label("bollard", None)
        assert entry.size_bytes == sum(path.stat().st_size for path in copied.iterdir()) > 1000
    assert entry_of(tmp_path / "none", checksums=False).size_bytes == 0


def test_a_rejected_scan_keeps_what_was_known_of_it_and_its_folder_is_told(tmp_path: Path) -> None:
    made = Library(tmp_path)
    made.prepare()
    pending = made.begin(frames(), record(), ORIGIN)
    assert pending.folder == tmp_path / "scans" / ".000001"
    assert (
        pending.reject("moved", record(calibration_hash="cd" * 32))
        == pending.folder
        == tmp_path / "rejected" / "000001"
    )
    manifest = made.load("1").manifest
    assert manifest.record.calibration_hash == "cd" * 32
    assert (manifest.decision, manifest.stage) == (Decision.REJECTED, Stage.COMPLETE)
    pending.add_second(frames(1), record(second=second_sequence()))
    assert made.load("1").second is None, "it is decided"
    with pytest.raises(ValueError, match="tells of no second sequence"):
        made.begin(frames(), record(), ORIGIN).add_second(frames(), record())


def test_no_cloud_is_added_to_a_damaged_scan_and_the_trash_is_made_when_it_is_needed(tmp_path: Path) -> None:
    made = Library(tmp_path)
    made.prepare()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rejected", "scans", "set-aside"]
    folder = made.begin(frames(), record(), ORIGIN).publish(record())
    path = folder / "frames_left.npy"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ScanError, match=r"scan 1: frames_left\.npy: 367 bytes instead of 368"):
        made.add_cloud("1", cloud(), None, record())
    made.trash("1")
    assert (tmp_path / "trash").is_dir()


def test_only_frames_count_where_only_they_are_wanted(library: Library) -> None:
    folder = library.entry("1").folder
    (folder / "cloud.ply").unlink()
    with pytest.raises(ScanError, match=r"cloud\.ply: missing"):
        load(folder)
    assert (load(folder, only_raw=True).frames["left"] == frames(0)["left"]).all()
    (folder / "frames_right.npy").unlink()
    with pytest.raises(ScanError, match=r"frames_right\.npy: missing"):
        load(folder, only_raw=True)
