"""``kingfisher calibration air`` turns a folder of pictures into a calibration that water can start from, or says why not."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.cli import main
from appliance.measure.calibration.file import IN_AIR
from appliance.store.config import parse_rig
from appliance.store.instrument import Instrument, load_calibration
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, draw_truth, in_air
from hw_sim.water.medium import AIR
from tests.support.board_pictures import picture, poses_in_air
from tests.support.commands import Shell
from tests.support.truth import WATER

SIZE = (640, 480)
RIG = Path(__file__).parents[3] / "hw_sim" / "rigs" / "small.toml"
COUNT = 6


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
    assert (used.method, "in air" in condition.detail) == ("design", True)
    said = shell("cloud", "1", "--rig", rig, "--calibration", kept / "current.json")
    assert (said.code, "in air" in said.error) == (2, True)


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
        ("few", "2 usable views of the board; 6 are needed", 1),
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
