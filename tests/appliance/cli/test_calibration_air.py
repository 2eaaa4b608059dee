"""``kingfisher calibration air`` turns a folder of pictures into a calibration that water can start from, or into one of any two cameras, or says
why not."""

from __future__ import annotations

import contextlib
import io
import json
import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from appliance.cli import main
from appliance.desk.foreign.cameras import read_rig
from appliance.desk.foreign.description import parse_description
from appliance.measure.calibration.file import IN_AIR
from appliance.measure.light.pinhole import Lens
from appliance.store.config import parse_rig
from appliance.store.instrument import Instrument, load_calibration
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, draw_truth, in_air
from hw_sim.water.medium import AIR
from tests.support.any_boards import BASE_MM, F_PX, HEIGHT_PX, WIDTH_PX, Printed, poses, write_pairs
from tests.support.board_pictures import picture, poses_in_air
from tests.support.commands import Shell
from tests.support.truth import WATER

SIZE = (640, 480)
RIG = Path(__file__).parents[3] / "hw_sim" / "rigs" / "small.toml"
COUNT = 6
PAIRS = 7


@pytest.fixture(scope="module")
def truth() -> TrueRig:
    return draw_truth("modelled", 3, *SIZE, WATER.index)


@pytest.fixture(scope="module")
def recorded(truth: TrueRig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of boards, and one pair in the dark."""
    folder = tmp_path_factory.mktemp("boards")
    renderer = Renderer(in_air(truth), Scene(object="board"))
    for k, pose in enumerate(poses_in_air(COUNT, 1)):
        both = picture(renderer, pose, AIR, k)
        for side in ("left", "right"):
            cv2.imwrite(str(folder / f"{k:02}_{side}.png"), getattr(both, side))
    for side in ("left", "right"):
        cv2.imwrite(str(folder / f"99_{side}.png"), np.full(SIZE[::-1], 3, np.uint8))
    return folder


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """A rig file for these pictures, with a storage root of its own."""
    text = RIG.read_text(encoding="utf-8").replace("width_px = 400", "width_px = 640")
    text = text.replace("height_px = 300", "height_px = 480").replace("pixel_um = 18.0", "pixel_um = 11.25")
    (tmp_path / "root").mkdir()
    path = tmp_path / "rig.toml"
    path.write_text(text.replace("/var/tmp/kingfisher-sim", str(tmp_path / "root")), encoding="utf-8")
    return path


def test_a_folder_becomes_a_start_for_water_and_the_one_before_is_kept(
    truth: TrueRig, recorded: Path, rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, shell, kept = tmp_path / "mine.json", Shell(capsys), tmp_path / "root" / "calibration"
    kept.mkdir()
    (kept / "air.json").write_bytes(b"of before")
    said = shell("calibration", "air", recorded, "--rig", rig, "--out", out, "--install", "--json")
    report = said.document
    assert (said.code, len(report["views"]), report["left_out"][0][:28]) == (0, COUNT, "99: the left image is dark; ")
    assert report["residual_px"] < 0.06
    dry = in_air(truth)
    assert report["principal_distance_px"][0] == pytest.approx(dry.left.f_px[0], abs=0.5)
    base = np.linalg.norm(np.subtract(dry.right.t_mm, dry.left.t_mm))
    assert abs(report["baseline_mm"] - base) < 5.0 * report["baseline_sd_mm"] < 0.5
    start = load_calibration(out)
    assert (start.method, start.rig_serial, start.air_covariance is None) == (IN_AIR, "KF-SIM", False)
    assert start.rig.left.port.distance_mm == 30.0, "ports are as drawn"
    assert load_calibration(kept / "air.json") == start
    for path in report["pictures"]:
        drawn = cv2.imread(path)
        assert drawn is not None
        assert drawn.std() > 5.0, "there is something to see"
    (before,) = kept.glob("air-*.json")
    assert before.read_bytes() == b"of before"
    # Nothing measures in water with a calibration in air.
    shutil.copy(out, kept / "current.json")
    used, (condition,) = Instrument(parse_rig(rig.read_text(encoding="utf-8"))).calibration()
    assert (used.method, "an air calibration" in condition.detail) == ("design", True)
    said = shell("cloud", "1", "--rig", rig, "--calibration", kept / "current.json")
    assert (said.code, "air calibration" in said.error) == (2, True)


RED = np.zeros((*SIZE[::-1], 3), np.uint8)
RED[..., 2] = 200


@pytest.mark.parametrize(
    ("spoil", "words", "code"),
    [
        ("one missing", "03_left.png", 2),
        ("empty", "NAME_left.png", 2),
        ("damaged", "02_left.png", 2),
        ("other size", "400x300 px; the rig file has 640x480 px", 2),
        ("colour", "colour", 2),
        ("few", "the left camera has 2 usable views of the board, the right one 2", 1),
    ],
)
def test_what_cannot_be_used_is_named(
    spoil: str, words: str, code: int, recorded: Path, rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "pictures"
    shutil.copytree(recorded, folder)
    gone = {"empty": "0123456789", "few": "2345"}.get(spoil, "")
    for path in list(folder.iterdir()):
        if path.name[1] in gone:
            path.unlink()
    match spoil:
        case "one missing":
            (folder / "03_left.png").unlink()
        case "damaged":
            (folder / "02_left.png").write_bytes(b"\x89PNG nothing")
        case "other size":
            cv2.imwrite(str(folder / "01_right.png"), np.zeros((300, 400), np.uint8))
        case "colour":
            cv2.imwrite(str(folder / "00_left.png"), RED)
    said = Shell(capsys)("calibration", "air", folder, "--rig", rig)
    assert (said.code, words in said.err.splitlines()[-1]) == (code, True), said.err
    assert not (folder / "air.json").exists()


def test_impossible_boards_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for board in ("15x12", "15x12x13x18", "2x2x18x13", "15x12x18x13.5x1", "60x60x18x13"):
        assert main(["calibration", "air", str(tmp_path), "--rig", str(RIG), "--board", board]) == 2
        assert f"board {board}" in capsys.readouterr().err


# ------------------------------------------------------------------------------------------ anybody's cameras


@dataclass(frozen=True)
class CalibratedPair:
    """A folder of pictures, and what one call made of it."""

    pictures: Path
    file: Path
    report: dict[str, Any]
    told: str


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> CalibratedPair:
    """Of seven pairs of a board of the old layout; in the last one it fills an eighth of the picture; one camera has an eighth view alone."""
    folder, out = tmp_path_factory.mktemp("theirs"), tmp_path_factory.mktemp("out") / "mine.json"
    where = poses(PAIRS + 1, 3)
    write_pairs(folder, Printed(), [*where[: PAIRS - 1], *poses(1, 5, 470.0, 475.0), where[PAIRS]])
    (folder / f"v{PAIRS}_right.png").unlink()
    said, told = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(told):
        assert (
            main(["calibration", "air", str(folder), "--pair", "theirs", "--board", "15", "--out", str(out), "--json"])
            == 0
        )
    return CalibratedPair(folder, out, json.loads(said.getvalue()), told.getvalue())


def test_a_folder_of_others_becomes_a_calibration(mine: CalibratedPair) -> None:
    report = mine.report
    assert (report["pairs"], report["left_out"]) == ([f"v{k}" for k in range(PAIRS)], [])
    assert report["board"].startswith("11x8 squares of 15 mm, markers of 11")
    assert report["board"].endswith("DICT_5X5_50, layout before OpenCV 4.6")
    assert report["residual_px"] < 0.08
    assert report["views"][-1]["remarks"] == ["only the left camera has this view"]
    small = re.fullmatch(r"the board fills ([\d.]+) % of the left image", report["views"][PAIRS - 1]["remarks"][0])
    assert small is not None
    assert float(small[1]) == pytest.approx(12.5, abs=1.2)
    assert f"the board is small in 1 of {PAIRS + 1} views (v{PAIRS - 1}): " in mine.told
    assert "coverage is poor: no corners yet" in mine.told
    for f_px, sd_px in zip(report["principal_distance_px"], report["principal_distance_sd_px"], strict=True):
        assert abs(f_px - F_PX) < max(5.0 * sd_px, 1.0)
        assert sd_px < 3.0
    assert report["baseline_mm"] == pytest.approx(BASE_MM, rel=5e-3)
    start = load_calibration(mine.file)
    assert (start.method, start.rig_serial) == ("air", "theirs")
    assert (start.rig.left.width_px, start.rig.left.height_px) == (WIDTH_PX, HEIGHT_PX)
    assert all(cv2.imread(path) is not None for path in report["pictures"])


def test_opencv_reads_the_same_cameras(mine: CalibratedPair) -> None:
    """A point of space goes to the same pixels by OpenCV's own projection with the file for it."""
    store = cv2.FileStorage(str(mine.file.with_suffix(".yml")), cv2.FILE_STORAGE_READ)
    point = np.array([[12.0, -7.0, 350.0]])
    camera = load_calibration(mine.file).rig.right
    local = (point - np.array(camera.translation_mm)) @ np.array(camera.rotation)
    ours = Lens(camera.lens.f_px, camera.lens.c_px, camera.lens.distortion).to_pixels(local[:, :2] / local[:, 2:])
    R, T, M, D = (store.getNode(name).mat() for name in ("R", "T", "M2", "D2"))
    theirs, _ = cv2.projectPoints(point, cv2.Rodrigues(R)[0], T, M, D)
    assert np.allclose(np.ravel(theirs), np.ravel(ours), atol=1e-6)
    assert T[0, 0] < 0.0


def test_import_takes_the_file_that_was_written_for_a_rig_in_air(mine: CalibratedPair, tmp_path: Path) -> None:
    """It was taken for a rig in water: a plane at 360 mm came out at 489."""
    shutil.copy(mine.file, tmp_path / "x.json")
    text = """[images]
left = "left/*.png"
right = "right/*.png"
order = "sine-x*4 gray-x*5"
[projector]
width_px = 1024
height_px = 768
[x]
period_px = 32
steps = 4
[cameras]
calibration = "x.json"
"""
    sizes_px = dict.fromkeys(("left", "right"), (WIDTH_PX, HEIGHT_PX))
    # As one of OpenCV's files would be named, it is the same rig.
    found, again = (
        read_rig(parse_description(one, tmp_path, "plane", "plane.toml"), sizes_px)
        for one in (text, text.replace("calibration =", "files ="))
    )
    assert (found.index, found == again) == (1.0, True)
    at = np.array([[0.5 * BASE_MM, 0.0, 360.0]])
    left, right = (camera.project(at, found.index)[0, 0] for camera in (found.rig.left, found.rig.right))
    assert left - right == pytest.approx(F_PX * BASE_MM / 360.0, rel=5e-3)


@pytest.mark.dive
def test_cameras_the_wrong_way_round_and_a_picture_of_another_size_are_named(
    mine: CalibratedPair, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "pictures"
    shutil.copytree(mine.pictures, folder)
    cv2.imwrite(str(folder / "v0_left.png"), np.zeros((300, 400), np.uint8))
    cut = folder / "v0_right.png"
    cut.write_bytes(cut.read_bytes()[:20_000])
    image = cv2.imread(str(folder / "v1_left.png"), cv2.IMREAD_UNCHANGED)
    assert image is not None
    cv2.imwrite(str(folder / "v1_left.png"), np.ascontiguousarray(image[:, ::-1]))
    words = ("--sides", "v*_right.png,v*_left.png", "--board", "8x11x15x11.25", "--flat")
    said = Shell(capsys)("calibration", "air", folder, "--pair", "theirs", "--json", *words)
    report = said.document
    assert (said.code, report["exchanged"], "left and right are exchanged" in said.err) == (0, True, True)
    # A picture that cannot be decoded costs itself alone, and is told with its place before anything else is looked at.
    assert f"not used: {cut}: is damaged and cannot be decoded" in said.err.splitlines()[0]
    assert report["left_out"] == [
        f"{cut}: is damaged and cannot be decoded; restore it from a copy",
        "v0_left.png: 400x300 px, the other images have 720x540 px",
        "1: the right image is mirrored; give it as the camera recorded it",
    ]
    assert report["pairs"] == ["2", "3", "4", "5", "6"]


@pytest.mark.parametrize(
    ("words", "message", "code"),
    [
        ("--board 12x8x15", "11 squares across", 1), ("--board 15 --sides v*_left.png", "a comma between them", 2), ("--board 15x16", "markers smaller", 2),
        ("--board 15 --sides v0*_left.png,v*_right.png", "do not show left and right", 2), ("", "size of a square", 2), ("--board 2x8x15", "2x8", 2),
        ("--board 15 --install", "not the instrument's", 2),
    ],
)  # fmt: skip
def test_what_cannot_be_is_named(
    words: str, message: str, code: int, mine: CalibratedPair, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = Shell(capsys)(
        "calibration", "air", mine.pictures, "--pair", "theirs", "--out", tmp_path / "a.json", *words.split()
    )
    assert (said.code, message in said.err, (tmp_path / "a.json").exists()) == (code, True, False), said.err


def test_pictures_without_a_board_are_counted_as_they_were_looked_at(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in (f"v{k}_{side}.png" for k in range(8) for side in ("left", "right")):
        cv2.imwrite(str(tmp_path / name), np.full((64, 96), 128, np.uint8))
    said = Shell(capsys)("calibration", "air", tmp_path, "--pair", "theirs", "--board", "15")
    assert (said.code, "4 of 16 images that were searched (v0_left.png, v2_left.png," in said.err) == (1, True)
