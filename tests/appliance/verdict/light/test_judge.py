"""Light is judged by the harm it does, and the exposure that is proposed is the last one proposed."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from appliance.machine.alerts import alert_of
from appliance.patterns.sequence import Direction, build_sequence
from appliance.reconstruct.decode.decoder import CameraDecoder, Mask
from appliance.reconstruct.images import ScanImages
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.exposure import Exposure, Span, ladder
from appliance.scan.fault import FaultCode
from appliance.scan.noise import TYPICAL, StereoNoise, camera_noise
from appliance.scan.verdict import Judgement
from appliance.verdict.light.judge import judge_light
from hw_sim.light.daylight import Daylight
from hw_sim.rendering.sensor import FULL_WELL_E, OFFSET_DN, READ_NOISE_E
from hw_sim.scene import Scene
from tests.support.photographed import (
    HEIGHT_PX,
    WHITE_DN_PER_US,
    WIDTH_PX,
    Wall,
    coordinates,
    light,
    photograph,
    wall,
)
from tests.support.rendered import render_scan

STEPS = ladder(60.0, 500, 0.0, Span())
NOMINAL = Exposure(12_000)


def judge(scene: Wall, exposure: Exposure = NOMINAL, seed: int = 1, bend_px: float = 0.0) -> Judgement:
    return judge_light(photograph(scene, exposure, seed), exposure, STEPS, bend_px)


def mains(depth: float, hz: float = 100.0, exposure_s: float = 0.012) -> tuple[float, ...]:
    """What a lamp that flickers at ``hz`` gives to each of 24 frames, averaged over its exposure."""
    seen = depth * math.sin(math.pi * hz * exposure_s) / (math.pi * hz * exposure_s)
    return tuple(1.0 + seen * math.cos(2.0 * math.pi * hz * k / 60.0 + 0.7) for k in range(24))


@pytest.mark.parametrize("seed", range(12))
def test_a_proposal_once_applied_proposes_nothing_more(seed: int) -> None:
    rng = np.random.default_rng(seed)
    brightest = 0.9 * 10.0 ** -rng.uniform(0.0, 1.3)
    scene = Wall(wall(seed, brightest / rng.uniform(2.0, 60.0), brightest), rng.choice([0.0, 0.1, 0.5]))
    present = STEPS[rng.integers(0, len(STEPS))]
    before = judge(scene, present, seed)
    if before.proposal is None:
        return
    after = judge(scene, before.proposal, seed + 1000)
    assert after.proposal is None, f"{present.label} -> {before.proposal.label} -> {after.proposal.label}"
    assert (after.fault is None) or after.fault.code is not FaultCode.TOO_BRIGHT or before.proposal == STEPS[0]


@pytest.mark.parametrize("exposure", [STEPS[0], NOMINAL, STEPS[-1]])
@pytest.mark.parametrize("albedo", [0.12, 0.4, 0.9])
def test_the_proposal_uses_the_scale_and_does_not_leave_it(exposure: Exposure, albedo: float) -> None:
    """Saturation of a saturated scene is not known from its frames, and has to be estimated."""
    scene = Wall(wall(3, albedo / 5.0, albedo))
    proposed = judge(scene, exposure).proposal or exposure
    frames = photograph(scene, proposed, 9).frames["left"]
    assert np.mean(frames[0] == 255) < 0.003
    assert np.quantile(frames[0], 0.997) > 125 or proposed == STEPS[-1]


@pytest.mark.parametrize("bits", [(0.02, -0.025, 0.02), (-0.015, 0.02, -0.03)])
def test_bits_that_an_exposure_sees_in_part_are_no_flicker(bits: tuple[float, ...]) -> None:
    """Steps of the sine have harmonics 6 and 10, which neighbours have in common as they have a net of caustics."""
    steady = judge(Wall(wall(5, 0.3, 0.5), bits=bits))
    assert steady.fault is None
    lamp = judge(Wall(wall(5, 0.3, 0.5), ambient=0.3, flicker=mains(0.8), bits=bits))
    assert lamp.fault is not None
    assert lamp.fault.code is FaultCode.LIGHT_FLICKERS


def test_a_lamp_is_believed_where_it_does_more_than_bent_fringes_look_like() -> None:
    scene = Wall(wall(5, 0.3, 0.5), ambient=0.3, flicker=mains(0.8))
    ripple_px = max(judge(scene).verdict.numbers[f"{side}_flicker_ripple_px"] or 0.0 for side in ("left", "right"))
    # Bent fringes look like at most half of their bend.
    for bend_px, told in ((1.9 * ripple_px, True), (2.1 * ripple_px, False)):
        fault = judge(scene, bend_px=bend_px).fault
        assert (fault is not None and fault.code is FaultCode.LIGHT_FLICKERS) is told


def test_what_is_right_is_left_alone() -> None:
    good = judge(Wall(wall(4, 0.1, 0.55), ambient=0.05))
    assert good.proposal is None
    assert good.fault is None
    assert good.verdict.passed
    assert good.verdict.numbers["left_saturated_percent"] == 0.0
    assert good.verdict.numbers["left_ambient_percent"] == pytest.approx(5.0, abs=0.5)


def test_without_any_light_of_the_projector_nothing_is_judged() -> None:
    dark = judge(Wall(np.zeros((HEIGHT_PX, WIDTH_PX)), ambient=0.1))
    assert dark.verdict.passed is None
    assert dark.proposal is None
    assert dark.fault is None


def test_steps_end_before_the_next_blank_and_each_is_brighter_than_the_one_before() -> None:
    for refresh_hz, delay_us in ((60.0, 500), (60.0, 4000), (50.0, 0), (120.0, 500)):
        steps = ladder(refresh_hz, delay_us, 3.0, Span())
        assert all(step.time_us + delay_us < 1e6 / refresh_hz for step in steps)
        assert all(1.0 < b.light / a.light < 1.3 for a, b in itertools.pairwise(steps))
        assert steps[0].gain_db == 3.0
    with pytest.raises(ValueError, match="shorten the delay"):
        ladder(60.0, 15_000, 0.0, Span())


# ------------------------------------------------------------------------------------ changing light


@pytest.mark.parametrize("ambient", [0.1, 0.4])
@pytest.mark.parametrize("depth", [0.1, 0.3, 0.9])
def test_flicker_is_a_fault_exactly_where_it_does_harm(ambient: float, depth: float) -> None:
    """Harm is what the flicker does to the phases of exact light, against the noise of the camera."""
    scene = Wall(wall(5, 0.15, 0.5), ambient=ambient, flicker=mains(depth))
    over_noise = true_ripple_over_noise(scene)
    verdict = judge(scene)
    numbers = verdict.verdict.numbers
    assert numbers["left_flicker_over_noise"] == pytest.approx(over_noise, rel=0.15, abs=0.06)
    if over_noise > 0.65:
        assert verdict.fault is not None
        assert verdict.fault.code is FaultCode.LIGHT_FLICKERS
        assert alert_of(verdict.fault).headline == "LIGHT FLICKERS"
        assert numbers["flicker_alias_hz"] == pytest.approx(20.0, abs=0.5)
    if over_noise < 0.35:
        assert verdict.fault is None


def true_ripple_over_noise(scene: Wall) -> float:
    sequence = build_sequence(16)
    full_dn = WHITE_DN_PER_US * NOMINAL.light * scene.albedo
    ratios = []
    for direction in Direction:
        i0, i1, i2, i3 = light(sequence)[list(sequence.axis(direction).sine)]
        d0, d1, d2, d3 = (scene.ambient * (scene.flicker[k] - 1.0) for k in sequence.axis(direction).sine)
        biased = np.arctan2(i3 + d3 - i1 - d1, i0 + d0 - i2 - d2) - np.arctan2(i3 - i1, i0 - i2)
        amplitude_dn = 0.5 * full_dn * np.hypot(i3 - i1, i0 - i2)
        mean_dn = full_dn * (0.25 * (i0 + i1 + i2 + i3) + scene.ambient)
        noise = np.sqrt(TYPICAL.read_dn**2 + TYPICAL.dn_per_e * mean_dn) / amplitude_dn / math.sqrt(2.0)
        ratios.append(np.angle(np.exp(1j * biased)) / noise)
    return float(np.sqrt(np.mean(np.square(ratios))))


def test_the_amplitude_of_a_flicker_is_told_in_percent() -> None:
    flicker = tuple(1.0 + 0.2 * math.cos(2.0 * math.pi * k / 3.0) for k in range(24))
    numbers = judge(Wall(wall(6, 0.15, 0.5), 0.2, flicker)).verdict.numbers
    assert numbers["left_ambient_flicker_percent"] == pytest.approx(20.0, rel=0.15)
    assert numbers["left_flicker_percent"] == pytest.approx(4.0, rel=0.15)


def test_lamps_on_mains_are_answered_by_an_exposure_of_a_whole_period() -> None:
    verdict = judge(Wall(wall(7, 0.15, 0.52), 0.4, mains(0.9)))
    assert verdict.fault is not None
    assert verdict.fault.code is FaultCode.LIGHT_FLICKERS
    assert verdict.proposal == Exposure(10_000)
    steady = Wall(wall(7, 0.15, 0.52), 0.4, mains(0.9, exposure_s=0.010))
    again = judge(steady, Exposure(10_000))
    assert again.fault is None
    assert again.proposal is None


def test_lamps_in_step_with_the_frames_do_no_harm() -> None:
    """120 Hz: each frame sees the same two flashes."""
    assert judge(Wall(wall(8, 0.15, 0.5), 0.4, mains(0.9, hz=120.0))).fault is None


@pytest.mark.parametrize("seed", range(6))
def test_steady_light_never_flickers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    torch = np.exp(-((coordinates()[0] - 500.0) ** 2 + (coordinates()[1] - 300.0) ** 2) / 2.0 / 120.0**2)
    scene = Wall(wall(seed, 0.03, 0.55), rng.uniform(0.0, 0.6) + rng.uniform(0.0, 0.5) * torch)
    fault = judge(scene, seed=seed).fault
    assert fault is None or fault.code is not FaultCode.LIGHT_FLICKERS


@pytest.mark.parametrize("flicker_depth", [0.0, 0.9])
def test_labels_on_black_rubber_flicker_only_where_the_light_does(flicker_depth: float) -> None:
    """Half saturated, and dark ones before which backscatter has a larger share: neither is a change of light."""
    scene = Scene("plane", texture="labels", ambient=0.2, daylight=Daylight(flicker_depth=flicker_depth))
    scan = render_scan(scene, "realistic", 41, 320, 16, 0.012)
    camera = camera_noise(FULL_WELL_E, READ_NOISE_E, OFFSET_DN, 0.0)
    taken = ScanImages(scan.sequence, scan.frames, {}, AcquisitionSettings(noise=StereoNoise(camera, camera)))
    judged = judge_light(taken, NOMINAL, STEPS)
    assert (judged.verdict.numbers["left_saturated_percent"] or 0.0) > 10.0
    flickers = judged.fault is not None and judged.fault.code is FaultCode.LIGHT_FLICKERS
    assert flickers == (flicker_depth > 0.0)
    if not flickers:
        harmed = [judged.verdict.numbers[f"{side}_flicker_harmed_percent"] for side in ("left", "right")]
        assert max(one or 0.0 for one in harmed) < 5.0


def test_a_torch_that_sweeps_over_a_part_is_a_change_of_light_and_one_that_rests_is_not() -> None:
    p, q = coordinates()
    albedo = wall(9, 0.2, 0.45)
    sweeping = {k: 0.25 * np.exp(-((p - 200.0 - 25.0 * k) ** 2 + (q - 350.0) ** 2) / 2.0 / 130.0**2) for k in range(24)}
    fault = judge(Wall(albedo, 0.02, patches=sweeping)).fault
    assert fault is not None
    assert fault.code is FaultCode.LIGHT_FLICKERS
    resting = judge(Wall(albedo, 0.02, patches=dict.fromkeys(range(24), sweeping[12])))
    assert resting.fault is None
    numbers = resting.verdict.numbers
    assert numbers["left_torch_percent"] == pytest.approx(100.0 * np.quantile(0.02 + sweeping[12], 0.9), rel=0.1)
    assert numbers["left_ambient_percent"] == pytest.approx(100.0 * np.median(0.02 + sweeping[12]), rel=0.1)


def test_light_brighter_than_the_projector_is_told_apart_from_a_wrong_exposure() -> None:
    fault = judge(Wall(wall(10, 0.05, 0.18), 1.5)).fault
    assert fault is not None
    assert fault.code is FaultCode.AMBIENT


@pytest.mark.parametrize("torch", [2.0, 3.0, 8.0])
def test_what_a_torch_burns_away_proposes_no_exposure_and_what_the_projector_does_proposes_a_shorter_one(
    torch: float,
) -> None:
    """A torch's spot was TOO BRIGHT, and the shorter exposure that was offered took the light from all around it."""
    p, q = coordinates()
    spot = torch * np.exp(-((p - 400.0) ** 2 + (q - 300.0) ** 2) / 2.0 / 130.0**2)
    albedo = wall(10, 0.2, 0.45)
    burnt, exposed = judge(Wall(albedo, spot)), judge(Wall(albedo), Exposure(16_000, 12.0))
    for judged in (burnt, exposed):
        assert (judged.verdict.numbers["left_saturated_percent"] or 0.0) > 10.0
    assert burnt.fault is not None
    assert burnt.fault.code is FaultCode.AMBIENT
    assert (burnt.proposal, burnt.second) == (None, None)
    assert (burnt.verdict.numbers["left_burnt_percent"] or 0.0) > 5.0
    assert exposed.fault is not None
    assert exposed.fault.code is FaultCode.TOO_BRIGHT
    assert exposed.proposal is not None
    assert exposed.proposal.light < Exposure(16_000, 12.0).light
    assert exposed.verdict.numbers["left_burnt_percent"] == 0.0


# ----------------------------------------------------------------------------------------- saturation


def test_a_pixel_with_one_saturated_sine_never_becomes_a_point() -> None:
    recorded = photograph(Wall(wall(11, 0.2, 0.6)), NOMINAL, 1)
    sines = [k for k, pattern in enumerate(recorded.sequence.patterns) if pattern.kind.value == "sine"]
    for number in sines:
        frames = recorded.frames["left"].copy()
        frames[number, 80:100, 50:190] = 255
        decoder = CameraDecoder(recorded.sequence, WIDTH_PX, HEIGHT_PX)
        for k in range(len(recorded.sequence)):
            decoder.push(frames, k)
        spoiled = decoder.mask[80:100, 50:190]
        assert (spoiled == Mask.SATURATED).all()
        assert np.isnan(decoder.p_px[80:100, 50:190]).all()
        assert np.isnan(decoder.q_px[80:100, 50:190]).all()


def test_where_only_the_bright_frame_saturates_coordinates_are_as_good_as_ever() -> None:
    """It shifts the Gray threshold; but where no sine saturates, not by as much as the code's spare half period bears."""
    scene = Wall(np.full((HEIGHT_PX, WIDTH_PX), 270.0 / 360.0))
    recorded = photograph(scene, NOMINAL, 1)
    decoder = CameraDecoder(recorded.sequence, WIDTH_PX, HEIGHT_PX)
    for k in range(len(recorded.sequence)):
        decoder.push(recorded.frames["left"], k)
    only_bright = (recorded.frames["left"][recorded.sequence.bright] == 255) & (decoder.mask != Mask.SATURATED)
    assert only_bright.sum() > 1000
    p, q = coordinates()
    assert (decoder.mask[only_bright] == Mask.VALID).mean() > 0.98
    valid = only_bright & (decoder.mask == Mask.VALID)
    assert np.abs(decoder.p_px - p)[valid].max() < 0.4
    assert np.abs(decoder.q_px - q)[valid].max() < 0.4
