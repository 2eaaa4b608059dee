"""``kingfisher calibrate pair`` calibrates two cameras of others from their pictures by one command, or says why not."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from appliance.calibration.file import load
from appliance.cli import main
from appliance.foreign.cameras import read_rig
from appliance.foreign.description import parse_description
from appliance.optics.pinhole import Lens
from tests.support.any_boards import BASE_MM, F_PX, HEIGHT_PX, WIDTH_PX, Printed, poses, write_pairs

COUNT = 7


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Seven pairs of a board of the old layout; in the last one it fills an eighth of the picture; one camera has an eighth view alone."""
    folder = tmp_path_factory.mktemp("theirs")
    where = poses(COUNT + 1, 3)
    far = poses(1, 5, 470.0, 475.0)
    write_pairs(folder, Printed(), [*where[: COUNT - 1], *far, where[COUNT]])
    (folder / f"v{COUNT}_right.png").unlink()
    return folder


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, Any, str]:
    code = main(["calibrate", "pair", *words, "--square-mm", "15", "--json"])
    said = capsys.readouterr()
    return code, json.loads(said.out) if said.out else None, said.err


def test_a_folder_of_others_becomes_a_calibration(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mine.json"
    code, report, said = run(capsys, str(recorded), "--out", str(out))
    assert code == 0
    assert report["board"].startswith("11x8 squares of 15 mm, markers of 11")
    assert report["board"].endswith("DICT_5X5_50, layout before OpenCV 4.6")
    assert report["pairs"] == [f"v{k}" for k in range(COUNT)]
    assert report["left_out"] == []
    assert report["residual_px"] < 0.08
    assert report["views"][-1]["remarks"] == ["only the left camera has it"]
    small = re.fullmatch(r"the board fills ([\d.]+) % of the left picture", report["views"][COUNT - 1]["remarks"][0])
    assert small is not None
    assert float(small[1]) == pytest.approx(12.5, abs=1.2)
    assert f"the board is small in 1 of {COUNT + 1} views (v{COUNT - 1}): " in said
    for f_px, sd_px in zip(report["principal_distance_px"], report["principal_distance_sd_px"], strict=True):
        assert abs(f_px - F_PX) < max(5.0 * sd_px, 1.0)
        assert sd_px < 3.0
    assert report["baseline_mm"] == pytest.approx(BASE_MM, rel=5e-3)
    assert "coverage is poor: no corners yet" in said

    start = load(out)
    assert (start.method, start.rig_serial) == ("air", recorded.name)
    assert any("layout before OpenCV 4.6" in text for text in start.made_from)
    assert (start.rig.left.width_px, start.rig.left.height_px) == (WIDTH_PX, HEIGHT_PX)
    for path in report["pictures"]:
        assert cv2.imread(path) is not None


@pytest.fixture(scope="module")
def mine(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "mine.json"
    words = ["--square-mm", "15", "--out", str(out), "--board", "8x11", "--marker-mm", "11.25"]
    assert main(["calibrate", "pair", str(recorded), *words]) == 0
    return out


def test_opencv_reads_the_same_cameras(mine: Path) -> None:
    """A point of space goes to the same pixels by OpenCV's own projection with the file for it."""
    store = cv2.FileStorage(str(mine.with_suffix(".yml")), cv2.FILE_STORAGE_READ)
    point = np.array([[12.0, -7.0, 350.0]])
    camera = load(mine).rig.right
    local = (point - np.array(camera.translation_mm)) @ np.array(camera.rotation)
    ours = Lens(camera.lens.f_px, camera.lens.c_px, camera.lens.distortion).to_pixels(local[:, :2] / local[:, 2:])
    R, T, M, D = (store.getNode(name).mat() for name in ("R", "T", "M2", "D2"))
    theirs, _ = cv2.projectPoints(point, cv2.Rodrigues(R)[0], T, M, D)
    assert np.allclose(np.ravel(theirs), np.ravel(ours), atol=1e-6)
    assert T[0, 0] < 0.0


PLANE_MM, DOTS_PER_MM, PERIOD_PX = 360.0, 4.0, 32


def draw_fringes(folder: Path, side: str) -> None:
    """What one of the two parallel cameras sees of fringes and their code on a plane that faces it."""
    across_mm = (np.arange(WIDTH_PX) - (WIDTH_PX - 1) / 2) * PLANE_MM / F_PX + (BASE_MM if side == "right" else 0.0)
    edge_px = 512.0 + DOTS_PER_MM * (across_mm - BASE_MM / 2)
    number = np.floor(edge_px / PERIOD_PX).astype(int)
    lines = [120.0 + 100.0 * np.cos(2 * np.pi * edge_px / PERIOD_PX + 0.5 * np.pi * k) for k in range(4)]
    lines += [np.where((number ^ (number >> 1)) >> bit & 1, 220.0, 20.0) for bit in reversed(range(5))]
    (folder / side).mkdir(parents=True)
    for k, line in enumerate(lines):
        image = np.broadcast_to(np.rint(line).astype(np.uint8), (HEIGHT_PX, WIDTH_PX))
        assert cv2.imwrite(str(folder / side / f"{k:02d}.png"), np.ascontiguousarray(image))


def test_import_measures_in_air_with_the_file_that_was_written(
    mine: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was taken for a rig in water: a plane at 360 mm came out at 489."""
    for side in ("left", "right"):
        draw_fringes(tmp_path, side)
    shutil.copy(mine, tmp_path / "x.json")
    described = tmp_path / "plane.toml"
    described.write_text(
        f"""[images]
left = "left/*.png"
right = "right/*.png"
order = "sine-x*4 gray-x*5"
[projector]
width_px = 1024
height_px = 768
[x]
period_px = {PERIOD_PX}
steps = 4
[cameras]
calibration = "x.json"
"""
    )
    capsys.readouterr()
    assert main(["import", str(described), "--out", str(tmp_path / "plane.npz"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["index"] == 1.0
    assert report["distance_mm"] == pytest.approx(PLANE_MM, rel=5e-3)
    assert report["coverage_percent"] > 70.0
    # As one of OpenCV's files would be named, it is the same rig.
    sizes_px = dict.fromkeys(("left", "right"), (WIDTH_PX, HEIGHT_PX))
    text = described.read_text()
    rigs = [
        read_rig(parse_description(one, tmp_path, "plane", "plane.toml"), sizes_px)
        for one in (text, text.replace("calibration =", "files ="))
    ]
    assert rigs[0] == rigs[1]


def test_people_are_told_what_was_found(recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["calibrate", "pair", str(recorded), "--square-mm", "15", "--out", str(tmp_path / "a.json"), "--flat"]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert "layout before OpenCV 4.6" in said
    assert "7 of 8 views used" in said
    assert "left and right in their names" in said
    assert "0.000, 0.000, 0.000 mm" in said.replace("-0.000", "0.000"), "flat"


def test_cameras_the_wrong_way_round_and_a_picture_of_another_size_are_named(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "pictures"
    shutil.copytree(recorded, folder)
    cv2.imwrite(str(folder / "v0_left.png"), np.zeros((300, 400), np.uint8))
    cut = folder / "v0_right.png"
    cut.write_bytes(cut.read_bytes()[:20_000])
    image = cv2.imread(str(folder / "v1_left.png"), cv2.IMREAD_UNCHANGED)
    assert image is not None
    cv2.imwrite(str(folder / "v1_left.png"), np.ascontiguousarray(image[:, ::-1]))
    code, report, said = run(capsys, str(folder), "--left", "v*_right.png", "--right", "v*_left.png")
    assert code == 0
    assert report["exchanged"]
    assert "left and right are exchanged" in said
    # A picture that cannot be decoded costs itself alone, and is told with its place before anything else is looked at.
    assert f"not used: {cut}: is damaged and cannot be decoded" in said.splitlines()[0]
    assert report["left_out"] == [
        f"{cut}: is damaged and cannot be decoded; bring it back from a copy",
        "v0_left.png: 400x300 px, the other pictures have 720x540 px",
        "1: the right picture is mirrored; give it as the camera saw it",
    ]
    assert report["pairs"] == ["2", "3", "4", "5", "6"]


@pytest.mark.parametrize(
    ("words", "message", "code"),
    [
        (["--board", "12x8"], "--board 12x8: the markers seen (5X5) lie as on a board of 11 squares across", 1),
        (["--left", "v*_left.png"], "--left and --right belong together", 2),
        (["--marker-mm", "16"], "allowed are sizes below --square-mm 15", 2),
        (["--left", "v0*_left.png", "--right", "v*_right.png"], "tells a left picture from the right one", 2),
    ],
)
def test_what_cannot_be_is_named(
    words: list[str], message: str, code: int, recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(["calibrate", "pair", str(recorded), "--square-mm", "15", "--out", str(tmp_path / "a.json"), *words])
        == code
    )
    assert message in capsys.readouterr().err
    assert not (tmp_path / "a.json").exists()


def test_pictures_without_a_board_are_counted_as_they_were_looked_at(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for k in range(8):
        for side in ("left", "right"):
            cv2.imwrite(str(tmp_path / f"v{k}_{side}.png"), np.full((64, 96), 128, np.uint8))
    code, _, said = run(capsys, str(tmp_path))
    assert code == 1
    assert "no ChArUco board in the 4 of 16 pictures that were looked at (v0_left.png, v2_left.png," in said


def test_the_size_of_a_square_must_be_told(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "pair", str(recorded)]) == 2
    assert "no picture tells how large a board is" in capsys.readouterr().err


def test_an_impossible_number_of_squares_is_refused(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["calibrate", "pair", str(recorded), "--square-mm", "15", "--board", "2x8"])
    assert ended.value.code == 2
    assert "2x8: allowed are two numbers 3..60" in capsys.readouterr().err
