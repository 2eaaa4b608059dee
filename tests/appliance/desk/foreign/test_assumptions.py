"""A test that could not have failed is no fit, and a right description is never wrong: on images of a few lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.desk.foreign.assumptions import ExaminedAssumption, Outcome, examine_axis
from appliance.desk.foreign.camera import decode_camera
from appliance.desk.foreign.description import AxisConvention, Description, ImageFiles
from appliance.desk.foreign.images import ImageSet
from appliance.desk.foreign.order import parse_order
from appliance.desk.foreign.problem import Table

SIZE_PX, ROWS = 1024, 24
EDGE = np.arange(0.25, SIZE_PX, 0.5)
FOUR = (0.0, 90.0, 180.0, 270.0)
Lines = list[NDArray[np.float64]]


def sines(fringes: float, steps_deg: Sequence[float] = FOUR, sign: int = 1, gamma: float = 1.0) -> Lines:
    phase = 2 * np.pi * EDGE * fringes / SIZE_PX
    return [20.0 + 200.0 * (0.5 + 0.5 * np.cos(phase + sign * np.deg2rad(step))) ** gamma for step in steps_deg]


def gray(bits: int, plain: bool = False) -> Lines:
    number = (EDGE * 2**bits / SIZE_PX).astype(int)
    code = number if plain else number ^ (number >> 1)
    return [np.where(code >> bit & 1, 220.0, 20.0) for bit in reversed(range(bits))]


def told(order: str, axis: AxisConvention, lines: Lines, noise: float = 0.5) -> list[ExaminedAssumption]:
    random = np.random.default_rng(1)
    images = np.repeat(np.array(lines)[:, None], ROWS, axis=1)
    shot = np.clip(np.rint(images + random.normal(0.0, noise, images.shape)), 0, 255).astype(np.uint8)
    shown = parse_order(order, "order")
    files = {"left": ImageFiles(("*",))}
    description = Description("", Path(), files, shown, "grey", None, (SIZE_PX, 768), (axis,), Table("", {}))
    camera = decode_camera(ImageSet(shown, (), shot, 255.0), description)
    return examine_axis(camera, axis)


def words(said: list[ExaminedAssumption], outcome: Outcome) -> list[str]:
    return [one.subject.removeprefix("x.") for one in said if one.outcome is outcome]


CODED = AxisConvention("x", SIZE_PX, (32.0,), (FOUR,), bits=5, stripe_px=32.0)
CODE_WORDS = ["code_order", "code_inverted", "code"]


def test_every_word_of_a_gray_code_beside_sines_could_have_failed() -> None:
    said = told("sine-x*4 gray-x*5", CODED, [*sines(32), *gray(5)])
    assert words(said, Outcome.FITS) == ["steps", *CODE_WORDS, "sign", "stripe_px", "start_deg"]
    assert len(said) == 7


def shifted(degrees: float) -> Lines:
    return sines(32, [step + degrees for step in FOUR])


def of_periods(*fringes: float) -> Lines:
    return [line for one in fringes for line in sines(one)]


SEVERAL = AxisConvention("x", SIZE_PX, tuple(SIZE_PX / one for one in (42, 48, 49)), (FOUR,) * 3)


@pytest.mark.parametrize(
    ("order", "axis", "lines", "about", "instead"),
    [
        ("sine-x*4 gray-x*5", CODED, [*sines(32, sign=-1), *gray(5)], "sign", {"sign": -1}),
        ("sine-x*4 gray-x*5", CODED, [*shifted(90.0), *gray(5)], "start_deg", {"start_deg": 90.0}),
        ("sine-x*4 gray-x*5", CODED, [*shifted(180.0), *gray(5)], "code_offset_px", {"code_offset_px": -16.0}),
        ("sine-x*4 gray-x*6", replace(CODED, bits=6), [*sines(32), *gray(6)], "stripe_px", {"stripe_px": 16.0}),
        ("sine-x*4 gray-x*5", CODED, [*sines(32), *(240.0 - one for one in gray(5))], "code_inverted", {"inverted": True}),
        ("sine-x*4 gray-x*5", CODED, [*sines(32), *gray(5)[::-1]], "code_order", {"fine_first": True}),
        ("sine-x*4 gray-x*5", CODED, [*sines(32, (0.0, 180.0, 90.0, 270.0)), *gray(5)], "steps", {}),
        ("sine-x*4 sine-x2*4 sine-x3*4", SEVERAL, of_periods(49, 48, 42), "period_px", {"periods_px": SEVERAL.periods_px[::-1]}),
        ("sine-x*4 sine-x2*4", AxisConvention("x", SIZE_PX, (64.0, SIZE_PX / 15), (FOUR,) * 2), [*sines(16, FOUR[::-1]), *sines(15, FOUR[::-1])],
         "start_deg", {"start_deg": 90.0}),
    ],
)  # fmt: skip
def test_a_wrong_word_is_named_with_what_fits(
    order: str, axis: AxisConvention, lines: Lines, about: str, instead: dict[str, Any]
) -> None:
    (wrong,) = (one for one in told(order, axis, lines) if one.outcome is Outcome.WRONG)
    assert wrong.subject == f"x.{about}"
    assert {name: wrong.corrections[name] for name in instead} == instead
    if about == "steps":
        assert "x.steps_deg = [0, 180, 90, 270] leaves" in wrong.text


def test_a_plain_binary_code_is_as_good_inverted_which_stays_unchecked() -> None:
    said = told(
        "gray-x*7", AxisConvention("x", SIZE_PX, (), (), bits=7, stripe_px=8.0, plain_binary=True), gray(7, True)
    )
    assert words(said, Outcome.UNCHECKED) == ["code_inverted"]
    assert words(said, Outcome.FITS) == ["code_order", "code"]


def test_three_steps_fit_anything_and_a_single_fringe_contradicts_nothing() -> None:
    steps = ((0.0, 120.0, 240.0),)
    said = told("sine-x*3", AxisConvention("x", SIZE_PX, (SIZE_PX,), steps), sines(1, steps[0]))
    assert words(said, Outcome.UNCHECKED) == ["steps", "period_px"]
    assert len(said) == 2


@pytest.mark.parametrize("first", [True, False])
def test_an_image_of_the_code_among_the_steps_is_noticed(first: bool) -> None:
    steps = tuple(360.0 * k / 13 for k in range(13))
    right, other = sines(32, [30.0 * k for k in range(12)]), gray(6)
    lines = [other[0], *right, *other[1:]] if first else [*right, *other]
    said = told("sine-x*13 gray-x*5", replace(CODED, steps_deg=(steps,)), lines)
    (wrong,) = (one for one in said if one.subject == "images.order")
    assert wrong.outcome is Outcome.WRONG
    assert f"without the {'first' if first else 'last'} of its images, steps = 12 leaves" in wrong.text


def test_a_bent_response_makes_a_line_and_steps_still_fit() -> None:
    said = told("sine-x*4 gray-x*5", CODED, [*sines(32, gamma=2.2), *gray(5)])
    assert "steps" in words(said, Outcome.FITS)
    assert words(said, Outcome.UNCHECKED) == ["response of x"]
    assert words(told("sine-x*4 gray-x*5", CODED, [*sines(32, gamma=1.2), *gray(5)]), Outcome.UNCHECKED) == []


@pytest.mark.parametrize(
    ("size_px", "wanted"), [(1024.0, []), (800.0, ["projector.width_px"]), (400.0, ["projector.width_px"])]
)
def test_a_pattern_that_goes_on_beyond_its_size_is_noticed(size_px: float, wanted: list[str]) -> None:
    steps = ((0.0, 120.0, 240.0),) * 2
    axis = AxisConvention("x", size_px, (32.0, 33.0), steps)
    said = told("sine-x*3 sine-x2*3", axis, [*sines(SIZE_PX / 32.0, steps[0]), *sines(SIZE_PX / 33.0, steps[0])])
    assert words(said, Outcome.WRONG) == wanted


def two_periods(shown: tuple[float, float], said: tuple[float, float], gamma: float, noise: float = 2.0) -> Outcome:
    three = (0.0, 120.0, 240.0)
    axis = AxisConvention("x", SIZE_PX, tuple(SIZE_PX / one for one in said), (three, three))
    lines = [*sines(shown[0], three, gamma=gamma), *sines(shown[1], three, gamma=gamma)]
    (found,) = (one for one in told("sine-x*3 sine-x2*3", axis, lines, noise) if one.subject == "x.period_px")
    return found.outcome


@pytest.mark.parametrize(("gamma", "noise"), [(1.0, 2.0), (3.0, 2.0), (2.2, 16.0)])
def test_two_periods_of_a_bent_response_or_in_noise_are_not_wrong(gamma: float, noise: float) -> None:
    assert two_periods((16, 1), (16, 1), gamma, noise) is not Outcome.WRONG


@pytest.mark.parametrize("said", [(16, 2), (1, 16)])
def test_two_other_periods_than_shown_are_wrong(said: tuple[float, float]) -> None:
    assert two_periods((16, 1), said, 1.0) is Outcome.WRONG
