"""Scans for the verdicts in the world ``outside``: ordinary draws, with families of that world by each scene's seed.

Hand motion of the family ``hands`` is added to the scene's own motion, so a scene at rest has none. The exposure suits
the brightest pixels of the scene's bright frame, times a drawn factor (a quarter are underexposed). A diver would
choose it so; a fixed exposure would make most scenes black or white because of other whites, sensors and spots. The
stated camera noise is that of an instrument that has measured it (``calibration measure noise``). The water's index is
that at the LED's true wavelength.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.noise import StereoNoise, camera_noise
from appliance.measure.light.patterns import STEPS, PatternSequence, build_sequence
from appliance.measure.light.sides import SIDES
from appliance.measure.light.water import Water
from bench.outside.world import FRAME_S, TRIGGER_DELAY_US, World, world_with
from bench.verdict.kept_scans import CaseRecording, Take, scene_of
from bench.verdict.motion_cases import TRUTH_SET, Case
from hw_sim.outside import ALL, draw_outside
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig
from tests.support.rendered import RenderedScan, pictures

WIDTH_PX = 400
SUITED_DN, TOP_PERCENT = 190.0, 99.7
"""A suitable exposure puts that percentile of the bright frame there, in the brighter camera."""
ASKED_S, LONGEST_S = 0.012, 0.016
WARM_K = (-5.0, 15.0)
"""The case, against the temperature at which the rig is as it was drawn."""
SHARE_OF_S = 0.012
"""A draw's exposure at 0 dB is a share of this."""
Stack = NDArray[np.uint8]


class OutsideScans:
    """Recordings of the cases of movement in the world ``outside``, from ``folder`` where they are there, and rendered where
    not: 12 MB and some 3 to 12 s of CPU for each take."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def recorded(self, case: Case, take: Take, noise_seed: int | None = None) -> CaseRecording:
        """Return the frames of a recording, with the noise of their readout."""
        world = _world_of(case, take)
        what = repr((world.scene, TRUTH_SET, case.period_px, case.exposure_s, case.gain_db, WIDTH_PX, FRAME_S, STEPS))
        name = f"outside-{case.seed}-{hashlib.sha256(what.encode()).hexdigest()[:16]}.npz"
        if self._folder is not None and (self._folder / name).exists():
            with np.load(self._folder / name) as stored:
                clean, noisy, exposure_s = stored["clean"], stored["noisy"], float(stored["exposure_s"])
            return CaseRecording(dict(zip(SIDES, clean, strict=True)), dict(zip(SIDES, noisy, strict=True)), exposure_s)
        renderer = world.renderer()
        share = case.exposure_s * 10.0 ** (case.gain_db / 20.0) / SHARE_OF_S
        exposure_s = suited_s(renderer, case.gain_db, share)
        recorded = record_sequence(
            renderer, build_sequence(case.period_px), exposure_s, case.gain_db, list(Take).index(take)
        )
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)
            draft = self._folder / f".{name}"
            np.savez(
                draft, clean=np.stack(list(recorded.clean.values())), noisy=np.stack(list(recorded.noisy.values())),
                exposure_s=exposure_s,
            )  # fmt: skip
            draft.replace(self._folder / name)
        return recorded

    def renderer(self, case: Case, take: Take) -> Renderer:
        """Return the renderer of a recording."""
        return _world_of(case, take).renderer()

    def water(self, case: Case) -> Water:
        """Return the water of the true index."""
        return water_of(_world_of(case, Take.REST).rig)

    def noise(self, case: Case) -> StereoNoise:
        """Return the noise as measured on the instrument."""
        return noise_of(_world_of(case, Take.REST).scene, case.gain_db)


def _world_of(case: Case, take: Take) -> World:
    """Return the world of a recording: at rest without hands; fish pass before hands at rest."""
    hands = take is Take.MOVING and case.kind != "fish"
    return put_outside(scene_of(case, take), case.seed, TRUTH_SET, hands=hands)


def put_outside(scene: Scene, seed: int, truth_set: str, *, width_px: int = WIDTH_PX, hands: bool = True) -> World:
    """Return ``scene`` with all families drawn by ``seed`` before the rig of that seed, as warm as the seed says; without
    ``hands``, with none."""
    outside = draw_outside(seed)
    outside = outside if hands else replace(outside, hands=None)
    warm_k = float(np.random.default_rng([seed, 91]).uniform(*WARM_K))
    size_px = (width_px, width_px * 3 // 4)
    return world_with(scene, outside, seed, ALL, truth_set=truth_set, size_px=size_px, case_c=20.0 + warm_k)


def record_sequence(
    renderer: Renderer, sequence: PatternSequence, exposure_s: float, gain_db: float, number: int = 0
) -> CaseRecording:
    """Record one sequence. Hands and swell move from its first pulse on; ``number`` sets the noise."""
    patterns = pictures(sequence)
    quiet, real = replace(renderer.scene, noise=False), replace(renderer.scene, noise=True)
    moving = renderer.scene.moves

    def lights(side: str) -> Iterator[NDArray[np.float32]]:
        for k, pattern in enumerate(patterns):
            light = [LightSlice(pattern, exposure_s, TRIGGER_DELAY_US / 1e6, FRAME_S)]
            yield renderer.light(side, light, k * FRAME_S if moving else 0.0, exposure_s, (False, False), k * FRAME_S)

    all_lights = {side: list(lights(side)) for side in SIDES}
    read: dict[bool, dict[str, Stack]] = {}
    for noise, scene in ((False, quiet), (True, real)):
        renderer.scene = scene
        read[noise] = {
            side: np.stack([
                renderer.read_out(side, light, exposure_s, gain_db, 1_000_000 * (number + 1) + 2 * k + n)
                for k, light in enumerate(all_lights[side])
            ])
            for n, side in enumerate(SIDES)
        }  # fmt: skip
    return CaseRecording(read[False], read[True], exposure_s)


def suited_s(renderer: Renderer, gain_db: float, share: float) -> float:
    """Return the exposure, s, that suits the scene at its first frame, times ``share``; not more than a frame allows."""
    sequence = build_sequence(16)
    bright = pictures(sequence)[sequence.bright]
    light = [LightSlice(bright, ASKED_S, TRIGGER_DELAY_US / 1e6, FRAME_S)]
    top_e = max(
        float(np.percentile(renderer.light(side, light, 0.0, ASKED_S, (False, False)), TOP_PERCENT)) for side in SIDES
    )
    traits = renderer.scene.outside.cameras
    assert traits is not None, "a scene of the world outside"
    top_dn = top_e * 255.0 / traits.full_well_e * 10.0 ** (gain_db / 20.0)
    return float(min(ASKED_S * SUITED_DN * share / max(top_dn, 1.0), LONGEST_S))


def noise_of(scene: Scene, gain_db: float) -> StereoNoise:
    """Return the noise as an instrument states it after measuring its own cameras."""
    traits = scene.outside.cameras
    assert traits is not None, "a scene of the world outside"
    noise = camera_noise(traits.full_well_e, traits.read_noise_e, traits.black_dn, gain_db)
    return StereoNoise(noise, noise)


def water_of(rig: TrueRig) -> Water:
    """Return water with the rig's refractive index, by its wavelength, as a calibration in the water would find it."""
    low, high = 450.0, 650.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        # Longer waves are refracted less.
        low, high = (middle, high) if Water(20.0, 0.0, middle).index > rig.n_water else (low, middle)
    return Water(20.0, 0.0, low)


def kept_scan_outside(
    folder: Path | None, scene: Scene, truth_set: str, seed: int, width_px: int, period_px: int, *, hands: bool
) -> RenderedScan:
    """Record a scan as ``recorded_scan`` at a suitable exposure; frames are read from and stored in ``folder``."""
    world = put_outside(scene, seed, truth_set, width_px=width_px, hands=hands)
    what = repr((world.scene, truth_set, width_px, period_px, FRAME_S, STEPS))
    name = f"outside-scan-{seed}-{hashlib.sha256(what.encode()).hexdigest()[:16]}.npz"
    frame_s = FRAME_S if world.scene.moves else 0.0
    if folder is not None and (folder / name).exists():
        with np.load(folder / name) as stored:
            frames, exposure_s = dict(zip(SIDES, stored["noisy"], strict=True)), float(stored["exposure_s"])
        return RenderedScan(world.renderer(), build_sequence(period_px), frames, exposure_s, frame_s)
    renderer = world.renderer()
    recorded = record_sequence(renderer, build_sequence(period_px), suited_s(renderer, 0.0, 1.0), 0.0)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        draft = folder / f".{name}"
        np.savez(draft, noisy=np.stack(list(recorded.noisy.values())), exposure_s=recorded.exposure_s)
        draft.replace(folder / name)
    return RenderedScan(renderer, build_sequence(period_px), recorded.noisy, recorded.exposure_s, frame_s)


def recorded_scan(
    scene: Scene, seed: int, truth_set: str, width_px: int, period_px: int, share: float, gain_db: float = 0.0
) -> RenderedScan:
    """Record one scan with noise, at the suitable exposure times ``share``."""
    world = put_outside(scene, seed, truth_set, width_px=width_px, hands=not scene.motion.still)
    renderer = world.renderer()
    recorded = record_sequence(renderer, build_sequence(period_px), suited_s(renderer, gain_db, share), gain_db)
    frame_s = FRAME_S if world.scene.moves else 0.0
    return RenderedScan(renderer, build_sequence(period_px), recorded.noisy, recorded.exposure_s, frame_s)
