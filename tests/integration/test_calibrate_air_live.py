"""The simulated instrument is calibrated in air by somebody who holds a board before it, view after view, with a break."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from appliance.cli import main
from appliance.store.instrument import load_calibration
from hw_sim.truth import draw_truth, in_air
from tests.support.board_pictures import poses_in_air
from tests.support.truth import WATER

RIG = Path(__file__).parents[2] / "hw_sim" / "rigs" / "small.toml"
VIEWS, BEFORE = 6, 3
"""Wanted; and recorded before the break."""
SEED = 4


def rig_file(folder: Path, name: str, script: str, pose: tuple[float, ...]) -> Path:
    """A rig of 800 × 600 px in air, its board at ``pose``, and somebody who follows ``script``."""
    root, played, path = folder / "root", folder / f"{name}.script", folder / f"{name}.toml"
    root.mkdir(exist_ok=True)
    played.write_text(script, encoding="utf-8")
    text = RIG.read_text(encoding="utf-8").replace("/var/tmp/kingfisher-sim", str(root))
    for old, new in (
        ("width_px = 400", "width_px = 800"), ("height_px = 300", "height_px = 600"), ("pixel_um = 18.0", "pixel_um = 9.0"),
        ("[rig.wires_options]\n", f"""[rig.wires_options]
truth = "modelled"
seed = {SEED}
medium = "air"
object = "board"
object_pose = {list(pose)}
script = "{played}"
status = "{root}/run/status.json"
"""),
    ):  # fmt: skip
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


def board_at(pose: tuple[float, ...]) -> str:
    return "object board " + " ".join(f"{x:.3f}" for x in pose)


@pytest.mark.long
@pytest.mark.timeout(900)
def test_views_are_recorded_kept_and_gone_on_with(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    poses, folder = poses_in_air(VIEWS, 3), tmp_path / "views"
    far = (0.0, 0.0, 1500.0, 0.0, 0.0, 0.0)
    lines = ["pause 2"]
    for k, pose in enumerate(poses[:BEFORE]):
        lines += [board_at(pose), f"wait result VIEW_{k + 1:02} 300"]
    first = rig_file(tmp_path, "first", "\n".join(lines), far)
    common = ["calibration", "air", str(folder), "--live", "6", "--exposure-ms", "6.5"]
    assert main([*common, "--rig", str(first), "--timeout-s", "15"]) == 1, "the fourth never came"
    said = [record.getMessage() for record in caplog.records]
    assert said[0] == "the left image is dark; use more light, or a longer exposure time", "too far for the projector"
    views = [line for line in said if line.startswith("view ")]
    assert [line[:7] for line in views] == [f"view {k:02}" for k in range(1, BEFORE + 1)]
    assert "no corners yet" in views[0]
    assert any("the board has the pose of view 03" in line for line in said)
    assert sorted(p.name for p in folder.iterdir()) == [*(f"{k:02}" for k in range(1, BEFORE + 1)), "board.json"]
    assert not (folder / "air.json").exists()

    (folder / ".04").mkdir()  # a loss of power while the fourth was written
    (folder / ".04" / "left.png").write_bytes(b"\x89PNG")
    caplog.clear()
    lines = ["pause 1"]
    for k, pose in enumerate(poses[BEFORE:VIEWS], BEFORE + 1):
        lines += [board_at(pose), f"wait result VIEW_{k:02} 300"]
    then = rig_file(tmp_path, "then", "\n".join(lines), poses[0])
    assert main([*common, "--rig", str(then), "--install"]) == 0
    said = [record.getMessage() for record in caplog.records]
    assert said[0] == "3 views exist already"
    assert any(line.startswith("view 06") for line in said)
    assert not (folder / ".04").exists()

    start = load_calibration(tmp_path / "root" / "calibration" / "air.json")
    dry = in_air(draw_truth("modelled", SEED, 800, 600, WATER.index))
    assert start.rig.left.lens.f_px[0] == pytest.approx(dry.left.f_px[0], abs=1.0)
    base_mm = np.linalg.norm(np.subtract(dry.right.t_mm, dry.left.t_mm))
    assert np.linalg.norm(start.rig.right.translation_mm) == pytest.approx(base_mm, abs=0.1)
    assert not (tmp_path / "root" / "run" / "status.json").exists(), "nothing runs any more"
