"""A scan is found by its number however it is spelled, put away and taken back; the limits of what may be chosen are the told ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from appliance.capture.exposure import Exposure
from appliance.machine.choices import Choices
from appliance.sealed import seal
from appliance.storage.choices import FILE, ChoicesFile
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.label import Label
from appliance.storage.library import Library, Shelf, UnknownScan
from appliance.storage.scan import ScanError, size_bytes
from tests.appliance.storage.scenes import ORIGIN, PREVIEW, cloud, frames, record


@pytest.fixture
def library(tmp_path: Path) -> Library:
    made = Library(tmp_path)
    made.prepare()
    for seed in range(2):
        made.begin(frames(seed), record(), ORIGIN).publish(record(), cloud(seed=seed), PREVIEW)
    made.begin(frames(2), record()).reject("moved")
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
    for scan_id, shelf in (("000001", Shelf.SCANS), ("000003", Shelf.REJECTED)):
        assert library.entry(scan_id).shelf is shelf
        away = library.trash(scan_id)
        assert away == library.root / "trash" / scan_id
        assert library.entry(scan_id).shelf is Shelf.TRASH
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
    assert library.begin(frames(), record()).scan_id == "000004"


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
        (tmp_path / FILE).write_bytes(seal({"schema": 1, "chosen": {name: value}}))
        choices, fault = ChoicesFile(tmp_path, RIG).read()
        assert (fault is None) == (value in allowed)
        if fault is None:
            exposure = {"exposure_us": choices.exposure.time_us, "gain_db": choices.exposure.gain_db}
            assert exposure.get(name, getattr(choices, name, None)) == value
        else:
            assert f"{name} {value!r}; allowed are {allowed[0]:g}..{allowed[1]:g}" in fault.detail
