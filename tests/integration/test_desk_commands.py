"""One dive by script, and then everything the desk can make of what it left behind, wherever it was copied to."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
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
press back            # UNCALIBRATED: seen
press scan
wait state REVIEW 60
pause 1
press scan            # keep
wait state AIM 60
press scan
wait state REVIEW 60
press back 1.2        # held: repeat: this one is not wanted
wait state AIM 60
end
"""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A storage root after a dive with cameras of a size that no rig file has: one scan kept, one rejected."""
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
    """A calibration file with something else in it than in the scan's own."""
    own = calibration_file.load(copy / "calibration.json")
    to.write_bytes(calibration_file.encode(replace(own, **what)))  # type: ignore[arg-type]
    return to


# ----------------------------------------------------------------------------------- what is there


def test_the_scans_are_listed_shown_and_verified(root: Path, desk: Shell) -> None:
    listed = desk("scans", "list", "--root", root)
    assert listed.code == 0
    _, line = listed.out.splitlines()
    assert line.split()[:2] == ["000001", "saved"]
    listed = desk("scans", "list", "--all", "--root", root, "--json")
    assert [(one["scan"], one["shelf"], one["ok"]) for one in listed.document] == [
        ("000001", "scans", True),
        ("000002", "rejected", True),
    ]
    shown = desk("scans", "show", 1, "--root", root)
    assert shown.lines["manifest.record.sequence.period_px"] == "16"
    assert shown.lines["manifest.decision"] == "kept"
    points = desk("scans", "show", 1, "--root", root, "--json").document["points"]
    assert shown.lines["points"] == str(points)
    verified = desk("scans", "verify", "--all", "--root", root)
    assert (verified.code, verified.out.splitlines()[-1]) == (0, "2 checked, 0 damaged")
    assert desk("scans", "verify", "--root", root, "--json").document["checked"] == 1


def test_a_folder_that_was_copied_elsewhere_is_shown_and_verified(copy: Path, desk: Shell) -> None:
    shown = desk("scans", "show", copy)
    assert (shown.code, shown.lines["manifest.decision"]) == (0, "kept")
    verified = desk("scans", "verify", copy)
    assert (verified.code, verified.out) == (0, "copied  ok\n1 checked, 0 damaged\n")
    frames = copy / "frames_left.npy"
    raw = bytearray(frames.read_bytes())
    raw[128 + 3 * 360 * 270 + 77] ^= 1
    frames.write_bytes(raw)
    verified = desk("scans", "verify", copy)
    assert verified.code == 4
    assert "frames_left.npy: damaged (its checksum does not fit) in gray-x-1" in verified.out
    said = desk("scans", "verify", copy.parent / "nothing")
    assert (said.code, "no such folder" in said.error) == (2, True)


def test_a_copied_folder_under_another_number_is_told(root: Path, tmp_path: Path, desk: Shell) -> None:
    shutil.copytree(root / "scans" / "000001", tmp_path / "scans" / "000007")
    said = desk("scans", "verify", 7, "--root", tmp_path)
    assert (said.code, "its manifest is of scan 000001" in said.out) == (4, True)


# ----------------------------------------------------------------------- the same cloud again, anywhere


def test_a_folder_copied_anywhere_gives_the_bytes_that_the_instrument_stored(
    copy: Path, tmp_path: Path, desk: Shell
) -> None:
    """Without a rig file, a storage root or a calibration beside it. It gave 0 points and exit code 0."""
    out = tmp_path / "c.ply"
    made = desk("reconstruct", copy, "--out", out, "--json")
    assert made.code == 0, made.err
    assert made.err == ""
    assert out.read_bytes() == (copy / "cloud.ply").read_bytes()
    assert made.document["points"] > 10_000
    assert made.document["calibration_from"] == "the scan's own"
    assert made.document["stored_cloud"] == "the same, byte for byte"


def test_a_scan_carries_the_rig_with_the_size_that_was_asked_for(copy: Path) -> None:
    rig = load_rig(copy / "rig.toml")
    assert (rig.camera.left.width_px, rig.camera.right.height_px) == (360, 270)
    manifest = json.loads((copy / "manifest.json").read_text(encoding="utf-8"))
    assert rig.rig_hash == manifest["record"]["rig_hash"]
    assert calibration_file.load(copy / "calibration.json").hash == manifest["record"]["calibration_hash"]


def test_a_number_is_reconstructed_without_a_rig_file(root: Path, tmp_path: Path, desk: Shell) -> None:
    for number, least in ((1, 10_000), (2, 10_000)):
        made = desk("reconstruct", number, "--root", root, "--out", tmp_path / "x.ply", "--json")
        assert made.code == 0, made.err
        assert made.document["points"] > least
        assert made.document["same_calibration"] is True


def test_the_cloud_lies_beside_the_caller_where_nothing_else_was_said(
    copy: Path, desk: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    plain = desk("reconstruct", copy)
    assert plain.code == 0, plain.err
    assert plain.lines["file"] == "copied.ply"
    assert plain.lines["points"] == str(len(read_ply(tmp_path / "copied.ply").points_mm))


# ----------------------------------------------------------------------------- which calibration


def test_another_instruments_calibration_is_refused_unless_that_is_said(
    copy: Path, tmp_path: Path, desk: Shell
) -> None:
    """KF-0001's drawing on KF-SIM's scan gave 0 points, exit code 0 and not a word."""
    own = calibration_file.load(copy / "calibration.json")
    other = changed(copy, tmp_path / "other.json", rig_serial="KF-0001")
    out = tmp_path / "w.ply"
    for words in (("reconstruct", copy), ("scans", "merge", copy, copy)):
        said = desk(*words, "--calibration", other, "--out", out)
        assert said.code == 1
        for word in (str(other), "KF-0001", own.rig_serial, "--calibration FILE", "--foreign-calibration"):
            assert word in said.error
        assert not out.exists()
    said = desk("reconstruct", copy, "--calibration", other, "--foreign-calibration", "--out", out, "--json")
    assert said.code == 0, said.err
    assert said.document["same_calibration"] is False
    assert out.read_bytes() == (copy / "cloud.ply").read_bytes(), "but for its name it is the same"


def test_a_calibration_that_leaves_no_points_is_no_success(copy: Path, tmp_path: Path, desk: Shell) -> None:
    own = calibration_file.load(copy / "calibration.json")
    t = own.rig.right.translation_mm
    right = replace(own.rig.right, translation_mm=(t[0], t[1] + 10.0, t[2]))
    knocked = changed(copy, tmp_path / "knocked.json", rig=replace(own.rig, right=right))
    out = tmp_path / "none.ply"
    said = desk("reconstruct", copy, "--calibration", knocked, "--out", out)
    assert said.code == 1
    for word in (str(copy), "points are left of", "do not meet", "--calibration FILE"):
        assert word in said.error
    assert not out.exists()


def test_a_calibration_of_another_image_size_is_refused(copy: Path, tmp_path: Path, desk: Shell) -> None:
    nominal = tmp_path / "nominal.json"
    assert desk("calibration", "nominal", "--out", nominal).code == 0
    said = desk("reconstruct", copy, "--calibration", nominal, "--foreign-calibration", "--out", tmp_path / "x.ply")
    assert said.code == 1
    for word in (str(nominal), "360x270", "1600x1200", "--calibration"):
        assert word in said.error
    assert not (tmp_path / "x.ply").exists()


def test_a_rig_file_of_another_image_size_is_refused(copy: Path, desk: Shell) -> None:
    for verb in (("reconstruct",), ("measure", "noise"), ("measure", "response")):
        said = desk(*verb, copy, "--rig", SMALL_RIG)
        assert said.code == 1
        for word in ("360x270", "400x300", "--rig"):
            assert word in said.error


def test_a_newer_calibration_is_chosen_by_an_option(root: Path, tmp_path: Path, desk: Shell) -> None:
    """A folder below a storage root knows that root; by itself a scan keeps the calibration it was taken with."""
    mine = Path(shutil.copytree(root, tmp_path / "root"))
    scan = mine / "scans" / "000001"
    (mine / "calibration").mkdir(exist_ok=True)
    newer = changed(scan, mine / "calibration" / "current.json", made_at="2031-01-01T00:00:00+00:00")
    out = tmp_path / "x.ply"
    for words, same in (((scan,), True), ((scan, "--current"), False), ((1, "--root", mine, "--current"), False)):
        said = desk("reconstruct", *words, "--out", out, "--json")
        assert said.code == 0, said.err
        assert said.document["same_calibration"] is same
        assert said.document["calibration_from"] == ("the scan's own" if same else str(newer))
    newer.unlink()
    said = desk("reconstruct", scan, "--current", "--out", out)
    assert (said.code, str(newer) in said.error) == (1, True)


def test_a_calibration_that_is_missing_is_never_replaced_by_the_drawing_in_silence(
    copy: Path, tmp_path: Path, desk: Shell
) -> None:
    """The scan's own is damaged."""
    own = (copy / "calibration.json").read_bytes()
    elsewhere = tmp_path / "kept.json"
    elsewhere.write_bytes(own)
    taken_with = calibration_file.load(elsewhere).hash
    (copy / "calibration.json").write_bytes(own[:-1])
    out, rig = tmp_path / "x.ply", tmp_path / "rig.toml"
    text = (copy / "rig.toml").read_text(encoding="utf-8")
    text = text.replace(str(load_rig(copy / "rig.toml").storage.root), str(tmp_path / "nowhere"))
    rig.write_text(text, encoding="utf-8")
    said = desk("reconstruct", copy, "--rig", rig, "--out", out)
    assert said.code == 1
    for word in (str(copy), taken_with[:12], "--calibration FILE", "--current"):
        assert word in said.error
    assert not out.exists()
    assert desk("reconstruct", copy, "--calibration", elsewhere, "--out", out).code == 0


# --------------------------------------------------------------------------------------- what is wrong


def test_a_lost_or_damaged_cloud_is_made_again_from_the_frames(copy: Path, tmp_path: Path, desk: Shell) -> None:
    stored = (copy / "cloud.ply").read_bytes()
    out = tmp_path / "again.ply"
    (copy / "cloud.ply").write_bytes(stored[:-7])
    said = desk("reconstruct", copy, "--out", out, "--json")
    assert said.code == 0, said.err
    assert "bytes instead of" in said.document["stored_cloud"]
    assert said.document["stored_cloud"].endswith("made again, byte for byte")
    assert out.read_bytes() == stored
    (copy / "cloud.ply").unlink()
    said = desk("reconstruct", copy, "--out", out, "--json")
    assert (said.code, said.document["stored_cloud"]) == (0, "cloud.ply: missing; made again, byte for byte")


def spoil_frames(copy: Path, side: str, *names: str) -> None:
    """100 bytes in the middle of each of these frames become zero, as a lost sector does."""
    patterns = json.loads((copy / "manifest.json").read_text(encoding="utf-8"))["record"]["sequence"]["patterns"]
    path = copy / f"frames_{side}.npy"
    raw = bytearray(path.read_bytes())
    for name in names:
        start = 128 + patterns.index(name) * 360 * 270 + 135 * 360 + 130
        raw[start : start + 100] = bytes(100)
    path.write_bytes(raw)


@pytest.mark.parametrize(
    ("side", "name"), [("left", "sine-x-90"), ("right", "sine-y-0"), ("left", "bright"), ("right", "dark")]
)
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
    assert 0.9 < len(made.points_mm) / len(stored.points_mm) < 1.01, (
        "where three steps leave the range of grey values, none"
    )
    some = made.points_mm[::97].astype(float)
    nearest_mm = [float(np.min(np.linalg.norm(stored.points_mm - point, axis=1))) for point in some]
    assert float(np.median(nearest_mm)) < 0.1
    assert float(np.percentile(nearest_mm, 95)) < 0.6
    worse = float(np.median(made.sigma_mm) / np.median(stored.sigma_mm))
    assert (1.1 < worse < 2.3) if "sine" in name else worse == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("gray-x-3",), ("gray-x-3 cannot be missed", "which fringe")),
        (("sine-x-0", "sine-x-180"), ("two of the four sine images",)),
        (("bright", "dark"), ("bright and dark",)),
    ],
)
def test_what_cannot_be_missed_is_said(
    copy: Path, tmp_path: Path, desk: Shell, names: tuple[str, ...], words: tuple[str, ...]
) -> None:
    spoil_frames(copy, "left", *names)
    out = tmp_path / "s.ply"
    said = desk("reconstruct", copy, "--salvage", "--out", out)
    assert said.code == 1
    for word in (*words, "copy"):
        assert word in said.error
    assert not out.exists()


def test_nothing_is_called_salvaged_that_was_whole(copy: Path, tmp_path: Path, desk: Shell) -> None:
    out = tmp_path / "s.ply"
    said = desk("reconstruct", copy, "--salvage", "--out", out, "--json")
    assert (said.code, said.document["salvaged"]) == (0, None)
    assert out.read_bytes() == (copy / "cloud.ply").read_bytes()


def test_a_damaged_scan_is_never_evaluated_merged_or_measured(
    root: Path, copy: Path, tmp_path: Path, desk: Shell
) -> None:
    spoil_frames(copy, "left", "sine-x-90")
    (tmp_path / "list.toml").write_text(f'[[scan]]\nscan = "{copy}"\nartefact = "frustum"\ntop_mm = 80.0\n')
    for words in (
        ("evaluate", tmp_path / "list.toml", "--out", tmp_path / "x.html"),
        ("measure", "noise", copy),
        ("measure", "response", copy, "--out", tmp_path / "r.json"),
        ("scans", "merge", copy, root / "scans" / "000001", "--out", tmp_path / "m.ply"),
    ):
        said = desk(*words)
        assert (said.code, "in sine-x-90;" in said.error) == (1, True)
        assert desk(*words, "--salvage").code == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["copied", "list.toml"]


def test_the_same_scan_is_not_merged_with_itself(root: Path, copy: Path, tmp_path: Path, desk: Shell) -> None:
    """It was, with exit code 0 and less noise than there is by the root of two."""
    out = tmp_path / "m.ply"
    for words in ((1, 1, "--root", root), (copy, root / "scans" / "000001"), (copy, 1, "--root", root)):
        said = desk("scans", "merge", *words, "--out", out)
        assert (said.code, "same frames" in said.error) == (1, True)
        assert not out.exists()


def flip_a_bit(folder: Path) -> None:
    path = folder / "frames_right.npy"
    raw = bytearray(path.read_bytes())
    raw[5000] ^= 1
    path.write_bytes(raw)


def cut(folder: Path) -> None:
    path = folder / "frames_left.npy"
    path.write_bytes(path.read_bytes()[:1000])


def lose_manifest(folder: Path) -> None:
    (folder / "manifest.json").unlink()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (flip_a_bit, ("frames_right.npy", "damaged", "in bright", "copy", "--salvage")),
        (cut, ("frames_left.npy", f"1000 bytes instead of {FRAMES_BYTES}", "24 frames")),
        (lose_manifest, ("manifest.json", "missing")),
    ],
)
def test_no_cloud_is_made_of_a_damaged_scan(
    spoil: Callable[[Path], None], words: tuple[str, ...], copy: Path, tmp_path: Path, desk: Shell
) -> None:
    spoil(copy)
    out = tmp_path / "x.ply"
    said = desk("reconstruct", copy, "--out", out, "--json")
    assert said.code == 1
    text = json.loads(said.error)["error"]
    for word in (str(copy), *words):
        assert word in text
    assert not out.exists()


def test_a_damaged_preview_keeps_nobody_from_the_raw_frames(copy: Path, tmp_path: Path, desk: Shell) -> None:
    path = copy / "preview.png"
    path.write_bytes(bytes(len(path.read_bytes())))
    said = desk("reconstruct", copy, "--out", tmp_path / "x.ply")
    assert said.code == 0, said.err


def test_a_disk_that_refuses_is_no_crash_and_half_a_cloud_does_not_stay(root: Path, tmp_path: Path) -> None:
    out = tmp_path / "cloud.ply"
    words = ("reconstruct", 1, "--root", root, "--out")
    said = kingfisher(*words, out, most_bytes=100_000)
    assert said.code == 1
    # On a busy machine lines of progress come first.
    last = said.error.splitlines()[-1]
    assert last.startswith(f"kingfisher: cannot write {out}: File too large")
    assert "--out" in last
    assert list(tmp_path.iterdir()) == []
    said = kingfisher(*words, "/dev/null")
    assert (said.code, "no ordinary file" in said.error) == (2, True)


def test_an_unusable_target_is_refused_before_the_work(root: Path, tmp_path: Path, desk: Shell) -> None:
    for out, word in ((tmp_path / "no" / "x.ply", "no folder"), (tmp_path, "is a folder")):
        said = desk("reconstruct", 1, "--root", root, "--out", out)
        assert said.code == 2
        assert said.error.startswith(f"kingfisher: --out {out}:")
        assert word in said.error


def test_an_unknown_scan_and_an_unknown_root(root: Path, tmp_path: Path, desk: Shell) -> None:
    for verb in (("scans", "show"), ("scans", "verify"), ("reconstruct",)):
        said = desk(*verb, 77, "--root", root)
        assert (said.code, "'77'" in said.error, "scans list" in said.error) == (1, True, True)
        said = desk(*verb, 1, "--root", tmp_path / "none")
        assert (said.code, "--root" in said.error) == (2, True)
