"""Demonstration: a diver scans a pipe under water; the saved cloud is compared with the true surface.

Runs the service as ``kingfisher sim`` does, on the simulated rig at full resolution, with a calibration equal to the
true rig, and a script in the diver's place. Then only files are read: the saved scan, and the world's truth.
Writes ``demo/summary.json``, ``cloud.ply``, ``display.png`` and ``contact_sheet.png``; ends with what that means in ten
lines. While it works it is never silent for more than ten seconds.
"""

from __future__ import annotations

import argparse
import json
import logging
import shutil
import sys
import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TextIO

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.cli.kernels import compile_kernels
from appliance.cli.simrig import SimOptions, apply_options, default_sim_rig, simulator_kernels
from appliance.instrument.service.app import run
from appliance.measure.calibration.file import encode_calibration
from appliance.store.config import load_rig
from appliance.store.instrument import Instrument
from appliance.store.library import Library
from appliance.store.scan import StoredScan
from hw_sim.options import options_from
from hw_sim.rendering.render import Renderer
from hw_sim.truth import draw_truth
from hw_sim.wires.in_process import ScriptFailedError
from tests.support.truth import left_to_rig, true_calibration

QUIET_S = 9.0
"""Longest silence; the compiler's own lines come a little sooner."""
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


class Pulse(logging.Handler):
    """Prints each piece of news, and that work goes on where there was none for a while. A context manager."""

    def __init__(self, stream: TextIO, quiet_s: float = QUIET_S) -> None:
        super().__init__()
        self.setFormatter(logging.Formatter("%(asctime)s %(message)s", datefmt="%H:%M:%S"))
        self._stream, self._quiet_s = stream, quiet_s
        self._begun_s = self._last_s = time.monotonic()
        self._doing = "working"
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="pulse", daemon=True)

    def begin(self, doing: str) -> None:
        """Start a step with the text ``doing``, and log it."""
        self._doing, self._begun_s = doing, time.monotonic()
        logging.getLogger("demo").info("%s …", doing)

    def emit(self, record: logging.LogRecord) -> None:
        self._last_s = time.monotonic()
        self._stream.write(self.format(record) + "\n")
        self._stream.flush()

    def __enter__(self) -> Pulse:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join(QUIET_S)

    def _beat(self) -> None:
        while not self._over.wait(0.2):
            now_s = time.monotonic()
            if now_s - self._last_s > self._quiet_s:
                logging.getLogger("demo").info("%s: %.0f s so far", self._doing, now_s - self._begun_s)


def main() -> int:
    """Run the demonstration; return 0 if a scan was saved and measured."""
    parser = argparse.ArgumentParser(prog="./dev demo", description=__doc__.partition("\n")[0])
    parser.add_argument("--object", default="pipe")
    parser.add_argument("--size", default="1600x1200")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--period", type=int, default=16, choices=(16, 32, 64))
    parser.add_argument("--out", type=Path, default=Path("demo"))
    parser.add_argument("--json", action="store_true", help="print all numbers instead of a summary")
    options = parser.parse_args()
    with Pulse(sys.stderr) as pulse:
        logging.basicConfig(level=logging.INFO, handlers=[pulse])
        return _demonstrate(options, pulse)


def _demonstrate(options: argparse.Namespace, pulse: Pulse) -> int:
    begun = time.perf_counter()
    compile_kernels(simulator_kernels)
    compiling_s = time.perf_counter() - begun
    out: Path = options.out.absolute()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    script = out / "dive.script"
    script.write_text(SCRIPT.format(display=out / "display.png"))
    sim_options = SimOptions(
        root=out / "storage",
        object_name=options.object,
        truth="modelled",
        seed=options.seed,
        size=options.size,
        script=script,
    )
    rig = apply_options(load_rig(default_sim_rig()), sim_options)
    rig = replace(rig, scan=replace(rig.scan, period_px=options.period))
    world = options_from(rig.rig.wires_options)
    truth = draw_truth(world.truth, world.seed, world.width_px, world.height_px, world.scene().water.index)
    calibration = Instrument(rig).calibration_file
    calibration.parent.mkdir(parents=True)
    calibration.write_bytes(encode_calibration(true_calibration(truth, rig.rig.serial)))

    begun = time.perf_counter()
    pulse.begin(f"a dive: a {options.object} at {options.size}, somebody presses SCAN, looks, and keeps it")
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
    pulse.begin("comparing the saved cloud with the true surface")
    begun = time.perf_counter()
    scan = library.load(last)
    shutil.copy(scan.folder / "cloud.ply", out / "cloud.ply")
    summary = measure(scan, Renderer(truth, world.scene()))
    cv2.imwrite(str(out / "contact_sheet.png"), contact_sheet(scan))
    took_s = {"compiling": compiling_s, "dive": dive_s, "comparing": time.perf_counter() - begun}
    summary["wall_s"] = {**scan.manifest.record.stage_times_s, **{name: round(s, 3) for name, s in took_s.items()}}
    (out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    print(json.dumps(summary, indent=2) if options.json else "\n".join(in_words(summary, options.object, options.out)))
    return 0


def in_words(summary: Mapping[str, Any], scanned: str, out: Path) -> list[str]:
    """Return ten lines: the measurement, its quality, the files, and the next step."""
    frames = [status for statuses in summary["frame_verdicts"].values() for status in statuses]
    bad = sum(status != "complete" for status in frames)
    refused = [name for name, passed in summary["verdicts"].items() if passed is False]
    wall_s = summary["wall_s"]
    outliers = round(1e-6 * summary["outliers_ppm"] * summary["points"])
    return [
        f"Scanned a {scanned} under water with the simulated instrument, from key press to saved cloud:",
        f"  images        {summary['frames']} from each camera, {f'{bad} of them bad' if bad else 'none missing'}",
        f"  points        {summary['points']:,}",
        f"  completeness  {summary['completeness_percent']:.1f} % of what both cameras see in the projector's light",
        (
            f"  error         {summary['rms_mm']:.3f} mm rms to the true surface, 99 % within {summary['p99_mm']:.3f} mm, "
            f"{outliers} points off by more than 1 mm"
        ),
        f"  verdict       {'good' if not refused else 'bad: ' + ', '.join(refused)}",
        (
            f"  time          compiling {wall_s['compiling']:.0f} s, dive {wall_s['dive']:.0f} s, "
            f"comparing {wall_s['comparing']:.0f} s"
        ),
        f"Look at   {out / 'display.png'} (what the diver saw), {out / 'contact_sheet.png'} (every image),",
        f"          {out / 'cloud.ply'} (the cloud, in any viewer), {out / 'summary.json'} (all numbers)",
        "Next      ./dev run kingfisher sim --window truth=nominal size=800x600   (dive yourself)",
    ]


def measure(scan: StoredScan, renderer: Renderer) -> dict[str, Any]:
    """Compare the saved cloud with the truth: distances to the true surface, and completeness."""
    cloud = scan.cloud()
    assert cloud is not None
    rig_mm = left_to_rig(renderer.truth, cloud.points_mm)
    distance_mm = renderer.surface(0.0).distance_mm(rig_mm)
    visible = renderer.view("left", 0.0).seen_by_all
    eye = renderer.truth.left.packed(renderer.truth.n_water)
    from hw_sim.optics.trace import pixels_of

    pixels = np.empty((len(rig_mm), 2))
    pixels_of(eye, np.ascontiguousarray(rig_mm), pixels)
    has_point = np.zeros_like(visible)
    u, v = np.rint(pixels).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < visible.shape[1]) & (v < visible.shape[0])
    has_point[v[inside], u[inside]] = True
    record = scan.manifest.record
    return {
        "scan": scan.manifest.scan_id,
        "frames": len(record.sequence.patterns),
        "period_px": record.sequence.period_px,
        "points": len(distance_mm),
        "completeness_percent": round(100.0 * float((has_point & visible).sum()) / float(visible.sum()), 3),
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
    """Return a BGR picture of every pattern by name with the images of both cameras."""
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
