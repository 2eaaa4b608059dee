"""Two exposures as one: what one loses the other gives, what both have gets better, and what moved is not believed."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.patterns.sequence import build_sequence
from appliance.reconstruct.decode.decoder import CameraDecoder, Mask
from appliance.reconstruct.images import ScanImages
from appliance.reconstruct.merge import Agreement, merge
from appliance.scan.exposure import Exposure
from appliance.scan.noise import TYPICAL, CameraNoise, camera_noise
from tests.support.photographed import HEIGHT_PX, WIDTH_PX, Wall, coordinates, photograph, wall

SHORT, LONG = Exposure(2_500), Exposure(16_000)
WIDE = Wall(wall(3, 0.008, 2.0))
"""250 : 1, more than any single exposure holds."""


def decoded(recorded: ScanImages) -> CameraDecoder:
    decoder = CameraDecoder(recorded.sequence, WIDTH_PX, HEIGHT_PX)
    for k in range(len(recorded.sequence)):
        decoder.push(recorded.frames["left"], k)
    return decoder


def merged(
    scene: Wall, exposures: tuple[Exposure, Exposure] = (SHORT, LONG), later: Wall | None = None
) -> tuple[CameraDecoder, CameraDecoder, Agreement]:
    """The merged maps, those of the second exposure alone, and how far they agreed."""
    first, second = decoded(photograph(scene, exposures[0], 1)), decoded(photograph(later or scene, exposures[1], 2))
    return first, second, merge_maps(first, second, (noise_at(exposures[0]), noise_at(exposures[1])))


def noise_at(exposure: Exposure) -> CameraNoise:
    return camera_noise(13_000, 20, 2, exposure.gain_db)


def merge_maps(first: CameraDecoder, second: CameraDecoder, noise: tuple[CameraNoise, CameraNoise]) -> Agreement:
    return merge(first, second, noise, 16, np.empty(first.mask.shape, np.float32))


def errors_px(decoder: CameraDecoder) -> np.ndarray:
    """(n, 2) of the valid pixels."""
    p, q = coordinates()
    valid = decoder.mask == Mask.VALID
    return np.stack([(decoder.p_px - p)[valid], (decoder.q_px - q)[valid]], 1)


def test_together_they_have_what_neither_has_alone() -> None:
    alone = [np.mean(decoded(photograph(WIDE, e, 1)).mask == Mask.VALID) for e in (SHORT, LONG)]
    both, _, agreement = merged(WIDE)
    together = np.mean(both.mask == Mask.VALID)
    assert 1.0 - together < 0.4 * (1.0 - max(alone)), "most of what is missing in the better one is there"
    assert agreement.first > 0.05
    assert agreement.second > 0.3
    assert agreement.shift is not None
    assert agreement.shift < 0.2, "one wall, at rest"


@pytest.mark.parametrize(
    "exposures", [(SHORT, LONG), (Exposure(10_000), Exposure(12_000)), (SHORT, Exposure(16_000, 6.0))]
)
def test_the_error_that_is_expected_of_a_merged_pixel_is_the_one_it_has(exposures: tuple[Exposure, Exposure]) -> None:
    both, second = (decoded(photograph(Wall(wall(4, 0.03, 0.9)), e, k)) for k, e in enumerate(exposures, start=1))
    variance_px2 = np.empty(both.mask.shape, np.float32)
    merge(both, second, (noise_at(exposures[0]), noise_at(exposures[1])), 16, variance_px2)
    z = errors_px(both) / np.sqrt(variance_px2[both.mask == Mask.VALID])[:, None]
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.06)
    assert np.mean(np.abs(z) > 4.0) < 0.001


def test_what_both_have_is_better_than_either() -> None:
    scene, exposure = Wall(wall(5, 0.3, 0.5)), Exposure(10_000)
    one = np.std(errors_px(decoded(photograph(scene, exposure, 1))))
    both, _, _ = merged(scene, (exposure, exposure))
    assert np.std(errors_px(both)) == pytest.approx(one / np.sqrt(2.0), rel=0.05)


def test_what_moved_in_between_is_masked_where_it_moved() -> None:
    """A disc of the second wall is dark, and what it shows in its middle is nearer by a fringe."""
    scene = Wall(wall(6, 0.2, 0.6))
    first = photograph(scene, Exposure(8_000), 1)
    second = photograph(scene, Exposure(10_000), 2)
    moved = np.roll(second.frames["left"], 2, axis=2)
    v, u = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX]
    disc = (u - 120) ** 2 + (v - 90) ** 2 < 30**2
    second.frames["left"][:, disc] = moved[:, disc]
    maps = decoded(first)
    agreement = merge_maps(maps, decoded(second), (TYPICAL, TYPICAL))
    inner = (u - 120) ** 2 + (v - 90) ** 2 < 26**2
    assert np.mean(maps.mask[inner] == Mask.VALID) < 0.002
    assert np.isnan(maps.p_px[inner]).mean() > 0.998
    assert agreement.agrees, "a part that moved is masked; the rest is as good as ever"
    assert np.mean(maps.mask[~disc] == Mask.VALID) > 0.98


def test_when_all_has_moved_the_scans_do_not_agree() -> None:
    scene = Wall(wall(7, 0.2, 0.6))
    second = photograph(scene, Exposure(10_000), 2)
    shifted = np.roll(second.frames["left"], 1, axis=2)
    maps = decoded(photograph(scene, Exposure(8_000), 1))
    other = decoded(ScanImages(second.sequence, {"left": shifted}, {}, second.settings))
    assert merge_maps(maps, other, (TYPICAL, TYPICAL)).agrees is False


def test_without_pixels_in_common_nothing_can_be_said_of_agreement() -> None:
    bright = photograph(Wall(np.full((HEIGHT_PX, WIDTH_PX), 0.6)), Exposure(8_000), 1)
    dark = photograph(Wall(np.zeros((HEIGHT_PX, WIDTH_PX))), Exposure(8_000), 1)
    assert merge_maps(decoded(bright), decoded(dark), (TYPICAL, TYPICAL)).agrees is None


def test_maps_of_another_size_are_refused() -> None:
    maps, small = decoded(photograph(WIDE, SHORT, 1)), CameraDecoder(build_sequence(16), 64, 48)
    with pytest.raises(ValueError, match="must be of one camera"):
        merge_maps(maps, small, (TYPICAL, TYPICAL))
