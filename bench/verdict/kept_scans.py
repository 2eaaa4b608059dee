"""Rendered scans that a measurement keeps in a folder: rendered once, judged again after each change of the judges.

The name of a file contains the case and all that its images depend on here, so that frames of another definition are
not found. The simulator's own version is not in the name: use an empty folder after changing it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.noise import StereoNoise
from appliance.measure.light.patterns import STEPS, build_sequence
from appliance.measure.light.water import Water
from bench.verdict.motion_cases import FRAME_S, TRUTH_SET, Case, without_fish
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth
from tests.support.judged import data_sheet_noise, record
from tests.support.rendered import RenderedScan, render_scan
from tests.support.truth import WATER

WIDTH_PX = 400
Frames = Mapping[str, NDArray[np.uint8]]


class Take(Enum):
    """Recordings of a case."""

    REST = "rest"
    """At rest, without the motion of the case: no fish, but snow and the light of the case."""
    MOVING = "moving"


@dataclass(frozen=True, slots=True)
class CaseRecording:
    """One recording of a case."""

    clean: Frames
    """(n, h, w) uint8 of ``left`` and ``right``, without the cameras' noise."""
    noisy: Frames
    exposure_s: float


class Scans(Protocol):
    """Recordings of cases in one world."""

    def recorded(self, case: Case, take: Take, noise_seed: int | None = None) -> CaseRecording:
        """Return the frames of a recording; ``noise_seed`` replaces the usual seed where noise is added afterwards."""

    def renderer(self, case: Case, take: Take) -> Renderer:
        """Return the renderer of a recording."""

    def water(self, case: Case) -> Water:
        """Return the water of the true index, as the product describes it."""

    def noise(self, case: Case) -> StereoNoise:
        """Return the camera noise that the instrument states."""


class KeptScans:
    """Frames of cases in the ordinary world, from ``folder`` if they are stored there, else rendered.

    Without a folder nothing is stored. Each recording is 5.8 MB at 400 × 300, and takes 1 s (at rest) to 4 s of CPU.
    """

    def __init__(self, folder: Path | None, width_px: int = WIDTH_PX) -> None:
        self._folder = folder
        self.width_px = width_px

    def recorded(self, case: Case, take: Take, noise_seed: int | None = None) -> CaseRecording:
        """Return the frames of a recording with noise added."""
        clean = self.frames(case, take)
        noise_seed = noise_seed or 1 + list(Take).index(take)
        return CaseRecording(clean, record(clean, case.gain_db, case.seed, noise_seed), case.exposure_s)

    def renderer(self, case: Case, take: Take) -> Renderer:
        """Return the renderer of a recording."""
        truth = draw_truth(TRUTH_SET, case.seed, self.width_px, self.width_px * 3 // 4, case.scene.water.index)
        return Renderer(truth, scene_of(case, take))

    def water(self, case: Case) -> Water:
        """Return the water of the ordinary world."""
        return WATER

    def noise(self, case: Case) -> StereoNoise:
        """Return the noise of the data sheet."""
        return data_sheet_noise(case.gain_db)

    def frames(self, case: Case, take: Take) -> Frames:
        """Return the frames (n, h, w) uint8 of ``left`` and ``right``, without noise."""
        scene = scene_of(case, take)
        name = self._name(case, scene)
        if self._folder is not None and (self._folder / name).exists():
            stacks = np.load(self._folder / name)
        else:
            scan = render_scan(
                scene, TRUTH_SET, case.seed, self.width_px, case.period_px, case.exposure_s,
                frame_s=0.0 if scene.motion.still else FRAME_S, gain_db=case.gain_db,
            )  # fmt: skip
            stacks = np.stack([scan.frames["left"], scan.frames["right"]])
            if self._folder is not None:
                _keep(self._folder, name, stacks)
        return {"left": stacks[0], "right": stacks[1]}

    def _name(self, case: Case, scene: Scene) -> str:
        what = repr((scene, TRUTH_SET, case.period_px, case.exposure_s, case.gain_db, self.width_px, FRAME_S, STEPS))
        return f"{case.seed}-{hashlib.sha256(what.encode()).hexdigest()[:16]}.npy"


def kept_scan(
    folder: Path | None, scene: Scene, truth_set: str, seed: int, width_px: int, period_px: int, frame_s: float
) -> RenderedScan:
    """Render a scan as ``render_scan``; frames are read from and stored in ``folder``, if it is not ``None``."""
    what = repr((scene, truth_set, width_px, period_px, frame_s, STEPS))
    name = f"scan-{seed}-{hashlib.sha256(what.encode()).hexdigest()[:16]}.npy"
    if folder is None or not (folder / name).exists():
        scan = render_scan(scene, truth_set, seed, width_px, period_px, frame_s=frame_s)
        if folder is not None:
            _keep(folder, name, np.stack([scan.frames["left"], scan.frames["right"]]))
        return scan
    stacks = np.load(folder / name)
    truth = draw_truth(truth_set, seed, width_px, width_px * 3 // 4, scene.water.index)
    frames = {"left": stacks[0], "right": stacks[1]}
    return RenderedScan(Renderer(truth, scene), build_sequence(period_px), frames, frame_s=frame_s)


def _keep(folder: Path, name: str, stacks: NDArray[np.uint8]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    draft = folder / f".{name}"
    np.save(draft, stacks)
    draft.replace(folder / name)


def scene_of(case: Case, take: Take) -> Scene:
    """Return the scene before the instrument in that recording."""
    match take:
        case Take.REST:
            return without_fish(case.scene)
        case Take.MOVING:
            return replace(case.scene, motion=case.motion)
