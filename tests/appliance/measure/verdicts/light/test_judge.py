"""Light is judged by the harm it does, and the exposure that is proposed is the last one proposed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from appliance.measure.fault import FaultCode
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import NOMINAL, Exposure, Span, ladder
from appliance.measure.light.noise import TYPICAL, StereoNoise, camera_noise
from appliance.measure.light.patterns import Direction, build_sequence
from appliance.measure.scan_images import ScanImages
from appliance.measure.verdict import Judgement
from appliance.measure.verdicts.light.fit import quantile_of
from appliance.measure.verdicts.light.judge import LEAST_COMMON, LEAST_GAINED, judge_light, propose_second
from hw_sim.rendering.sensor import FULL_WELL_E, OFFSET_DN, READ_NOISE_E
from hw_sim.scene import Scene
from tests.support.photographed import HEIGHT_PX, WHITE_DN_PER_US, WIDTH_PX, Wall, coordinates, light, photograph, wall
from tests.support.rendered import render_scan

STEPS = ladder(60.0, 500, 0.0, Span())


def judge(scene: Wall, exposure: Exposure = NOMINAL, seed: int = 1, bend_px: float = 0.0) -> Judgement:
    return judge_light(photograph(scene, exposure, seed), exposure, STEPS, bend_px)


def code(judged: Judgement) -> FaultCode | None:
    return None if judged.fault is None else judged.fault.code


def mains(depth: float, hz: float = 100.0, exposure_s: float = 0.012) -> tuple[float, ...]:
    """What a lamp that flickers at ``hz`` gives to each of 24 frames, averaged over its exposure."""
    seen = depth * math.sin(math.pi * hz * exposure_s) / (math.pi * hz * exposure_s)
    return tuple(1.0 + seen * math.cos(2.0 * math.pi * hz * k / 60.0 + 0.7) for k in range(24))


@pytest.mark.parametrize("seed", range(3))
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
    assert code(after) is not FaultCode.TOO_BRIGHT or before.proposal == STEPS[0]


@pytest.mark.parametrize(("exposure", "albedo"), [(STEPS[0], 0.12), (NOMINAL, 0.9), (STEPS[-1], 0.4)])
def test_the_proposal_uses_the_scale_and_does_not_leave_it(exposure: Exposure, albedo: float) -> None:
    """Saturation of a saturated scene is not known from its frames, and has to be estimated."""
    scene = Wall(wall(3, albedo / 5.0, albedo))
    proposed = judge(scene, exposure).proposal or exposure
    frames = photograph(scene, proposed, 9).frames["left"]
    assert np.mean(frames[0] == 255) < 0.003
    assert np.quantile(frames[0], 0.997) > 125 or proposed == STEPS[-1]


def test_bits_that_an_exposure_sees_in_part_are_no_flicker() -> None:
    """Steps of the sine have harmonics 6 and 10, which neighbours have in common as they have a net of caustics."""
    bits = (0.02, -0.025, 0.02)
    steady = judge(Wall(wall(5, 0.3, 0.5), bits=bits))
    assert steady.fault is None
    lamp = judge(Wall(wall(5, 0.3, 0.5), ambient=0.3, flicker=mains(0.8), bits=bits))
    assert code(lamp) is FaultCode.LIGHT_FLICKERS


def test_a_lamp_is_believed_where_it_does_more_than_bent_fringes_look_like() -> None:
    scene = Wall(wall(5, 0.3, 0.5), ambient=0.3, flicker=mains(0.8))
    ripple_px = max(judge(scene).verdict.numbers[f"{side}_flicker_ripple_px"] or 0.0 for side in ("left", "right"))
    # Bent fringes look like at most half of their bend.
    for bend_px, told in ((1.9 * ripple_px, True), (2.1 * ripple_px, False)):
        assert (code(judge(scene, bend_px=bend_px)) is FaultCode.LIGHT_FLICKERS) is told


def test_what_is_right_is_left_alone() -> None:
    good = judge(Wall(wall(4, 0.1, 0.55), ambient=0.05))
    assert (good.verdict.passed, good.proposal, good.fault) == (True, None, None)
    assert good.verdict.numbers["left_saturated_percent"] == 0.0
    assert good.verdict.numbers["left_ambient_percent"] == pytest.approx(5.0, abs=0.5)


def test_without_any_light_of_the_projector_nothing_is_judged() -> None:
    dark = judge(Wall(np.zeros((HEIGHT_PX, WIDTH_PX)), ambient=0.1))
    assert (dark.verdict.passed, dark.proposal, dark.fault) == (None, None, None)


# ------------------------------------------------------------------------------------ changing light


@pytest.mark.parametrize(("ambient", "depth"), [(0.1, 0.1), (0.4, 0.3), (0.1, 0.9)])
def test_flicker_is_a_fault_exactly_where_it_does_harm(ambient: float, depth: float) -> None:
    """Harm is what the flicker does to the phases of exact light, against the noise of the camera."""
    scene = Wall(wall(5, 0.15, 0.5), ambient=ambient, flicker=mains(depth))
    over_noise = true_ripple_over_noise(scene)
    judged = judge(scene)
    numbers = judged.verdict.numbers
    assert numbers["left_flicker_over_noise"] == pytest.approx(over_noise, rel=0.15, abs=0.06)
    seen = depth * math.sin(1.2 * math.pi) / (1.2 * math.pi)
    assert numbers["left_flicker_percent"] == pytest.approx(100.0 * ambient * abs(seen), rel=0.08, abs=0.1)
    if over_noise > 0.65:
        assert code(judged) is FaultCode.LIGHT_FLICKERS
    if over_noise < 0.35:
        assert judged.fault is None


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


def test_lamps_on_mains_are_answered_by_an_exposure_of_a_whole_period() -> None:
    verdict = judge(Wall(wall(7, 0.15, 0.52), 0.4, mains(0.9)))
    assert (code(verdict), verdict.proposal) == (FaultCode.LIGHT_FLICKERS, Exposure(10_000))
    steady = Wall(wall(7, 0.15, 0.52), 0.4, mains(0.9, exposure_s=0.010))
    again = judge(steady, Exposure(10_000))
    assert (again.fault, again.proposal) == (None, None)


def test_labels_on_black_rubber_do_not_flicker() -> None:
    """Half saturated, and dark ones before which backscatter has a larger share: neither is a change of light."""
    scan = render_scan(Scene("plane", texture="labels", ambient=0.2), "realistic", 41, 320, 16, 0.012)
    camera = camera_noise(FULL_WELL_E, READ_NOISE_E, OFFSET_DN, 0.0)
    taken = ScanImages(scan.sequence, scan.frames, {}, AcquisitionSettings(noise=StereoNoise(camera, camera)))
    judged = judge_light(taken, NOMINAL, STEPS)
    numbers = {name: number or 0.0 for name, number in judged.verdict.numbers.items()}
    assert numbers["left_saturated_percent"] > 10.0
    assert code(judged) is not FaultCode.LIGHT_FLICKERS
    assert max(numbers[f"{side}_flicker_harmed_percent"] for side in ("left", "right")) < 5.0


def test_a_torch_that_sweeps_over_a_part_is_a_change_of_light_and_one_that_rests_is_not() -> None:
    p, q = coordinates()
    albedo = wall(9, 0.2, 0.45)
    sweeping = {k: 0.25 * np.exp(-((p - 200.0 - 25.0 * k) ** 2 + (q - 350.0) ** 2) / 2.0 / 130.0**2) for k in range(24)}
    assert code(judge(Wall(albedo, 0.02, patches=sweeping))) is FaultCode.LIGHT_FLICKERS
    resting = judge(Wall(albedo, 0.02, patches=dict.fromkeys(range(24), sweeping[12])))
    assert resting.fault is None
    numbers = resting.verdict.numbers
    assert numbers["left_torch_percent"] == pytest.approx(100.0 * np.quantile(0.02 + sweeping[12], 0.9), rel=0.1)
    assert numbers["left_ambient_percent"] == pytest.approx(100.0 * np.median(0.02 + sweeping[12]), rel=0.1)


def test_what_a_torch_burns_away_proposes_no_exposure_and_what_the_projector_does_proposes_a_shorter_one() -> None:
    """A torch's spot was TOO BRIGHT, and the shorter exposure that was offered took the light from all around it."""
    p, q = coordinates()
    spot = 3.0 * np.exp(-((p - 400.0) ** 2 + (q - 300.0) ** 2) / 2.0 / 130.0**2)
    albedo = wall(10, 0.2, 0.45)
    burnt, exposed = judge(Wall(albedo, spot)), judge(Wall(albedo), Exposure(16_000, 12.0))
    for judged in (burnt, exposed):
        assert (judged.verdict.numbers["left_saturated_percent"] or 0.0) > 10.0
    assert (code(burnt), burnt.proposal, burnt.second) == (FaultCode.AMBIENT, None, None)
    assert (burnt.verdict.numbers["left_burnt_percent"] or 0.0) > 5.0
    assert code(exposed) is FaultCode.TOO_BRIGHT
    assert exposed.proposal is not None
    assert exposed.proposal.light < Exposure(16_000, 12.0).light
    assert exposed.verdict.numbers["left_burnt_percent"] == 0.0


@pytest.mark.parametrize("count", [1, 2, 24, 520])
def test_quantiles_of_a_block_are_those_of_numpy(count: int) -> None:
    """Whatever the values: evenly spread, equal, of a few kinds, or nearly all in one bin beside an outlier."""
    rng = np.random.default_rng(count)
    outlier = np.where(np.arange(count) == count // 2, 1e12, rng.random(count))
    for values in (rng.normal(size=count), np.full(count, 3.0), rng.integers(0, 9, count).astype(np.float64), outlier):
        for share in (0.0, 0.1, 0.5, 0.9, 1.0):
            assert quantile_of(values, share) == pytest.approx(float(np.quantile(values, share)), rel=1e-12)


FULL_DN, ENOUGH_DN = 253.0, 5.0
"""White, and the modulation that decoding asks for."""
DEPTH = 0.45
"""Modulation over the brightest level."""
Tones = dict[float, float]
"""Share of the lit pixels by their brightest level at 12 ms, in grey values."""


def second_to(tones: Tones, present: Exposure = NOMINAL) -> Exposure | None:
    level = np.array(list(tones), np.float32) * np.float32(present.light / 12_000.0)
    top = np.repeat(level, [round(10_000 * share) for share in tones.values()])
    return propose_second([(top, np.float32(DEPTH) * top)] * 2, [FULL_DN] * 2, present, STEPS)


def shown(tones: Tones, *exposures: Exposure) -> float:
    """Share of the pixels that at least one of them shows."""
    factors = [one.light / 12_000.0 for one in exposures]
    seen = {level: any(ENOUGH_DN / DEPTH <= level * f < FULL_DN for f in factors) for level in tones}
    return sum(share for level, share in tones.items() if seen[level])


TOO_DARK: Tones = {200.0: 0.5, 60.0: 0.2, 5.0: 0.3}
TOO_BRIGHT: Tones = {800.0: 0.4, 100.0: 0.2, 20.0: 0.4}
MANY: Tones = {180.0: 0.2, 120.0: 0.2, 60.0: 0.1, 15.0: 0.2, 5.0: 0.3}


@pytest.mark.parametrize("present", [Exposure(8_000), Exposure(16_000)])
@pytest.mark.parametrize("tones", [TOO_DARK, TOO_BRIGHT, MANY, {250.0: 0.3, 90.0: 0.3, 12.0: 0.2, 4.0: 0.2}])
def test_the_pair_shows_clearly_more_than_any_exposure_and_any_other_pair(tones: Tones, present: Exposure) -> None:
    second = second_to(tones, present)
    best_alone = max(shown(tones, one) for one in (present, *STEPS))
    with_common = [one for one in STEPS if shown_by_both(tones, present, one) >= LEAST_COMMON]
    best_pair = max((shown(tones, present, one) for one in with_common), default=0.0)
    if second is None:
        assert best_pair < best_alone + LEAST_GAINED or best_alone > 0.95
        return
    assert shown(tones, present, second) >= best_pair - 0.01
    assert shown(tones, present, second) >= best_alone + LEAST_GAINED


def shown_by_both(tones: Tones, first: Exposure, second: Exposure) -> float:
    return shown(tones, first) + shown(tones, second) - shown(tones, first, second)


def test_of_second_exposures_that_show_the_same_the_one_that_spoils_least_is_taken() -> None:
    second = second_to(MANY)
    assert second is not None
    as_good = [one for one in STEPS if shown(MANY, NOMINAL, one) >= shown(MANY, NOMINAL, second)]
    alone = [shown(MANY, one) for one in as_good]
    assert min(alone) < shown(MANY, second) == max(alone)


@pytest.mark.parametrize("tones", [{200.0: 0.5, 20.0: 0.5}, {600.0: 0.5, 80.0: 0.5}, {250.0: 0.5, 3.0: 0.5}])
def test_where_one_exposure_serves_or_two_have_nothing_in_common_no_second_one_follows(tones: Tones) -> None:
    """Of the second pair a shorter one shows all: that is EXPOSE's."""
    assert second_to(tones) is None
