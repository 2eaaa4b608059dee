"""Owns the demonstration: a diver scans a pipe under water; the saved cloud is held against the true surface.

Runs the service as ``kingfisher sim`` does, on the simulated rig at full resolution, with a calibration equal to the
true rig, and a script in the diver's place. Then only files are read: the saved scan, and the world's truth.
Writes ``demo/summary.json``, ``cloud.ply``, ``display.png`` and ``contact_sheet.png``.
"""

from __future__ import annotations

import argparse
import json
import logging
import shutil
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibration.file import encode
from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.config import load_rig
from appliance.service.app import CALIBRATION_FILE, run
from appliance.storage.library import Library
from appliance.storage.scan import StoredScan
from hw_sim.options import options_from
from hw_sim.render import Renderer
from hw_sim.truth import draw_truth
from hw_sim.wires.in_process import ScriptFailedError
from tests.support.truth import left_to_rig, true_calibration

SCRIPT = """
wait state AIM 60
pause 0.5
press scan
wait state REVIEW 60
pause 2.5
screenshot {display}
press scan
wait state AIM 60
pause 0.5
end
"""


def main() -> int:
    """Run the demonstration; 0 when a scan was saved and measured."""
    parser = argparse.ArgumentParser(prog="./dev demo", description=__doc__.partition("\n")[0])
    parser.add_argument("--object", default="pipe")
    parser.add_argument("--size", default="1600x1200")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--period", type=int, default=16, choices=(16, 32, 64))
    parser.add_argument("--out", type=Path, default=Path("demo"))
    wanted = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s", datefmt="%H:%M:%S", stream=sys.stderr)
    out: Path = wanted.out.absolute()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    script = out / "dive.script"
    script.write_text(SCRIPT.format(display=out / "display.png"))
    options = SimOptions(
        root=out / "storage",
        object_name=wanted.object,
        truth="modelled",
        seed=wanted.seed,
        size=wanted.size,
        script=script,
    )
    rig = simulated(load_rig(default_sim_rig()), options)
    rig = replace(rig, scan=replace(rig.scan, period_px=wanted.period))
    world = options_from(rig.rig.wires_options)
    truth = draw_truth(world.truth, world.seed, world.width_px, world.height_px, world.scene().water.index)
    calibration = rig.storage.root / CALIBRATION_FILE
    calibration.parent.mkdir(parents=True)
    calibration.write_bytes(encode(true_calibration(truth, rig.rig.serial)))

    begun = time.perf_counter()
    try:
        code = run(rig)
    except ScriptFailedError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    if code != 0:
        return code
    dive_s = time.perf_counter() - begun

    library = Library(rig.storage.root)
    last = library.last_id()
    if last is None:
        print("no scan was saved", file=sys.stderr)
        return 1
    scan = library.load(last)
    shutil.copy(scan.folder / "cloud.ply", out / "cloud.ply")
    summary = measure(scan, Renderer(truth, world.scene()))
    summary["wall_s"] = {**scan.manifest.record.stage_times_s, "dive": round(dive_s, 3)}
    (out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    cv2.imwrite(str(out / "contact_sheet.png"), contact_sheet(scan))
    print(json.dumps(summary, indent=2))
    return 0


def measure(scan: StoredScan, renderer: Renderer) -> dict[str, Any]:
    """The saved cloud against the truth: distances to the true surface, and how much of what can be seen is there."""
    cloud = scan.cloud()
    assert cloud is not None
    rig_mm = left_to_rig(renderer.truth, cloud.points_mm)
    distance_mm = renderer.surface(0.0).distance_mm(rig_mm)
    seen = renderer.view("left", 0.0).seen_by_all
    eye = renderer.truth.left.packed(renderer.truth.n_water)
    from hw_sim.optics.trace import pixels_of

    pixels = np.empty((len(rig_mm), 2))
    pixels_of(eye, np.ascontiguousarray(rig_mm), pixels)
    found = np.zeros_like(seen)
    u, v = np.rint(pixels).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < seen.shape[1]) & (v < seen.shape[0])
    found[v[inside], u[inside]] = True
    record = scan.manifest.record
    return {
        "scan": scan.manifest.scan_id,
        "frames": len(record.sequence.patterns),
        "period_px": record.sequence.period_px,
        "points": len(distance_mm),
        "completeness_percent": round(100.0 * float((found & seen).sum()) / float(seen.sum()), 3),
        "rms_mm": round(float(np.sqrt(np.mean(distance_mm**2))), 5),
        "p99_mm": round(float(np.quantile(np.abs(distance_mm), 0.99)), 5),
        "mean_mm": round(float(distance_mm.mean()), 5),
        "outliers_ppm": round(1e6 * float(np.mean(np.abs(distance_mm) > 1.0)), 2),
        "verdicts": {verdict.name: verdict.passed for verdict in record.verdicts},
        "frame_verdicts": {
            side: [frame["status"] for frame in frames] for side, frames in record.ledger["frames"].items()
        },
    }


def contact_sheet(scan: StoredScan) -> NDArray[np.uint8]:
    """Every pattern by name with what the left and the right camera saw of it: a BGR picture."""
    width, height, across = 200, 150, 6
    tiles = []
    for index, name in enumerate(scan.manifest.record.sequence.patterns):
        pair = [
            cv2.resize(scan.frames[side][index], (width, height), interpolation=cv2.INTER_AREA)
            for side in ("left", "right")
        ]
        tile = np.full((height + 26, 2 * width + 6, 3), 24, np.uint8)
        tile[26:, :width] = pair[0][..., None]
        tile[26:, width : 2 * width] = pair[1][..., None]
        cv2.putText(tile, f"{index:2d} {name}", (4, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (230, 230, 230), 1, cv2.LINE_AA)
        tiles.append(tile)
    while len(tiles) % across:
        tiles.append(np.full_like(tiles[0], 24))
    rows = [np.hstack(tiles[i : i + across]) for i in range(0, len(tiles), across)]
    return np.ascontiguousarray(np.vstack(rows), np.uint8)


if __name__ == "__main__":
    sys.exit(main())
