"""Everything that the desk makes of a stored scan, wherever it was copied to: the same cloud again, another one, or one line that says why not."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from appliance.measure.calibration import file as calibration_file
from appliance.store.config import default_rig_path
from appliance.store.instrument import load_calibration
from appliance.store.ply import read_ply
from tests.support.commands import Shell, kingfisher
from tests.support.planes import small_rig, store_plane

WIDTH_PX, HEIGHT_PX = 400, 300
FRAMES_BYTES = 128 + 24 * WIDTH_PX * HEIGHT_PX


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A storage root with one scan, of cameras of a size that the packaged rig file does not have."""
    root = tmp_path_factory.mktemp("dive") / "root"
    store_plane(small_rig(root))
    return root


@pytest.fixture
def desk(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys)


@pytest.fixture
def copy(root: Path, tmp_path: Path) -> Path:
    """The scan, copied to where nothing else of the instrument is."""
    return Path(shutil.copytree(root / "scans" / "000001", tmp_path / "copied"))


def changed(copy: Path, to: Path, **what: object) -> Path:
    """Write a calibration file with something else in it than in the scan's own."""
    own = load_calibration(copy / "calibration.json")
    to.write_bytes(calibration_file.encode_calibration(replace(own, **what)))  # type: ignore[arg-type]
    return to


def test_a_folder_copied_anywhere_gives_the_bytes_that_the_instrument_stored(
    copy: Path, tmp_path: Path, desk: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a rig file, a storage root or a calibration beside it."""
    assert desk("scans", "verify", copy).out == "copied  ok\n1 checked, 0 damaged\n"
    monkeypatch.chdir(tmp_path)
    made = desk("cloud", copy, "--json")
    assert made.code == 0, made.err
    stored = (copy / "cloud.ply").read_bytes()
    assert (tmp_path / "copied.ply").read_bytes() == stored
    said = made.document
    assert (said["calibration_from"], said["salvaged"]) == ("the scan's own", None)
    assert said["stored_cloud"] == "the same, byte for byte"
    (copy / "cloud.ply").write_bytes(stored[:-7])
    (copy / "preview.png").write_bytes(b"\0")  # keeps nobody from the raw frames
    again = desk("cloud", copy, "--out", "again.ply", "--json")
    assert again.document["stored_cloud"].endswith("computed again, equal byte for byte")
    assert (tmp_path / "again.ply").read_bytes() == stored


def test_another_instruments_calibration_is_refused_unless_that_is_said_and_a_newer_one_is_chosen_by_an_option(
    root: Path, copy: Path, tmp_path: Path, desk: Shell
) -> None:
    other, out = changed(copy, tmp_path / "other.json", rig_serial="KF-0007"), tmp_path / "w.ply"
    for words in (("cloud", copy), ("cloud", f"{copy}+{copy}")):
        said = desk(*words, "--calibration", other, "--out", out)
        assert (said.code, out.exists()) == (1, False)
        assert all(word in said.error for word in (str(other), "KF-0007", "KF-0001", "--foreign-calibration"))
    said = desk("cloud", copy, "--calibration", other, "--foreign-calibration", "--out", out, "--json")
    assert (said.code, said.document["same_calibration"]) == (0, False)
    assert out.read_bytes() == (copy / "cloud.ply").read_bytes(), "but for its name it is the same"

    # A folder below a storage root knows that root; by itself a scan keeps the calibration it was taken with.
    mine = Path(shutil.copytree(root, tmp_path / "root"))
    scan, newer = mine / "scans" / "000001", mine / "calibration" / "current.json"
    newer.parent.mkdir(exist_ok=True)
    changed(scan, newer, made_at="2031-01-01T00:00:00+00:00")
    for more, used in ((), "the scan's own"), (("--current",), str(newer)):
        found = desk("cloud", scan, *more, "--out", out, "--json").document
        assert (found["same_calibration"], found["calibration_from"]) == (not more, used)
    newer.unlink()
    said = desk("cloud", scan, "--current", "--out", out)
    assert (said.code, str(newer) in said.error) == (1, True)


def test_what_gives_no_cloud_is_one_line_that_names_it(copy: Path, tmp_path: Path, desk: Shell) -> None:
    def refused(*words: str, options: tuple[object, ...] = ()) -> None:
        said = desk("cloud", copy, *options, "--out", tmp_path / "x.ply")
        assert (said.code, (tmp_path / "x.ply").exists()) == (1, False)
        assert all(word in said.error for word in words), said.error

    own = load_calibration(copy / "calibration.json")
    x, y, z = own.rig.right.translation_mm
    right = replace(own.rig.right, translation_mm=(x, y + 10.0, z))
    knocked = changed(copy, tmp_path / "knocked.json", rig=replace(own.rig, right=right))
    refused(str(copy), "points are left of", "--calibration FILE", options=("--calibration", knocked))
    assert desk("calibration", "show", "nominal", "--out", tmp_path / "nominal.json").code == 0
    refused("400x300", "1600x1200", options=("--calibration", tmp_path / "nominal.json"))
    refused("400x300", "1600x1200", "--rig", options=("--rig", default_rig_path()))
    data = (copy / "calibration.json").read_bytes()
    (copy / "calibration.json").write_bytes(data[:-1])
    refused("--calibration FILE", "--current")  # and not the drawing, in silence
    (copy / "calibration.json").write_bytes(data)
    (copy / "frames_left.npy").write_bytes((copy / "frames_left.npy").read_bytes()[:1000])
    refused(str(copy), "frames_left.npy", f"1000 bytes instead of {FRAMES_BYTES}", "24 frames")
    (copy / "manifest.json").unlink()
    refused("manifest.json", "missing")


def spoil_frame(copy: Path, side: str, name: str) -> None:
    """Make 100 bytes in the middle of a frame zero, as a lost sector does."""
    patterns = json.loads((copy / "manifest.json").read_text(encoding="utf-8"))["record"]["sequence"]["patterns"]
    path = copy / f"frames_{side}.npy"
    raw = bytearray(path.read_bytes())
    start = 128 + (patterns.index(name) * HEIGHT_PX + HEIGHT_PX // 2) * WIDTH_PX + 130
    raw[start : start + 100] = bytes(100)
    path.write_bytes(raw)


@pytest.mark.parametrize(("side", "name"), [("left", "sine-x-90"), ("right", "dark")])
def test_what_does_not_need_the_damaged_frame_is_salvaged_and_marked(
    copy: Path, tmp_path: Path, desk: Shell, side: str, name: str
) -> None:
    """Beside the points of the whole scan: hardly fewer, in the same places, and expected to be no better than they are."""
    stored, out = read_ply(copy / "cloud.ply"), tmp_path / "s.ply"
    spoil_frame(copy, side, name)
    said = desk("cloud", copy, "--out", tmp_path / "s.npz")
    assert (said.code, f"frames_{side}.npy" in said.error, f"in {name};" in said.error) == (1, True, True)
    said = desk("cloud", copy, "--out", out, "--json")
    assert (said.code, "do not measure in it" in said.err) == (4, True)
    assert any(f"{name} is computed from" in text for text in said.document["salvaged"])
    made = read_ply(out)
    assert name in (made.salvaged or "")
    # Where three steps leave the range of grey values, there is none.
    assert 0.9 < len(made.points_mm) / len(stored.points_mm) < 1.01
    nearest_mm, _ = cKDTree(stored.points_mm).query(made.points_mm[::97])
    assert (np.median(nearest_mm) < 0.1, np.percentile(nearest_mm, 95) < 0.6) == (True, True)
    worse = float(np.median(made.sigma_mm) / np.median(stored.sigma_mm))
    assert (1.1 < worse < 2.3) if "sine" in name else worse == pytest.approx(1.0, abs=0.05)


def test_a_damaged_scan_is_never_evaluated_merged_or_measured_and_no_scan_is_merged_with_itself(
    root: Path, copy: Path, tmp_path: Path, desk: Shell
) -> None:
    out = tmp_path / "m.ply"
    for words in (("1+1", "--root", root), (f"{copy}+{root / 'scans' / '000001'}",)):
        said = desk("cloud", *words, "--out", out)
        assert (said.code, "same frames" in said.error, out.exists()) == (1, True, False)
    spoil_frame(copy, "left", "gray-x-3")
    (tmp_path / "list.toml").write_text(f'[[scan]]\nscan = "{copy}"\nartefact = "frustum"\ntop_mm = 80.0\n')
    for verb in (
        ("evaluate", tmp_path / "list.toml", "--out", tmp_path / "x.html"),
        ("calibration", "measure", "noise", copy),
        ("calibration", "measure", "response", copy, "--out", tmp_path / "r.json"),
        ("cloud", f"{copy}+{root / 'scans' / '000001'}", "--out", out),
        ("cloud", copy, "--out", tmp_path / "s.ply"),  # not everything can be missed
    ):
        said = desk(*verb)
        assert (said.code, "gray-x-3" in said.error) == (1, True), verb
    assert sorted(path.name for path in tmp_path.iterdir()) == ["copied", "list.toml"]


def test_a_disk_that_refuses_is_no_crash_leaves_no_half_cloud_and_unusable_targets_are_refused_before_the_work(
    root: Path, tmp_path: Path, desk: Shell
) -> None:
    out = tmp_path / "cloud.ply"
    said = kingfisher("cloud", 1, "--root", root, "--out", out, most_bytes=100_000)
    last = said.err.splitlines()[-1]  # on a busy machine lines of progress come first
    assert (said.code, f"{out}: File too large" in last, "--out" in last) == (1, True, True)
    assert list(tmp_path.iterdir()) == []
    for target, word in (
        (tmp_path / "no" / "x.ply", "no folder"), (tmp_path, "is a folder"), ("/dev/null", "not a regular file"),
    ):  # fmt: skip
        said = desk("cloud", 1, "--root", root, "--out", target)
        assert (said.code, f"--out {target}" in said.error, word in said.error) == (2, True, True)
    said = desk("cloud", 77, "--root", root)
    assert (said.code, "'77'" in said.error, "scans list" in said.error) == (1, True, True)
