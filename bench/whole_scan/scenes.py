"""The four timed scenes of a whole scan, and the folder of their frames, which are rendered once.

``disc``: the tilted disc of closed forms that fills three quarters of the image. ``pipe``: clear water, at rest.
``turbid``: a shell in slightly turbid water. ``moving``: a pipe before a hand that moves and trembles; such a scan is
compensated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.file import Calibration
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.patterns import PatternSequence, build_sequence
from appliance.measure.light.sides import SIDES
from appliance.measure.light.water import Water
from bench.scan_frames import make_scan
from bench.turbidity.scan import FRAME_S, PERIOD_PX, noise_of, set_water
from bench.verdict.compensation_cases import NAMED
from bench.verdict.kept_scans import kept_scan
from hw_sim.scene import Scene
from hw_sim.water.medium import turbid
from tests.support import synthetic
from tests.support.rendered import EXPOSURE_S
from tests.support.truth import true_calibration

FOLDER = Path(".cache/scenes")
TRUTH_SET, SEED = "modelled", 12_007
SLIGHTLY_PER_M = 0.6
"""Beam attenuation of water that a diver still calls clear."""
RENDERED = {
    "pipe": Scene("pipe", texture="checker"),
    "turbid": Scene("shell", texture="slight", water=turbid(SLIGHTLY_PER_M)),
    "moving": Scene("pipe", texture="checker", motion=NAMED["a"]),
}
DISC = "disc"
NAMES = (DISC, *RENDERED)
WORDS = {
    DISC: "tilted disc that fills the image, 1.4 million points, clear water",
    "pipe": "pipe, clear water",
    "turbid": f"shell, water of {SLIGHTLY_PER_M:g} /m",
    "moving": "pipe before a moving, trembling hand",
}


@dataclass(frozen=True, slots=True)
class TimedScene:
    """Frames of a scan, and all inputs of the worker."""

    name: str
    sequence: PatternSequence
    calibration: Calibration
    water: Water
    frames: Mapping[str, NDArray[np.uint8]]
    """(n, h, w) of each side."""
    settings: AcquisitionSettings


def timed_scene(name: str, width_px: int = 1600, folder: Path = FOLDER) -> TimedScene:
    """Return one of ``NAMES``, its frames from ``folder`` where they are there. Raises KeyError for another name."""
    if name == DISC:
        return _disc(width_px, folder)
    shown = RENDERED[name]
    scan = kept_scan(
        folder, shown, TRUTH_SET, SEED, width_px, PERIOD_PX, 0.0 if shown.motion.still else FRAME_S
    )  # fmt: skip
    water = set_water(shown)
    settings = AcquisitionSettings(Exposure(round(1e6 * EXPOSURE_S), 0.0), FRAME_S, noise_of(0.0))
    calibration = replace(true_calibration(scan.renderer.truth), water=water)
    return TimedScene(name, scan.sequence, calibration, water, scan.frames, settings)


def _disc(width_px: int, folder: Path) -> TimedScene:
    height_px = width_px * 3 // 4
    files = {side: folder / f"disc-{width_px}-{side}.npy" for side in SIDES}
    calibration = synthetic.calibration(width_px, height_px)
    if not all(path.exists() for path in files.values()):
        scan = make_scan(width_px, height_px)
        folder.mkdir(parents=True, exist_ok=True)
        for side, path in files.items():
            draft = path.with_name(f".{path.name}")
            np.save(draft, scan.frames[side])
            draft.replace(path)
    frames = {side: np.load(path) for side, path in files.items()}
    return TimedScene(
        DISC, build_sequence(PERIOD_PX), calibration, synthetic.WATER, frames, AcquisitionSettings()
    )  # fmt: skip
