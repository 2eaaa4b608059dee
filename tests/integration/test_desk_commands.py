"""One dive by script, and then everything the desk can make of what it left behind, wherever it was copied to."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.calibration import file as calibration_file
from appliance.config import load_rig
from appliance.storage.ply import read_ply
from tests.support.commands import ROOT, Shell, kingfisher

SMALL_RIG = ROOT / "hw_sim" / "rigs" / "small.toml"
SIZE = "360x270"
"""No rig file has it."""
FRAMES_BYTES = 128 + 24 * 360 * 270
DIVE = """
wait state AIM 90
press scan
wait state REVIEW 60
pause 1
press scan            # keep
wait state AIM 60
end
"""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A storage root after a dive with cameras of a size that no rig file has: one scan kept."""
    folder = tmp_path_factory.mktemp("dive")
    script = folder / "dive.script"
    script.write_text(DIVE)
    options = ("--truth", "nominal", "--seed", 3, "--object", "frustum", "--size", SIZE, "--script", script)
    said = kingfisher("sim", "--rig", SMALL_RIG, "--root", folder / "root", *options)
    assert said.code == 0, said.err
    assert said.out == "", "results only, and there are none"
    news = [line.removeprefix("kingfisher: ") for line in said.err.splitlines()]
    assert "AIM → ARMED (KeyPressed)" in news
    assert news[-1] == "switched off"
    return folder / "root"


@pytest.fixture
def desk(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys)


@pytest.fixture
def copy(root: Path, tmp_path: Path) -> Path:
    """The scan that was kept, copied to where nothing else of the instrument is."""
    return Path(shutil.copytree(root / "scans" / "000001", tmp_path / "copied"))


def changed(copy: Path, to: Path, **what: object) -> Path:
    """Write a calibration file with something else in it than in the scan's own."""
    own = calibration_file.load(copy / "calibration.json")
    to.write_bytes(calibration_file.encode(replace(own, **what)))  # type: ignore[arg-type]
    return to


# ----------------------------------------------------------------------- the same cloud again, anywhere


def test_a_folder_copied_anywhere_gives_the_bytes_that_the_instrument_stored(
    copy: Path, tmp_path: Path, desk: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a rig file, a storage root or a calibration beside it."""
    rig = load_rig(copy / "rig.toml")
    assert (rig.camera.left.width_px, rig.camera.right.height_px) == (360, 270)
    record = json.loads((copy / "manifest.json").read_text(encoding="utf-8"))["record"]
    assert rig.rig_hash == record["rig_hash"]
    assert calibration_file.load(copy / "calibration.json").hash == record["calibration_hash"]
    assert desk("scans", "verify", copy).out == "copied  ok\n1 checked, 0 damaged\n"
    monkeypatch.chdir(tmp_path)
    made = desk("reconstruct", copy, "--salvage", "--json")
    assert (made.code, made.err) == (0, "")
    assert (tmp_path / "copied.ply").read_bytes() == (copy / "cloud.ply").read_bytes()
    assert made.document["points"] > 10_000
    assert made.document["calibration_from"] == "the scan's own"
    assert made.document["stored_cloud"] == "the same, byte for byte"
    assert made.document["salvaged"] is None, "what was whole"


# ----------------------------------------------------------------------------- which calibration


def test_another_instruments_calibration_is_refused_unless_that_is_said(
    copy: Path, tmp_path: Path, desk: Shell
) -> None:
    other = changed(copy, tmp_path / "other.json", rig_serial="KF-0001")
    out = tmp_path / "w.ply"
    for words in (("reconstruct", copy), ("scans", "merge", copy, copy)):
        said = desk(*words, "--calibration", other, "--out", out)
        assert said.code == 1
        for word in (str(other), "KF-0001", "KF-SIM", "--foreign-calibration"):
            assert word in said.error
        assert not out.exists()
    said = desk("reconstruct", copy, "--calibration", other, "--foreign-calibration", "--out", out, "--json")
    assert (said.code, said.document["same_calibration"]) == (0, False)
    assert out.read_bytes() == (copy / "cloud.ply").read_bytes(), "but for its name it is the same"


def test_a_calibration_that_leaves_no_points_and_one_of_another_size_are_no_success(
    copy: Path, tmp_path: Path, desk: Shell
) -> None:
    own = calibration_file.load(copy / "calibration.json")
    x, y, z = own.rig.right.translation_mm
    right = replace(own.rig.right, translation_mm=(x, y + 10.0, z))
    knocked = changed(copy, tmp_path / "knocked.json", rig=replace(own.rig, right=right))
    assert desk("calibration", "nominal", "--out", tmp_path / "nominal.json").code == 0
    out = tmp_path / "none.ply"
    for words, wanted in (
        (("--calibration", knocked), (str(copy), "points are left of", "--calibration FILE")),
        (("--calibration", tmp_path / "nominal.json", "--foreign-calibration"), ("360x270", "1600x1200")),
        (("--rig", SMALL_RIG), ("360x270", "400x300", "--rig")),
    ):
        said = desk("reconstruct", copy, *words, "--out", out)
        assert said.code == 1
        for word in wanted:
            assert word in said.error
        assert not out.exists()


def test_a_newer_calibration_is_chosen_by_an_option(root: Path, tmp_path: Path, desk: Shell) -> None:
    """A folder below a storage root knows that root; by itself a scan keeps the calibration it was taken with."""
    mine = Path(shutil.copytree(root, tmp_path / "root"))
    scan = mine / "scans" / "000001"
    (mine / "calibration").mkdir(exist_ok=True)
    newer = changed(scan, mine / "calibration" / "current.json", made_at="2031-01-01T00:00:00+00:00")
    out = tmp_path / "x.ply"
    for words, same in (((scan,), True), ((1, "--root", mine, "--current"), False)):
        said = desk("reconstruct", *words, "--out", out, "--json")
        assert said.code == 0, said.err
        assert said.document["same_calibration"] is same
        assert said.document["calibration_from"] == ("the scan's own" if same else str(newer))
    newer.unlink()
    said = desk("reconstruct", scan, "--current", "--out", out)
    assert (said.code, str(newer) in said.error) == (1, True)


# --------------------------------------------------------------------------------------- what is wrong


def test_a_lost_or_damaged_cloud_is_made_again_from_the_frames(copy: Path, tmp_path: Path, desk: Shell) -> None:
    stored = (copy / "cloud.ply").read_bytes()
    (copy / "cloud.ply").write_bytes(stored[:-7])
    (copy / "preview.png").write_bytes(b"\0")  # keeps nobody from the raw frames
    said = desk("reconstruct", copy, "--out", tmp_path / "again.ply", "--json")
    assert said.code == 0, said.err
    assert said.document["stored_cloud"].endswith("made again, byte for byte")
    assert (tmp_path / "again.ply").read_bytes() == stored


def spoil_frames(copy: Path, side: str, *names: str) -> None:
    """Make 100 bytes in the middle of each of these frames zero, as a lost sector does."""
    patterns = json.loads((copy / "manifest.json").read_text(encoding="utf-8"))["record"]["sequence"]["patterns"]
    path = copy / f"frames_{side}.npy"
    raw = bytearray(path.read_bytes())
    for name in names:
        start = 128 + patterns.index(name) * 360 * 270 + 135 * 360 + 130
        raw[start : start + 100] = bytes(100)
    path.write_bytes(raw)


@pytest.mark.parametrize(("side", "name"), [("left", "sine-x-90"), ("right", "dark")])
def test_what_does_not_need_the_damaged_frame_is_salvaged_and_marked(
    copy: Path, tmp_path: Path, desk: Shell, side: str, name: str
) -> None:
    """Beside the points of the whole scan: hardly fewer, in the same places, and expected to be no better than they are."""
    stored = read_ply(copy / "cloud.ply")
    spoil_frames(copy, side, name)
    out = tmp_path / "s.ply"
    said = desk("reconstruct", copy, "--out", out)
    assert (said.code, f"frames_{side}.npy" in said.error, f"in {name};" in said.error) == (1, True, True)
    said = desk("reconstruct", copy, "--salvage", "--out", out, "--json")
    assert said.code == 0, said.err
    assert any(f"{name} was made up from" in text for text in said.document["salvaged"])
    made = read_ply(out)
    assert made.salvaged is not None
    assert name in made.salvaged
    # Where three steps leave the range of grey values, there is none.
    assert 0.9 < len(made.points_mm) / len(stored.points_mm) < 1.01
    some = made.points_mm[::97].astype(float)
    nearest_mm = [float(np.min(np.linalg.norm(stored.points_mm - point, axis=1))) for point in some]
    assert float(np.median(nearest_mm)) < 0.1
    assert float(np.percentile(nearest_mm, 95)) < 0.6
    worse = float(np.median(made.sigma_mm) / np.median(stored.sigma_mm))
    assert (1.1 < worse < 2.3) if "sine" in name else worse == pytest.approx(1.0, abs=0.05)


def test_a_damaged_scan_is_never_evaluated_merged_or_measured_and_not_everything_can_be_missed(
    root: Path, copy: Path, tmp_path: Path, desk: Shell
) -> None:
    spoil_frames(copy, "left", "gray-x-3")
    (tmp_path / "list.toml").write_text(f'[[scan]]\nscan = "{copy}"\nartefact = "frustum"\ntop_mm = 80.0\n')
    for words in (
        ("evaluate", tmp_path / "list.toml", "--out", tmp_path / "x.html"),
        ("measure", "noise", copy),
        ("measure", "response", copy, "--out", tmp_path / "r.json"),
        ("scans", "merge", copy, root / "scans" / "000001", "--out", tmp_path / "m.ply"),
        ("reconstruct", copy, "--salvage", "--out", tmp_path / "s.ply"),
    ):
        said = desk(*words)
        assert (said.code, "gray-x-3" in said.error) == (1, True), words
        assert "--salvage" in words or desk(*words, "--salvage").code == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["copied", "list.toml"]


def test_the_same_scan_is_not_merged_with_itself(root: Path, copy: Path, tmp_path: Path, desk: Shell) -> None:
    """It was, with exit code 0 and less noise than there is by the root of two."""
    out = tmp_path / "m.ply"
    for words in ((1, 1, "--root", root), (copy, root / "scans" / "000001")):
        said = desk("scans", "merge", *words, "--out", out)
        assert (said.code, "same frames" in said.error, out.exists()) == (1, True, False)


def test_no_cloud_is_made_of_half_the_frames_without_a_manifest_or_with_the_drawing_in_silence(
    copy: Path, tmp_path: Path, desk: Shell
) -> None:
    def refused(*words: str) -> None:
        said = desk("reconstruct", copy, "--out", tmp_path / "x.ply")
        assert (said.code, (tmp_path / "x.ply").exists()) == (1, False)
        assert all(word in said.error for word in (str(copy), *words)), said.error

    own = (copy / "calibration.json").read_bytes()
    (copy / "calibration.json").write_bytes(own[:-1])
    refused("--calibration FILE", "--current")
    (copy / "calibration.json").write_bytes(own)
    (copy / "frames_left.npy").write_bytes((copy / "frames_left.npy").read_bytes()[:1000])
    refused("frames_left.npy", f"1000 bytes instead of {FRAMES_BYTES}", "24 frames")
    (copy / "manifest.json").unlink()
    refused("manifest.json", "missing")


def test_a_disk_that_refuses_is_no_crash_and_half_a_cloud_does_not_stay(root: Path, tmp_path: Path) -> None:
    out = tmp_path / "cloud.ply"
    said = kingfisher("reconstruct", 1, "--root", root, "--out", out, most_bytes=100_000)
    assert said.code == 1
    # On a busy machine lines of progress come first.
    last = said.err.splitlines()[-1]
    assert f"{out}: File too large" in last
    assert "--out" in last
    assert list(tmp_path.iterdir()) == []


def test_an_unusable_target_and_an_unknown_scan_are_refused_before_the_work(
    root: Path, tmp_path: Path, desk: Shell
) -> None:
    for out, word in (
        (tmp_path / "no" / "x.ply", "no folder"),
        (tmp_path, "is a folder"),
        ("/dev/null", "no ordinary file"),
    ):
        said = desk("reconstruct", 1, "--root", root, "--out", out)
        assert (said.code, f"--out {out}" in said.error, word in said.error) == (2, True, True)
    said = desk("reconstruct", 77, "--root", root)
    assert (said.code, "'77'" in said.error, "scans list" in said.error) == (1, True, True)
    assert desk("reconstruct", 1, "--root", tmp_path / "none").code == 2
