"""``kingfisher calibrate air`` turns a folder of pictures into a calibration that water can start from, or says why not."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.calibration.file import IN_AIR, load
from appliance.cli import main
from appliance.config import parse_rig
from appliance.instrument import calibration_of
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, draw_truth, in_air
from hw_sim.water.medium import AIR
from tests.support.board_pictures import picture, poses_in_air
from tests.support.truth import WATER

SIZE = (800, 600)
RIG = Path(__file__).parents[3] / "hw_sim" / "rigs" / "small.toml"
COUNT = 7


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
        cv2.imwrite(str(folder / f"99_{side}.png"), np.full((600, 800), 3, np.uint8))
    return folder


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """A rig file for these pictures, with a storage root of its own."""
    text = RIG.read_text(encoding="utf-8").replace("width_px = 400", "width_px = 800")
    text = text.replace("height_px = 300", "height_px = 600").replace("pixel_um = 18.0", "pixel_um = 9.0")
    (tmp_path / "root").mkdir()
    path = tmp_path / "rig.toml"
    path.write_text(text.replace("/var/tmp/kingfisher-sim", str(tmp_path / "root")), encoding="utf-8")
    return path


def test_a_folder_becomes_a_start_for_water(
    truth: TrueRig, recorded: Path, rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mine.json"
    arguments = ["calibrate", "air", str(recorded), "--rig", str(rig), "--out", str(out), "--install"]
    assert main([*arguments, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert len(report["views"]) == COUNT
    assert report["left_out"] == ["99: the left image is dark; more light, or a longer exposure"]
    assert report["residual_px"] < 0.06
    dry = in_air(truth)
    assert report["principal_distance_px"][0] == pytest.approx(dry.left.f_px[0], abs=0.3)
    base = np.linalg.norm(np.subtract(dry.right.t_mm, dry.left.t_mm))
    assert abs(report["baseline_mm"] - base) < 5.0 * report["baseline_sd_mm"]
    assert report["baseline_sd_mm"] < 0.1

    start = load(out)
    assert (start.method, start.rig_serial) == (IN_AIR, "KF-SIM")
    assert start.air_covariance is not None
    assert start.rig.left.port.distance_mm == 30.0, "ports are as drawn"
    assert load(tmp_path / "root" / "calibration" / "air.json") == start
    for path in report["pictures"]:
        shown = cv2.imread(path)
        assert shown is not None
        assert shown.std() > 5.0, "there is something to see"

    assert main([*arguments[:-1]]) == 0
    said = capsys.readouterr().out
    assert "left out: 99: the left image is dark" in said
    assert "baseline" in said


def test_installing_keeps_the_one_before(recorded: Path, rig: Path, tmp_path: Path) -> None:
    arguments = ["calibrate", "air", str(recorded), "--rig", str(rig), "--out", str(tmp_path / "a.json"), "--install"]
    kept = tmp_path / "root" / "calibration"
    assert main(arguments) == 0
    first = (kept / "air.json").read_bytes()
    fewer = tmp_path / "fewer"
    shutil.copytree(recorded, fewer)
    for side in ("left", "right"):
        (fewer / f"06_{side}.png").unlink()
    arguments[2] = str(fewer)
    assert main(arguments) == 0
    assert (kept / "air.json").read_bytes() != first
    (before,) = kept.glob("air-*.json")
    assert before.read_bytes() == first


def test_nothing_measures_in_water_with_a_calibration_in_air(
    recorded: Path, rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    current = tmp_path / "root" / "calibration" / "current.json"
    current.parent.mkdir()
    assert main(["calibrate", "air", str(recorded), "--rig", str(rig), "--out", str(current)]) == 0
    used, conditions = calibration_of(parse_rig(rig.read_text(encoding="utf-8")))
    assert used.method == "design"
    (condition,) = conditions
    assert "in air" in condition.detail
    assert main(["reconstruct", "1", "--rig", str(rig), "--calibration", str(current)]) == 2
    assert "is one in air" in capsys.readouterr().err


def without(folder: Path, tmp_path: Path, *names: str) -> Path:
    copy = tmp_path / "pictures"
    shutil.copytree(folder, copy)
    for name in names:
        (copy / name).unlink()
    return copy


@pytest.mark.parametrize(
    ("spoil", "words", "code"),
    [
        ("one missing", "03_right.png has no 03_left.png; add it", 2),
        ("empty", "they are called NAME_left.png and NAME_right.png", 2),
        ("damaged", "02_left.png: is no picture, or damaged", 2),
        ("other size", "400x300 px; the rig file has 800x600 px", 2),
        ("colour", "is in colour", 2),
        ("few", "3 usable views of the board; 6 are needed", 1),
    ],
)
def test_what_cannot_be_used_is_named(
    spoil: str, words: str, code: int, recorded: Path, rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = without(recorded, tmp_path)
    match spoil:
        case "one missing":
            (folder / "03_left.png").unlink()
        case "empty":
            shutil.rmtree(folder)
            folder.mkdir()
        case "damaged":
            (folder / "02_left.png").write_bytes(b"\x89PNG nothing")
        case "other size":
            cv2.imwrite(str(folder / "01_right.png"), np.zeros((300, 400), np.uint8))
        case "colour":
            red = np.zeros((600, 800, 3), np.uint8)
            red[..., 2] = 200
            cv2.imwrite(str(folder / "00_left.png"), red)
        case "few":
            for path in folder.iterdir():
                if path.name[:2] not in ("00", "01", "02", "99"):
                    path.unlink()
    assert main(["calibrate", "air", str(folder), "--rig", str(rig)]) == code
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not (folder / "air.json").exists()


@pytest.mark.parametrize("board", ["15x12", "15x12x13x18", "2x2x18x13", "15x12x18x13.5x1", "60x60x18x13"])
def test_impossible_boards_are_refused(board: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "air", str(tmp_path), "--rig", str(RIG), "--board", board]) == 2
    assert f"board {board}" in capsys.readouterr().err
