"""Picture of a compensated scan: each point's distance to the true surface, plain, compensated and at rest.

``./dev run python -m bench.verdict.compensation_picture docs/pictures/compensation.png``
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.cloud import CloudLocation
from appliance.measure.motion.attempt import attempt
from appliance.measure.points.pipeline import Cloud, Pipeline
from appliance.measure.verdicts.motion.judge import judge_motion
from bench.verdict.compensation_cases import NAMED, OBJECTS
from hw_sim.objects.motion import Motion
from hw_sim.scene import Scene
from tests.support.moved import FRAME_S, recorded
from tests.support.rendered import RenderedScan, render_scan
from tests.support.truth import WATER, left_to_rig, true_calibration

WIDTH_PX, SEED = 800, 10_007
SPAN_MM = 0.15
"""Colours end here: blue in front of the surface, red behind it, white on it."""
CAPTION_PX = 34
OBJECT, HAND = "shell", "b"


def main(path: Path) -> None:
    """Render, reconstruct three ways, draw."""
    moving = _scan(NAMED[HAND])
    calibration = true_calibration(moving.renderer.truth)
    with Pipeline(calibration, WATER, moving.sequence) as pipeline:
        full = _push(pipeline, moving)
        plain = pipeline.table.cloud(full)
        images = recorded(moving, pipeline)
        added = judge_motion(images, plain, calibration.rig, WATER.index).added
        attempted = attempt(pipeline, full, images, calibration, WATER, added)
        if attempted.motion is None or attempted.found is None:
            raise SystemExit(f"the scan was not compensated: {attempted.why}")
        time_s, compensated = attempted.motion.reference_s, pipeline.table.cloud(attempted.found)
    still = _scan(Motion())
    with Pipeline(calibration, WATER, still.sequence) as pipeline:
        at_rest = pipeline.table.cloud(_push(pipeline, still))
    panels = [
        _panel(moving, plain, time_s, "as decoded"),
        _panel(moving, compensated, time_s, "compensated"),
        _panel(still, at_rest, 0.0, "at rest"),
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), np.concatenate(panels, axis=1)):
        raise SystemExit(f"{path} cannot be written")


def _scan(motion: Motion) -> RenderedScan:
    scene = Scene(OBJECT, texture=OBJECTS[OBJECT], motion=motion)
    return render_scan(scene, "modelled", SEED, WIDTH_PX, 16, frame_s=0.0 if motion.still else FRAME_S)


def _push(pipeline: Pipeline, scan: RenderedScan) -> CloudLocation:
    for side, frames in scan.frames.items():
        for k in range(len(scan.sequence)):
            pipeline.push(side, frames, k)
    pipeline.find_coarse()
    return pipeline.find_full(straightened=False)


def _panel(scan: RenderedScan, cloud: Cloud, time_s: float, name: str) -> NDArray[np.uint8]:
    distance = scan.renderer.surface(time_s).distance_mm(left_to_rig(scan.renderer.truth, cloud.points_mm))
    rms_um = 1000.0 * float(np.sqrt(np.mean(distance**2)))
    share = np.clip(distance / SPAN_MM, -1.0, 1.0)[:, None]
    white, red, blue = np.array([245.0] * 3), np.array([40.0, 40.0, 190.0]), np.array([190.0, 70.0, 30.0])
    colour = white + np.abs(share) * (np.where(share > 0.0, red, blue) - white)
    picture = np.full((WIDTH_PX * 3 // 4 * WIDTH_PX, 3), 60, np.uint8)
    picture[cloud.pixel] = np.rint(colour).astype(np.uint8)
    image = cv2.resize(
        picture.reshape(WIDTH_PX * 3 // 4, WIDTH_PX, 3), None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA
    )
    image = cv2.copyMakeBorder(image, CAPTION_PX, 0, 0, 0, cv2.BORDER_CONSTANT, value=(60, 60, 60))
    cv2.putText(
        image, f"{name}: {rms_um:.0f} um rms, {len(distance)} points", (10, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.5,
        (255, 255, 255), 1, cv2.LINE_AA,
    )  # fmt: skip
    return np.asarray(image, np.uint8)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
