"""Frames of the scenes for the naming of causes: rendered once, and kept in a folder if one is given."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.exposure import Exposure
from appliance.measure.light.patterns import build_sequence
from bench.verdict.causes_scenes import (
    FRAME_S,
    HEIGHT_PX,
    PERIOD_PX,
    WIDTH_PX,
    Base,
    FactorLevels,
    exposure_of,
    scene_of,
)
from bench.verdict.outside import put_outside, record_sequence
from bench.verdict.worlds import ORDINARY
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth
from tests.support.rendered import RenderedScan, render_scan

TRUTH_SET = "realistic"


def frames_of(
    base: Base, levels: FactorLevels, keep: Path | None, exposure: Exposure | None = None, world: str = ORDINARY
) -> RenderedScan:
    """Return the scan of a scene, with noise; it is read from and stored in the folder ``keep``.

    ``exposure``: another one than that of the scene.
    """
    scene, chosen = scene_of(base, levels), exposure or exposure_of(levels)
    if world != ORDINARY:
        return _outside(base, scene, chosen, keep)
    frame_s = 0.0 if scene.motion.still else FRAME_S
    exposure_s = chosen.time_us / 1e6
    # Frames that were kept before a scene could be of another world are found again.
    what = repr((base.rig_seed, scene, chosen, WIDTH_PX, PERIOD_PX, TRUTH_SET)).replace(
        f", outside={scene.outside!r}", ""
    )
    path = None if keep is None else keep / f"causes-{hashlib.sha256(what.encode()).hexdigest()[:20]}.npy"
    if path is not None and path.exists():
        stacks = np.load(path)
        truth = draw_truth(TRUTH_SET, base.rig_seed, WIDTH_PX, HEIGHT_PX, scene.water.index)
        frames = {"left": stacks[0], "right": stacks[1]}
        return RenderedScan(Renderer(truth, scene), build_sequence(PERIOD_PX), frames, exposure_s, frame_s)
    scan = render_scan(
        scene, TRUTH_SET, base.rig_seed, WIDTH_PX, PERIOD_PX, exposure_s, frame_s=frame_s, gain_db=chosen.gain_db
    )
    if path is not None:
        _keep(path, scan.frames)
    return scan


def _outside(base: Base, scene: Scene, exposure: Exposure, keep: Path | None) -> RenderedScan:
    """Return the scan in the world ``outside``: families by the rig's seed, and motion of that world where the scene
    moves."""
    moves = not scene.motion.still
    renderer = put_outside(scene, base.rig_seed, TRUTH_SET, width_px=WIDTH_PX, hands=moves).renderer()
    what = repr((base.rig_seed, renderer.scene, exposure, WIDTH_PX, PERIOD_PX, TRUTH_SET))
    path = None if keep is None else keep / f"causes-outside-{hashlib.sha256(what.encode()).hexdigest()[:20]}.npy"
    exposure_s, frame_s = exposure.time_us / 1e6, FRAME_S if moves else 0.0
    if path is not None and path.exists():
        stacks = np.load(path)
        frames = {"left": stacks[0], "right": stacks[1]}
    else:
        frames = dict(record_sequence(renderer, build_sequence(PERIOD_PX), exposure_s, exposure.gain_db).noisy)
        if path is not None:
            _keep(path, frames)
    return RenderedScan(renderer, build_sequence(PERIOD_PX), frames, exposure_s, frame_s)


def _keep(path: Path, frames: Mapping[str, NDArray[np.uint8]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}")
    with draft.open("wb") as file:
        np.save(file, np.stack([frames["left"], frames["right"]]))
    draft.replace(path)
