"""Where the edges of the Gray stripes stood: against the phase that the sine images found afterwards."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.light.patterns import Direction, build_sequence
from appliance.measure.verdicts.motion import edges as motion_edges
from appliance.measure.verdicts.motion.edges import edge_shifts

SEQUENCE = build_sequence(16, 320, 200)
ROWS, COLUMNS = 4, 5
GRAY_X = SEQUENCE.axis(Direction.X).gray


def striped(width: int, height: int, veil: float = 0.0) -> tuple[np.ndarray, CameraDecoder]:
    """Gray stripes with soft edges, moved by 0.4 px, over pixels whose coordinates are halves of px; ``veil``: share of bright less
    dark that lies over dark stripes, too."""
    rng = np.random.default_rng(7)
    v, u = np.mgrid[0:height, 0:width].astype(float)
    p = np.round(2.0 * (-15.0 + 350.0 * u / width)) / 2.0
    q = -12.0 + 280.0 * v / height
    p[rng.random(p.shape) < 0.05] = np.nan
    dark = rng.integers(5, 40, p.shape)
    bright = dark + rng.choice([7, 8, 9, 60, 150], p.shape)
    frames = np.zeros((len(SEQUENCE), height, width), np.uint8)
    frames[SEQUENCE.bright], frames[SEQUENCE.dark] = bright, dark
    for k in GRAY_X:
        codes = SEQUENCE.patterns[k].codes() / 247.0
        soft = np.interp(np.nan_to_num(p) + 0.4 + np.array([[[-1.5]], [[0.0]], [[1.5]]]), np.arange(320), codes).mean(0)
        soft = veil + (1.0 - veil) * soft
        frames[k] = np.clip(np.rint(dark + (bright - dark) * soft + rng.normal(0.0, 1.0, p.shape)), 0, 255)
    decoder = CameraDecoder(SEQUENCE, width, height)
    decoder.p_px[:], decoder.q_px[:] = p, q
    return frames, decoder


@pytest.mark.parametrize("veil", [0.0, 0.3])
def test_every_edge_takes_as_much_light_with_it_as_it_has_moved(veil: float) -> None:
    found = edge_shifts(*striped(450, 340, veil), SEQUENCE)
    assert np.isfinite(found).sum() > 30
    assert np.isnan(found).any()
    assert np.nanmedian(found) == pytest.approx(0.4, abs=0.15)
    assert np.nanmedian(np.abs(found - 0.4)) < 0.3


def added(inner: float = 20.0, low: float = 12.0, high: float = 12.0, height: float = 0.8) -> np.ndarray:
    """Sums of an edge at which light begins, that has moved by 0.9 px: of 20 pixels over 9 px, two more are lit."""
    lit = inner * (0.1 + 0.6 * height)
    return np.array([(inner, lit, 0.5 * inner, inner, low, 0.1 * low, high, (0.1 + height) * high)], motion_edges.SUMS)


def test_an_edge_that_moved_is_known_from_ten_pixels_of_each_part_and_from_enough_contrast() -> None:
    def shift(**parts: float) -> float:
        return float(motion_edges._shifts_of_sums(added(**parts))[0])

    assert shift() == pytest.approx(0.9)
    for part in ("inner", "low", "high"):
        assert shift(**{part: 10.0}) == pytest.approx(0.9)
        assert np.isnan(shift(**{part: 9.0}))
        assert np.isnan(shift(**{part: 0.0}))
    assert shift(height=0.31) == pytest.approx(0.9)
    assert np.isnan(shift(height=0.29))


def test_edges_of_what_lies_below_the_last_row_of_cells_are_added_nowhere() -> None:
    frames, decoder = striped(160, 120)
    edges_px, rises = motion_edges.edges_of(SEQUENCE)
    gray = np.array(GRAY_X, np.int64)
    sums = np.zeros((len(GRAY_X), ROWS + 1, COLUMNS), motion_edges.SUMS)
    motion_edges._accumulate(frames, (0, 1), gray, decoder.p_px, decoder.q_px, edges_px, rises, 1, 64.0, sums[:, :ROWS])
    assert (decoder.q_px > 256.0).any()
    assert (sums["inner"][:, :ROWS] > 0.0).any()
    assert not any((sums[name][:, ROWS] != 0.0).any() for name in sums.dtype.names or ())
