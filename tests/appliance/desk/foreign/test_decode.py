"""Codes of others, drawn by their own formulas, give the coordinate that was drawn; what cannot be told has its reason or its error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.desk.foreign.camera import DecodedCamera, clean, decode_camera
from appliance.desk.foreign.decode import Reason
from appliance.desk.foreign.description import parse_description, with_counts
from appliance.desk.foreign.images import ImageSet
from appliance.desk.foreign.phase import TURN, correct_response, fit_sine

Lines = NDArray[np.float64]
SIZE_PX, ROWS = 1024, 40
EDGE_PX = np.linspace(3.0, SIZE_PX - 3.0, 600)[None] + np.linspace(0.0, 2.0, ROWS)[:, None]


def decoded(
    images: Sequence[Lines], order: str, words: str, sides: str = "left", white: float = 255.0
) -> DecodedCamera:
    """Images as numbers from 0 to 1, described for a pattern of 1024 px."""
    text = "\n".join(f'{side} = "{side}/*"' for side in sides.split())
    text = f'[images]\n{text}\norder = "{order}"\n[projector]\nwidth_px = {SIZE_PX}\nheight_px = 768\n[x]\n{words}\n[cameras]\n'
    said = parse_description(text, Path(), "set", "set.toml")
    shown = said.order or ()
    stack = np.rint(20.0 + 200.0 * np.stack(images)).astype(np.uint8)
    return decode_camera(ImageSet(shown, (), stack, white), with_counts(said, shown))


def sine(edge_px: Lines, period_px: float, degrees: float = 0.0) -> Lines:
    return np.asarray(0.5 + 0.5 * np.cos(2 * np.pi * edge_px / period_px + np.deg2rad(degrees)))


def steps(edge_px: Lines, period_px: float, count: int, start_deg: float = 0.0) -> list[Lines]:
    return [sine(edge_px, period_px, start_deg + 360.0 * k / count) for k in range(count)]


def gray(edge_px: Lines, stripe_px: float, bits: int) -> list[Lines]:
    number = np.floor(edge_px / stripe_px).astype(int)
    return [((number ^ (number >> 1)) >> bit & 1).astype(float) for bit in reversed(range(bits))]


def modulated(edge_px: Lines) -> list[Lines]:
    """Twelve fringes times a carrier over the rows; a third of the light comes by way of another place, whose carrier is blurred away."""
    rows = np.arange(ROWS, dtype=float)[:, None] + 0.0 * edge_px
    shots = []
    other = steps(0.6 * edge_px + 100.0, SIZE_PX / 12, 3)
    for light, room in zip(steps(edge_px, SIZE_PX / 12, 3), other, strict=True):
        shots += [0.6 * light * sine(rows, 8.0, 120.0 * k) + 0.3 * room for k in range(3)]
    return shots + steps(edge_px, SIZE_PX, 3)


def micro(edge_px: Lines) -> list[Lines]:
    return steps(edge_px, 75.0, 3) + [
        sine(edge_px, p, 180.0 * k) for k, p in enumerate((70.0, 71.5, 73.0, 76.5, 78.0, 80.0))
    ]


CODES: list[tuple[Callable[[Lines], list[Lines]], str, str, float]] = [
    # A code that numbers the coarsest of three periods, each of which begins elsewhere.
    (lambda e: [*gray(e, 128, 3), *steps(e, 128, 4, 30), *steps(e, 32, 5, -40), *steps(e, 8, 4)],
     "gray-x*3 sine-x*4 sine-x2*5 sine-x3*4", "period_px = [128, 32, 8]\nsteps = [4, 5, 4]\nstart_deg = [30, -40, 0]\nstripe_px = 128", 0.04),
    (lambda e: [*steps(e - 0.5, 64, 3), *steps(e - 0.5, SIZE_PX, 3)], "sine-x*3 sine-x2*3",
     'fringes = [16, 1]\nsteps = 3\nstart_at = "middle"', 0.2),
    (lambda e: [*gray((e + 32) % SIZE_PX, 64, 4), *steps(e, 64, 4)], "gray-x*4 sine-x*4", 'period_px = 64\nsteps = 4\ngray = "shifted"', 0.2),
    (modulated, "modulated-x*9 sine-x2*3", "fringes = [12, 1]\nsteps = 3", 1.0),
    (micro, "micro-x*9", "period_px = [75, 70, 71.5, 73, 76.5, 78, 80]\nsteps = 3\nstart_deg = [0, 0, 180, 0, 180, 0, 180]", 0.2),
]  # fmt: skip


@pytest.mark.parametrize(("draw", "order", "words", "most_px"), CODES)
def test_rarer_codes_give_the_coordinate_that_was_drawn(
    draw: Callable[[Lines], list[Lines]], order: str, words: str, most_px: float
) -> None:
    found = decoded(draw(EDGE_PX), order, words).placed["x"]
    valid = found.reason == Reason.FOUND
    assert valid.mean() > 0.98
    off_px = np.abs(found.coordinate_px + 0.5 - EDGE_PX)[valid]
    assert float(np.quantile(off_px, 0.995)) < most_px


def test_all_images_of_micro_phase_shifting_make_the_coordinate() -> None:
    """Nine images have two thirds of the noise of the first three."""
    random = np.random.default_rng(3)
    shot = [one + random.normal(0.0, 0.005, one.shape) for one in micro(EDGE_PX)]
    words = CODES[-1][2]
    all_px = decoded(shot, "micro-x*9", words).placed["x"].coordinate_px + 0.5 - EDGE_PX
    first_px = decoded(
        [*shot[:3], *steps(EDGE_PX, SIZE_PX, 3)], "sine-x*3 sine-x2*3", f"period_px = [75, {SIZE_PX}]\nsteps = 3"
    )
    assert np.nanstd(all_px) < 0.7 * np.nanstd(first_px.placed["x"].coordinate_px + 0.5 - EDGE_PX)


@pytest.mark.parametrize(("sides", "outside"), [("left", True), ("left right", False)])
def test_what_lies_beyond_the_pattern_is_outside_of_one_camera_alone(sides: str, outside: bool) -> None:
    """Of two cameras the pattern is what the code covers: 1,024 px, of which a wrong size must not cut half."""
    words = "period_px = 64\nsteps = 4\ncode_offset_px = 0"
    found = decoded([*gray(EDGE_PX, 64, 5), *steps(EDGE_PX, 64, 4)], "gray-x*5 sine-x*4", words, sides)
    assert bool((found.placed["x"].reason == Reason.FOUND).mean() > 0.98)
    beyond = decoded([*gray(2 * EDGE_PX, 64, 5), *steps(2 * EDGE_PX, 64, 4)], "gray-x*5 sine-x*4", words, sides)
    away = beyond.placed["x"].reason[:, 320:-20]
    assert bool((away == (Reason.OUTSIDE if outside else Reason.FOUND)).mean() > 0.98)


@pytest.mark.parametrize(("count", "gamma", "darkest"), [(3, 1.8, 0.3), (4, 4.0, 0.6)])
def test_a_bent_response_is_taken_away_and_what_remains_is_said(count: int, gamma: float, darkest: float) -> None:
    """Bright rows and dark ones are bent differently: one curve for all leaves something."""
    random = np.random.default_rng(4)
    bright = np.linspace(darkest, 1.0, ROWS)[:, None]
    shots = [
        ((0.1 + bright * one) / 1.1) ** gamma + random.normal(0, 0.001, one.shape) for one in steps(EDGE_PX, 64, count)
    ]
    images = [*gray(EDGE_PX, 64, 4), *shots]
    found = decoded(images, f"gray-x*4 sine-x*{count}", f"period_px = 64\nsteps = {count}")
    axis = clean(found.placed["x"])
    off_px = axis.coordinate_px + 0.5 - EDGE_PX
    straight = fit_sine(shots, tuple(360.0 * k / count for k in range(count)), 2.0).turns - EDGE_PX / 64
    bent_px = 64.0 * (straight - np.rint(straight))
    left_px, said_px = (float(np.sqrt(np.nanmean(one**2))) for one in (off_px, axis.sigma_px[np.isfinite(off_px)]))
    assert left_px < 1.3 * said_px < 0.7 * float(bent_px.std())
    share = found.measured["x"].misfit_share
    assert share is None if count == 3 else (share or 0.0) > 0.15


def test_bright_places_have_more_noise_than_dark_ones_and_a_point_says_how_much() -> None:
    """Photons that are counted scatter by the root of their number (Poisson), whatever the camera."""
    random = np.random.default_rng(6)
    bright = np.linspace(0.1, 1.0, ROWS)[:, None]
    # A tenth of the light comes from the room.
    shots = [random.poisson(400.0 * (0.1 + bright * one)) / 400.0 - 0.1 for one in steps(EDGE_PX, 64, 3)]
    found = clean(
        decoded([*gray(EDGE_PX, 64, 4), *shots], "gray-x*4 sine-x*3", "period_px = 64\nsteps = 3").placed["x"]
    )
    off_px = found.coordinate_px + 0.5 - EDGE_PX
    for rows in (slice(0, 8), slice(16, 24), slice(-8, None)):
        scatter_px = 1.4826 * float(np.nanmedian(np.abs(off_px[rows])))
        assert 0.85 < scatter_px / float(np.nanmedian(found.sigma_px[rows])) < 1.15


@pytest.mark.parametrize(
    ("turns", "share", "remains"),
    [
        (np.linspace(0.0, 5.0, 5000), None, 0.0),  # spread evenly
        (np.linspace(0.0, 0.5, 5000), None, 0.0),  # a narrow thing shows some phases more often
        (np.linspace(0.0, 5.0, 5000) + 0.02 * np.sin(8 * np.pi * np.linspace(0.0, 5.0, 5000)), 0.01, 0.005 / TURN),  # steps fit too well
    ],
)  # fmt: skip
def test_phases_that_no_response_has_bent_stay_as_they_are(turns: Lines, share: float | None, remains: float) -> None:
    wrapped = (turns - np.rint(turns)).astype(np.float32)
    before = wrapped.copy()
    assert correct_response(wrapped, np.ones(wrapped.shape, np.bool_), 4, share) == pytest.approx(remains, abs=1e-4)
    assert np.array_equal(wrapped, before)


def test_three_harmonics_of_a_bend_are_taken_away() -> None:
    even = np.linspace(-0.5, 0.5, 100_001)[None, 1:]
    bends = [size * np.sin(n * TURN * even) for n, size in ((4, 0.004), (8, 0.001), (12, 0.001))]
    turns = (even + sum(bends)).astype(np.float32)
    assert correct_response(turns, np.ones(turns.shape, np.bool_), 4, None) < 0.001
    assert float((turns - even).std()) < 0.0003


def test_stripes_that_light_the_room_do_not_vote_on_finer_ones() -> None:
    """Three quarters of the picture see coarse stripes by way of the room, and nothing of the fine ones."""
    thing = np.arange(EDGE_PX.shape[1])[None] // 150 == 2
    stripes = gray(EDGE_PX, 16, 6)
    light = [np.where(thing, one, 0.5 + (0.3 if k < 3 else 0.0) * (one - 0.5)) for k, one in enumerate(stripes)]
    even = np.ones_like(EDGE_PX)
    found = decoded([even, 0.0 * even, *light], "bright dark gray-x*6", "stripe_px = 16")
    bits = found.measured["x"].bits
    assert bits is not None
    assert bits.left_out == (0, 0)
    inner = np.broadcast_to(thing, EDGE_PX.shape)[:, 305:445]
    assert inner.all()
    valid = found.placed["x"].reason == Reason.FOUND
    assert valid[:, 305:445].all()
    assert not valid[:, :290].any()
    assert not valid[:, 460:].any()


@pytest.mark.parametrize(("swing", "reason"), [(2.0, Reason.WEAK), (6.0, Reason.FOUND)])
def test_a_code_alone_needs_a_swing_of_four_grey_values(swing: float, reason: Reason) -> None:
    signs = [(1 - 2 * inverse) * (bit - 0.5) for bit in gray(EDGE_PX, 32, 5) for inverse in (0, 1)]
    found = decoded([0.5 + swing / 200.0 * one for one in signs], "(gray-x ~gray-x)*5", "stripe_px = 32")
    assert (found.placed["x"].reason == reason).mean() > 0.95


def test_more_fringes_than_four_thousand_are_told_apart() -> None:
    edge_px = np.array([[900.0, 9001.0, 9900.0]])
    shots = [*steps(edge_px, 2.0, 4), *steps(edge_px, 2.0 * 5000 / 71, 4), *steps(edge_px, 10000.0, 4)]
    text = "width_px = 10000"
    words = "fringes = [5000, 71, 1]\nsteps = 4"
    said = parse_description(
        f'[images]\nleft = "*"\norder = "sine-x*4 sine-x2*4 sine-x3*4"\n[projector]\n{text}\nheight_px = 768\n[x]\n{words}\n[cameras]\n',
        Path(), "set", "set.toml",
    )  # fmt: skip
    stack = np.rint(2000.0 + 60000.0 * np.stack(shots)).astype(np.uint16)
    found = decode_camera(ImageSet(said.order or (), (), stack, 65535.0), said).placed["x"].coordinate_px + 0.5
    assert np.allclose(found, edge_px, atol=0.01)
