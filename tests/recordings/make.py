"""Makes a small storage root with everything that one version of the program writes, for `test_files_of_1_0`.

Runs with the version whose recordings are wanted, from its root: ``python PATH/make.py OUT``. See README.md beside it.
Four short dives of the simulated instrument, under calibrations of every model:

    plain       scan 1 kept, scan 2 of two exposures, scan 3 rejected; their fringe period is 32 px
    corrected   scan 4 is a step of a calibration (its session stays), scan 5 was taken by moving hands
    shifted     scan 6 with a fringe period of 16 px; the power went while scan 7 was waiting for its decision, and once
                more with scan 8

At the desk: an object of scans 1 and 6, and an archive of scans 1 and 2.
"""

from __future__ import annotations

import hashlib
import json
import platform
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from appliance import __version__
from appliance.calibrate.calibrations import Calibrations
from appliance.measure.calibration import file as calibration_file
from appliance.measure.calibration.file import IN_AIR, Calibration
from appliance.measure.light.correction import ImageCorrection, node_count
from appliance.measure.light.ray_shift import RayShift
from appliance.store.config import load_rig
from appliance.store.instrument import Instrument

SIZE = (160, 120)
DAYS = ("2026-11-20", "2026-11-21", "2026-11-22")
INTERVALS = (2, 2)

TWO_EXPOSURES = """
wait state AIM 200
pause 0.5
press up
wait state MENU 5
press down
press scan
press up
press scan
press back
wait state AIM 5
texture slight
press scan
wait state REVIEW 120
pause 1
press scan
wait scans 1 60
wait state AIM 60
texture labels
press scan
wait label down HOLD:* 120
press down 1.2
wait label down None 10
wait label up TURN 120
press scan
wait scans 2 60
wait state AIM 60
press scan
wait state REVIEW 60
press back 1.2
wait state AIM 60
pause 2
end
"""
CALIBRATING_AND_MOVING = """
wait state AIM 200
object plane 0 0 478 8 -10 0
texture none
press up
press down
press down
press down
press scan
wait step M1 10
press down
press down
wait step M3 10
press scan
wait result FITS 120
press back
wait state AIM 10
object frustum 0 0 520 0 9 0
texture slight
motion velocity_mm_s=4,0,0
pause 1
press scan
wait state REVIEW 120
motion off
press scan
wait scans 4 60
wait state AIM 60
end
"""
ANOTHER_PERIOD_AND_A_POWER_CUT = """
wait state AIM 200
pause 0.5
press up
wait state MENU 5
press down
press scan
press down
press scan
press back
wait state AIM 5
texture slight
press scan
wait state REVIEW 120
press scan
wait scans 5 60
wait state AIM 60
press scan
wait state REVIEW 120
power cut
"""


A_POWER_CUT_LATER = """
wait state AIM 200
press scan
wait state REVIEW 120
pause 5
power cut
"""


def main(out: Path) -> None:
    """Make ``out``/rig.toml, ``out``/root and ``out``/expected.json: what this version makes of every scan."""
    out.mkdir(parents=True)
    rig_file = out / "rig.toml"
    rig_file.write_text(rig_text(), encoding="utf-8")
    rig = load_rig(rig_file)
    root = out / "root"
    calibrations = Calibrations(root, rig.rig.serial)
    dives = (
        (TWO_EXPOSURES,),
        (CALIBRATING_AND_MOVING,),
        (ANOTHER_PERIOD_AND_A_POWER_CUT, A_POWER_CUT_LATER),
    )
    for k, (made, day, under_it) in enumerate(zip(of_every_model(Instrument(rig).design()), DAYS, dives, strict=True)):
        calibrations.install(made, day)
        if k == 0:
            air = replace(made, method=IN_AIR, air_covariance=tuple(map(tuple, (np.eye(22) * 1e-4).tolist())))
            (root / "calibration" / "air.json").write_bytes(calibration_file.encode_calibration(air))
        for dive in under_it:
            script = out / "dive.script"
            script.write_text(dive, encoding="utf-8")
            words = ("truth=nominal", f"seed={3 + k}", "object=frustum", "texture=labels")
            sim = (sys.executable, "-m", "appliance.cli", "sim", "--rig", str(rig_file), "--root", str(root))
            subprocess.run((*sim, *words, "--script", str(script)), check="power cut" not in dive, timeout=900)
            script.unlink()
        if k == 1:
            calibrations.install(replace(made, made_from=("kept only",)), day)
    shutil.rmtree(root / "room")
    at_the_desk: tuple[tuple[str, ...], ...] = (
        ("object", "add", "frustum"),
        ("object", "add", "frustum", "1", "6"),
        ("object", "solve", "frustum"),
        ("archive", "pack", str(root), "--out", str(out / "archive")),
    )
    for verb in at_the_desk:
        place = () if verb[0] == "archive" else ("--root", str(root))
        subprocess.run((sys.executable, "-m", "appliance.cli", *verb, *place), check=True, timeout=600)
    # Two packed scans show the form.
    for packed in sorted((out / "archive" / "scans").glob("0*"))[2:]:
        shutil.rmtree(packed)
    (out / "expected.json").write_text(json.dumps(expected(root), indent=1) + "\n", encoding="utf-8")


def expected(root: Path) -> dict[str, Any]:
    """The processor, and of every scan its number of points and the sha256 of its cloud, as this version reconstructs it."""
    found: dict[str, Any] = {
        "version": __version__,
        "processor": f"{platform.machine()} {llvm.get_host_cpu_name()}",
        "scans": {},
    }
    out = root.parent / "cloud.ply"
    for folder in sorted(path.parent for path in root.glob("*/*/manifest.json")):
        again = (sys.executable, "-m", "appliance.cli", "cloud", str(folder), "--out", str(out), "--json")
        said = json.loads(subprocess.run(again, check=True, timeout=600, capture_output=True).stdout)
        found["scans"][str(folder.relative_to(root))] = {
            "points": said["points"],
            "sha256": hashlib.sha256(out.read_bytes()).hexdigest(),
        }
        out.unlink()
    return found


def rig_text() -> str:
    """The simulator's rig file for quick images, made smaller still: the pixel grows as their number shrinks."""
    text = (Path.cwd() / "hw_sim" / "rigs" / "small.toml").read_text(encoding="utf-8")
    pixel_um = 18.0 * 400 / SIZE[0]
    for old, new in (
        ("width_px = 400", f"width_px = {SIZE[0]}"),
        ("height_px = 300", f"height_px = {SIZE[1]}"),
        ("pixel_um = 18.0", f"pixel_um = {pixel_um}"),
    ):
        if old not in text:
            raise SystemExit(f"hw_sim/rigs/small.toml has no {old!r} any more: look at rig_text")
        text = text.replace(old, new)
    return text


def of_every_model(design: Calibration) -> Sequence[Calibration]:
    """The drawing; with an image correction; with a ray shift. The changes are small, and different in both cameras."""
    random = np.random.default_rng(5)

    def coefficients(sd: float) -> tuple[float, ...]:
        return tuple(np.round(sd * random.standard_normal(2 * node_count(INTERVALS)), 6).tolist())

    measured = replace(design, method="bundle", made_at="2026-11-20T09:00:00+00:00", made_from=("made up",))
    left, right = measured.rig.left, measured.rig.right
    corrected = [
        replace(eye, correction=ImageCorrection(eye.width_px, eye.height_px, INTERVALS, coefficients(0.003)))
        for eye in (left, right)
    ]
    shifted = [
        replace(eye, ray_shift=RayShift(eye.width_px, eye.height_px, INTERVALS, coefficients(0.003)))
        for eye in (left, right)
    ]
    rigs = (replace(measured.rig, left=a, right=b) for a, b in (corrected, shifted))
    return [measured, *(replace(measured, rig=rig) for rig in rigs)]


if __name__ == "__main__":
    main(Path(sys.argv[1]).absolute())
