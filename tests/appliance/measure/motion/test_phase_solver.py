"""What the pixels of a row are solved to, against the moving plane they were drawn from and by NumPy's least squares."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.decode.decoder import MIN_MODULATION_DN
from appliance.measure.light.patterns import Direction, build_sequence
from appliance.measure.motion import phase_solver as at
from appliance.measure.motion.displacement import (
    FIRST_FRAME,
    FRAME_COEFFICIENTS,
    OF_PHASE,
    P_OF_T,
    Q_OF_T,
    DisplacementField,
)
from appliance.measure.motion.phase_solver import FIRST_GRAY, Sources, Terms, solve_rows
from appliance.measure.motion.redecode import empty_maps, sees_fringes

PERIOD_PX = 16


HEIGHT, WIDTH, STEP = 12, 160, 8


def moving_plane() -> tuple[Sources, DisplacementField, Terms]:
    """Return a plane at t = 0.1 with an edge of contrast, moving along p by a sixth of a period per frame, as one camera sees it."""
    sequence = build_sequence(PERIOD_PX)
    x_axis, y_axis = sequence.axis(Direction.X), sequence.axis(Direction.Y)
    followed = (*x_axis.sine, sequence.bright, *x_axis.gray, *y_axis.gray)
    nodes = np.zeros(
        (HEIGHT // STEP + 2, WIDTH // STEP + 2, FIRST_FRAME + FRAME_COEFFICIENTS * len(followed)), np.float32
    )
    columns = STEP * np.arange(nodes.shape[1])
    # p = 300 + x + 20 t, q = 200 + 4 t.
    nodes[..., P_OF_T], nodes[..., P_OF_T + 1] = 300.0 + columns, 20.0
    nodes[..., Q_OF_T], nodes[..., Q_OF_T + 1] = 200.0, 4.0
    depth = 0.1
    frames = np.zeros((len(sequence), HEIGHT, WIDTH), np.uint8)
    rng = np.random.default_rng(2)
    for k, frame in enumerate(followed):
        moved_px = 1.4 * (k - 1.5) if k < FIRST_GRAY else 0.8
        at_frame = FIRST_FRAME + FRAME_COEFFICIENTS * k
        nodes[..., at_frame] = moved_px
        nodes[..., at_frame + OF_PHASE] = -0.02 * (k - 1.5) if k < FIRST_GRAY else 0.03
        turned_px = PERIOD_PX * float(nodes[0, 0, at_frame + OF_PHASE])
        # The pixel in which a point is seen in this frame shows what the point is lit by.
        p = 300.0 + np.arange(WIDTH) - moved_px + 20.0 * depth + turned_px
        # Lenses blur: no border of a stripe is sharp.
        codes = np.convolve(sequence.patterns[frame].codes().astype(np.float64), [0.25, 0.5, 0.25], "same")
        lit = np.interp(p, np.arange(len(codes)), codes)
        if k in range(FIRST_GRAY + len(x_axis.gray), len(followed)):
            lit = np.full(WIDTH, 255.0)
        frames[frame] = np.clip(np.rint(20.0 + 0.6 * lit + rng.normal(0.0, 0.5, (HEIGHT, WIDTH))), 0, 254)
    plain = np.tile(300.0 + np.arange(WIDTH) + 20.0 * depth, (HEIGHT, 1)).astype(np.float32)
    plain += 0.15 * np.sin(np.arange(WIDTH)).astype(np.float32)  # motion's ripple
    plain[:, 40:60] = np.nan
    rough = np.full((HEIGHT, WIDTH), depth, np.float32)
    rough[:, 150:] = np.nan
    frames.flags.writeable = False
    sources = Sources(frames, np.asarray(followed, np.int64), np.ones(8, np.float32), plain, rough)
    terms = Terms(
        period_px=np.float32(PERIOD_PX), width_px=np.float32(1024), height_px=np.float32(768),
        noise_dn=np.float32(0.6), dark_dn2=np.float32(0.3),
        shot_dn=np.float32(0.001), gray=len(x_axis.gray), fill_px=5, settled_t=np.float32(0.02), harmonic=np.float32(0.0),
    )  # fmt: skip
    return sources, DisplacementField(nodes, STEP), terms


def test_pixels_of_a_moving_plane_are_solved_to_where_they_are() -> None:
    sources, field, terms = moving_plane()
    maps = empty_maps(HEIGHT, WIDTH)
    solve_rows(sources, field, terms, 0, 1, maps, np.zeros(2))
    known = np.isfinite(maps.p_px)
    true_px = 300.0 + np.arange(WIDTH) + 2.0
    assert known[1:-2, 8:140].mean() > 0.98, "those whose plain decoding knows nothing are known as well"
    assert np.abs(maps.p_px - true_px)[known].max() < 0.15
    assert np.abs(maps.q_px[known] - 200.4).max() < 0.03
    assert not known[:, 150:].any(), "pixels that see no fringes are not asked"
    sigma_px = np.sqrt(maps.variance_px2[known])
    assert np.std((maps.p_px - true_px)[known]) == pytest.approx(float(sigma_px.mean()), rel=0.5)


@pytest.mark.parametrize("steps_deg", [10.0, 30.0, 90.0, 150.0])
def test_sines_are_solved_by_least_squares(steps_deg: float) -> None:
    _, _, terms = moving_plane()
    psi = np.radians(steps_deg) * np.arange(4.0)
    y = np.array([101.0, 87.0, 60.0, 72.0])
    A = np.stack([np.ones(4), np.cos(psi), -np.sin(psi)], -1)
    (a, m_c, m_s), *_ = np.linalg.lstsq(A, y)
    scratch = np.zeros(1, at.ROW)
    s = scratch[0]
    for k in range(4):
        s["sine_grey"][k, 0], s["sine_noise"][k, 0] = y[k], 1.0
        s["sine_turns"][k, 0] = steps_deg * k / 360.0 - 0.25 * k
    # Noise that allows any contradiction: the four values are no sine.
    at._solve_sines(1, np.ones(4, np.float32), terms._replace(noise_dn=np.float32(100.0)), scratch)
    # Steps of 10° multiply what 32 bits round.
    within = 2e-3 if steps_deg == 10.0 else 2e-4
    assert s["offset"][0] == pytest.approx(a, rel=within)
    assert s["modulation"][0] == pytest.approx(np.hypot(m_c, m_s), rel=within)
    assert s["phase"][0] == pytest.approx(np.arctan2(m_s, m_c) / (2.0 * np.pi) % 1.0, abs=within)


def test_pixels_that_no_fringe_comes_near_are_not_asked() -> None:
    _, field, _ = moving_plane()
    sines = np.full((4, HEIGHT, WIDTH), 12, np.uint8)
    sines[1, :, 50:60] = 12 + int(MIN_MODULATION_DN)
    sines[2, :, 100:110] = 12 + int(MIN_MODULATION_DN) - 1
    asked = sees_fringes(sines, field)
    # The x-sines move by 2.1 px at most, and a spot between pixels reaches 2 px farther.
    assert [int(x) for x in np.flatnonzero(asked[5])] == list(range(45, 65))


def test_pixels_whose_steps_are_next_to_nothing_do_not_spoil_the_harmonic() -> None:
    # A hand along with the fringes: what 32 bits make of the offset of four equal phases has any variance, also a negative one.
    scratch = np.zeros(1, at.ROW).view(np.recarray)
    s = scratch[0]
    s.contrary[:WIDTH], s.response[:WIDTH], s.offset_share[:WIDTH] = 0.5, 10.0, 0.25
    for x, share, response in ((10, -1e-3, 1e3), (20, np.inf, 1e9), (30, np.nan, np.nan), (40, 1e5, 1e7)):
        s.offset_share[x], s.response[x] = share, response
    sums = np.zeros(2)
    at._add_to_sums.py_func(WIDTH, scratch, sums)
    assert sums[0] / sums[1] == pytest.approx(0.05)
