"""Records what the frozen behaviour starts from: small scans of every kind, pictures of a board, another rig's images.

``python -m tests.behaviour.record OUT`` makes ``OUT/recordings``; README.md beside it says when that is done, and how it is packed.
Images are 144 px wide.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from appliance.calibrate.calibrations import Calibrations
from appliance.measure.calibration import file as calibration_file
from appliance.measure.calibration.file import IN_AIR
from appliance.measure.light.correction import node_count
from appliance.measure.light.model import HousedCamera
from appliance.measure.light.ray_shift import RayShift
from appliance.store.config import load_rig
from appliance.store.instrument import Instrument
from tests.support.any_boards import Printed, poses, write_pairs
from tests.support.calibrating import air_of, calibration_recordings, hidden_rig, start_of
from tests.support.foreign_sets import convention, make_set

ROOT = Path(__file__).parents[2]
WIDTH_PX = 144
FOREIGN_PX = 200
EXPOSURE_MS, PERIOD_PX = 8.0, 32
DAY = "2026-11-20"
INTERVALS = (2, 2)
KEPT = """
press scan
wait state REVIEW 120
pause 1
press scan
wait state AIM 60
"""
IN_CLEAR_WATER = f"""
wait state AIM 200
object frustum 0 0 505 0 9 0
texture slight
pause 1
{KEPT}
object frustum 12 -6 520 6 -8 10
{KEPT}
object frustum -10 8 515 -9 14 -12
{KEPT}
object plane 0 0 500 8 12 0
texture none
motion velocity_mm_s=2,0,10
pause 1
{KEPT}
object frustum 0 0 505 0 9 0
texture slight
motion velocity_mm_s=30,0,0 tremor_mm=1,1,1 tremor_hz=15
{KEPT}
motion off
texture labels
pause 2
press up
wait state MENU 5
press down
press scan
press up
press scan
press back
wait state AIM 5
press scan
wait label down HOLD:* 120
press down 1.2
wait label down None 10
wait label up TURN 120
press scan
wait state AIM 90
end
"""
IN_OTHER_WATER = f"""
wait state AIM 200
object frustum 0 0 505 0 9 0
texture slight
water attenuation_per_m=2.5 backscatter=0.06 blur_px_per_m=1
pause 2
{KEPT}
water attenuation_per_m=1.5 backscatter=0.5 blur_px_per_m=4
pause 2
{KEPT}
water off
drift particles_per_l=400 bubbles=30 current_mm_s=60,0,0
pause 1
{KEPT}
drift off
cap right on
press scan
wait alert CAMERA_STUCK 90
wait state AIM 30
cap right off
pause 2
fault projector wrong
press scan
pause 5
wait state AIM 60
clear
pause 1
fault camera.right off frame=18
press scan
wait action RIGHT CAM LOST: REPEAT 20
clear
wait device camera.right ok 20
end
"""
TOO_BRIGHT = f"""
wait state AIM 200
object frustum 0 0 505 0 9 0
texture none
pause 1
{KEPT}
end
"""
PLANE = f"""
wait state AIM 200
object plane 0 0 500 8 12 0
texture none
pause 1
{KEPT}
end
"""
NEARER = f"""
wait state AIM 200
object pipe 0 0 336 0 6 20
texture slight
pause 1
{KEPT}
end
"""


def main(out: Path) -> None:
    """Make all recordings below ``out``, which must not exist."""
    out.mkdir(parents=True)
    first = small_rig("small.toml", (400, 300), 12.0)
    (out / "rig.toml").write_text(first, encoding="utf-8")
    root = out / "root"
    install(out / "rig.toml", root)
    dive(out / "rig.toml", root, IN_CLEAR_WATER, 3)
    dive(out / "rig.toml", root, IN_OTHER_WATER, 4)
    others = {
        TOO_BRIGHT: (f"exposure_ms = {EXPOSURE_MS}\ngain_db = 0.0", "exposure_ms = 16.0\ngain_db = 3.0"),
        PLANE: (f"period_px = {PERIOD_PX}", "period_px = 64"),
    }
    for k, (text, change) in enumerate(others.items()):
        other = out / "other.toml"
        other.write_text(first.replace(*change), encoding="utf-8")
        (root / "choices.json").unlink(missing_ok=True)
        dive(other, root, text, 5 + k)
        other.unlink()

    second = out / "second.toml"
    second.write_text(small_rig("compact.toml", (1920, 1200), 8.0), encoding="utf-8")
    install(second, out / "second")
    dive(second, out / "second", NEARER, 7)
    for name in ("root", "second"):
        shutil.rmtree(out / name / "room", ignore_errors=True)

    (out / "list.toml").write_text('[[scan]]\nscan = "./root/scans/000013"\nartefact = "plane"\n', encoding="utf-8")
    record_artefacts(out / "water")
    write_pairs(out / "boards", Printed(), poses(6, 3), "v{k}_{side}.jpg")
    for name in ("three-steps", "two-directions"):
        make_set(convention(name), out / "foreign" / name, FOREIGN_PX)


def small_rig(name: str, before_px: tuple[int, int], exposure_ms: float) -> str:
    """Return a simulator's rig file with images of ``WIDTH_PX``: the pixel grows as their number shrinks."""
    text = (ROOT / "hw_sim" / "rigs" / name).read_text(encoding="utf-8")
    (pixel,) = [line for line in text.splitlines() if line.startswith("pixel_um = ")]
    larger = before_px[0] / WIDTH_PX
    pixel_um = float(pixel.split("=")[1].split("#")[0]) * larger
    for old, new in (
        (f"width_px = {before_px[0]}", f"width_px = {WIDTH_PX}"),
        (f"height_px = {before_px[1]}", f"height_px = {round(before_px[1] / larger)}"),
        (pixel, f"pixel_um = {pixel_um}"),
        (f"exposure_ms = {exposure_ms}", f"exposure_ms = {EXPOSURE_MS}"),
        ("period_px = 16", f"period_px = {PERIOD_PX}"),
        ("[storage]\n", "[storage]\nkeep_incomplete = true\n"),
    ):
        assert old in text, f"{name} has no {old!r} any more"
        text = text.replace(old, new)
    return text


def install(rig_file: Path, root: Path) -> None:
    """Install the drawing with a small ray shift, and the same as a calibration in air."""
    rig = load_rig(rig_file)
    random = np.random.default_rng(5)
    design = Instrument(rig).design()

    def shifted(eye: HousedCamera) -> HousedCamera:
        amounts = np.round(0.003 * random.standard_normal(2 * node_count(INTERVALS)), 6)
        return replace(eye, ray_shift=RayShift(eye.width_px, eye.height_px, INTERVALS, tuple(amounts.tolist())))

    made = replace(
        design,
        method="bundle",
        made_at="2026-11-20T09:00:00+00:00",
        made_from=("made up",),
        rig=replace(design.rig, left=shifted(design.rig.left), right=shifted(design.rig.right)),
    )
    Calibrations(root, rig.rig.serial).install(made, DAY)
    air = replace(made, method=IN_AIR, air_covariance=tuple(map(tuple, (np.eye(22) * 1e-4).tolist())))
    (root / "calibration" / "air.json").write_bytes(calibration_file.encode_calibration(air))


def dive(rig_file: Path, root: Path, text: str, seed: int) -> None:
    """Dive once with the simulated instrument, as ``text`` says."""
    script = rig_file.with_suffix(".script")
    script.write_text(text, encoding="utf-8")
    sim = (sys.executable, "-m", "appliance.cli", "sim", "--rig", str(rig_file), "--root", str(root))
    words = ("truth=nominal", f"seed={seed}", "--script", str(script))
    subprocess.run((*sim, *words), check=True, timeout=1800)
    script.unlink()


def record_artefacts(folder: Path) -> None:
    """Record what two ball bars and two planes show of a hidden rig, and the calibration in air to start from."""
    folder.mkdir()
    truth = hidden_rig("modelled", 3)
    (folder / "air.json").write_bytes(
        calibration_file.encode_calibration(replace(start_of(air_of(truth)), air_field=None))
    )
    arrays = {}
    for recording in calibration_recordings(truth):
        for name in ("left_px", "right_px", "sphere"):
            arrays[f"{recording.name}|{name}"] = getattr(recording, name)[::4]
    np.savez_compressed(folder / "recordings.npz", **arrays)


if __name__ == "__main__":
    cv2.setNumThreads(1)
    main(Path(sys.argv[1]).absolute())
