"""An exposure that shows too few of the projector's bits is named, with what it costs; nothing else is blamed for it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.fault import FaultCode
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.patterns import build_sequence
from appliance.measure.light.sides import SIDES
from appliance.measure.news import FullCloud
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.points.straighten import PhaseBend
from appliance.measure.procedure import SequenceProcessor
from appliance.measure.verdicts.fringes import judge_fringes
from hw_sim.outside import draw_outside
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth, with_glass
from tests.support.rendered import pictures
from tests.support.truth import WATER, true_calibration

FRAME_S = 1.0 / 60.0


@pytest.mark.parametrize(("first_px", "bent"), [(0.15, False), (0.34, False), (0.35, True), (0.5, True)])
def test_a_bend_counts_by_the_noise_that_straightening_costs(first_px: float, bent: bool) -> None:
    # p - e(p) multiplies the noise by |1 - s cos θ| and the pixels at θ by as much, s = 4 · 2π b / P: 1 + 1.5 s² in the mean.
    factor = math.sqrt(1.0 + 1.5 * (8.0 * math.pi / 16.0 * first_px) ** 2)
    judged = judge_fringes(PhaseBend((first_px, 0.0, 0.0, 0.0), 0.05), 16)
    assert judged.verdict.numbers["noise_factor"] == pytest.approx(factor, rel=1e-3)
    assert judged.verdict.numbers["bend_px"] == pytest.approx(first_px / math.sqrt(2.0))
    assert judged.verdict.passed is not bent
    assert (judged.fault is not None) is bent
    if judged.fault is not None:
        assert judged.fault.code is FaultCode.FRINGES_BENT
        assert judged.fault.numbers["noise_percent"] == pytest.approx(100.0 * (factor - 1.0), rel=1e-2)
        assert "kingfisher calibration measure exposures" in judged.fault.detail


def test_a_bend_that_noise_hides_is_none() -> None:
    judged = judge_fringes(PhaseBend((0.4, 0.0, 0.0, 0.0), 4.0), 16)
    assert judged.verdict.passed
    assert judged.verdict.numbers["noise_factor"] == 1.0


def processed(exposure_us: int, seed: int = 10_004) -> FullCloud:
    """Return what is said of a plane before a projector of bit planes, as bright as at 12 ms: only which bits are seen is another."""
    sequence = build_sequence(16)
    scene = Scene("plane", outside=draw_outside(seed, ("projector",)))
    truth = with_glass(draw_truth("modelled", seed, 200, 150, scene.index), scene.glass_more)
    renderer, exposure_s = Renderer(truth, scene), exposure_us / 1e6
    gain_db = 20.0 * math.log10(12_000.0 / exposure_us)

    def shot(side: str, k: int, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        light = LightSlice(picture, exposure_s, 0.0005, FRAME_S)
        return renderer.expose(
            side, [light], 0.0, exposure_s, gain_db, (False, False), 2 * k + (side == "left"), k * FRAME_S
        )

    frames = {side: np.stack([shot(side, k, one) for k, one in enumerate(pictures(sequence))]) for side in SIDES}
    calibration = true_calibration(truth)
    with Pipeline(calibration, WATER, sequence) as pipeline:
        settings = AcquisitionSettings(exposure=Exposure(exposure_us, gain_db))
        return SequenceProcessor(pipeline, calibration, WATER).process(frames, settings)


def test_an_exposure_of_few_bits_is_named_and_not_called_flickering_light() -> None:
    full = processed(6_300)
    assert [one.fault.code for one in full.judgements if one.fault is not None] == [FaultCode.FRINGES_BENT]
    light = next(one.verdict.numbers for one in full.judgements if one.verdict.name == "light")
    harmed = [light[f"{side}_flicker_harmed_percent"] or 0.0 for side in SIDES]
    assert min(harmed) > 30.0, "which steady light of a sine would be flickering for"
