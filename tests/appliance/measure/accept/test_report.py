"""What an evaluation says: the largest errors with their units, and pictures that show where a surface deviates."""

from __future__ import annotations

import base64
import html

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.accept import page
from appliance.measure.accept.acceptance import Quantity, Symbol
from appliance.measure.accept.pictures import BARS, HISTOGRAM_PX, deviation_map, histogram, scale_mm
from appliance.measure.accept.points import NotFound, Used
from appliance.measure.accept.report import Evaluation, Item, as_html, summary
from appliance.measure.accept.result import Artefact, Length, Result


def used(residual_mm: NDArray[np.float64], pixel: NDArray[np.int64]) -> Used:
    n = len(residual_mm)
    return Used(np.arange(n), pixel.astype(np.uint32), residual_mm, np.arange(0))


def picture(png: bytes) -> NDArray[np.uint8]:
    """Red, green and blue (h, w, 3)."""
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return np.asarray(image[:, :, ::-1], np.uint8)


def test_the_map_shows_red_behind_blue_before_and_dark_where_there_is_nothing() -> None:
    """Full colour is three times the rms: here every residual is 1 or -1, a third of it."""
    width_px = 50
    v, u = (one.ravel() for one in np.mgrid[10:14, 20:26])
    sign = np.where(u < 23, 1.0, -1.0)
    here = ~((u == 22) & (v == 12))
    image = picture(deviation_map(used(0.05 * sign[here], (v * width_px + u)[here]), width_px))
    assert image.shape == (4, 6, 3)
    assert (image[2, 2] == 32).all()
    behind, before = image[0, 0].astype(int), image[0, 5].astype(int)
    # A third of the way from (247, 247, 247) to (178, 24, 43) and to (33, 102, 172).
    assert behind.tolist() == pytest.approx([224, 172, 179], abs=1)
    assert before.tolist() == pytest.approx([175, 198, 222], abs=1)
    assert scale_mm(used(0.05 * sign, u)) == pytest.approx(0.15)


def test_the_histogram_is_as_high_as_the_commonest_residual_and_marks_the_middle() -> None:
    rng = np.random.default_rng(1)
    image = picture(histogram(used(rng.normal(0.0, 0.1, 20000), np.arange(20000))))
    assert image.shape == (*HISTOGRAM_PX, 3)
    bars = (image[:, 3::8, 1] == 90).sum(axis=0)
    assert len(bars) == BARS
    assert bars.max() == HISTOGRAM_PX[0] - 4
    assert abs(int(bars.argmax()) - BARS // 2) <= 3
    # Bars are 0.6 / 61 mm wide; one standard deviation off the middle, a normal curve has e^-0.5 of its height.
    assert bars[[20, 40]] / bars[27:34].mean() == pytest.approx([np.exp(-0.5)] * 2, abs=0.08)
    assert image[0, HISTOGRAM_PX[1] // 2].tolist() == [178, 24, 43]
    assert image[0, 3].tolist() == [255, 255, 255]


def length(measured_mm: float) -> Length:
    return Length("length", measured_mm, 200.0, 0.01, 0.002)


def quantity(symbol: Symbol, value_mm: float) -> Quantity:
    return Quantity(symbol, "ball", value_mm, 0.01, 100, 1)


def evaluation(*results: Result) -> Evaluation:
    return Evaluation({"who": "Ada & Co"}, 250.0, 1600, [Item(f"<{k}>", one, {}) for k, one in enumerate(results)])


def bar(*measured_mm: float, noise_mm: float | None = None, quantities: tuple[Quantity, ...] = ()) -> Result:
    # Nothing was found, so that no surface is drawn; what is summed up are the numbers beside it.
    return Result(
        Artefact.BALL_BAR, NotFound("why"), tuple(map(length, measured_mm)), noise_mm=noise_mm, quantities=quantities
    )


def test_the_summary_has_the_largest_error_of_each_kind_in_percent_and_the_mean_noise() -> None:
    frustum = Result(Artefact.FRUSTUM, NotFound("why"), (length(199.0),))
    plane = Result(Artefact.PLANE, NotFound("why"), e_f=0.0004, e_f_sys=0.0001, noise_mm=0.02)
    other = Result(Artefact.PLANE, NotFound("why"), e_f=0.0003, e_f_sys=0.0002, noise_mm=0.05)
    deviations = (quantity(Symbol.PS, 0.01), quantity(Symbol.PS, -0.03), quantity(Symbol.PF, 0.02))
    said = dict(summary(evaluation(bar(200.1, 199.8, noise_mm=0.02, quantities=deviations), frustum, plane, other)))
    assert (said.pop("ps_mm"), said.pop("sd_mm"), said.pop("f_mm")) == (-0.03, None, None), "the largest, with its sign"
    assert said == pytest.approx({
        "e_l_ball_bar_percent": 0.1, "e_l_frustum_percent": 0.5, "e_f_percent": 0.04, "e_f_sys_percent": 0.02, "noise_mm": 0.03, "pf_mm": 0.02,
    })  # fmt: skip
    assert set(summary(evaluation(bar())).values()) == {None}


def test_the_page_says_what_was_not_evaluated_and_escapes_what_people_wrote() -> None:
    text = as_html(evaluation(bar(200.1)))
    assert text.endswith("</html>\n")
    assert "Scan &lt;0&gt;: ball-bar" in text
    assert "Not evaluated: why." in text
    assert "Ada &amp; Co" in text
    assert "d_r = 250 mm" in text
    assert "At most 0.3 %" in text


def test_a_picture_lies_within_the_page_byte_for_byte_under_what_it_shows() -> None:
    png = bytes(range(256))
    shown = page.figure("d_r < 250 mm & more", png)
    assert shown.startswith('<figure><img alt="d_r &lt; 250 mm &amp; more" src="data:image/png;base64,')
    assert shown.endswith('"><figcaption>d_r &lt; 250 mm &amp; more</figcaption></figure>')
    assert base64.b64decode(shown.partition("base64,")[2].partition('"')[0]) == png
    head = page.page_head("Ada & Co")
    assert head.startswith('<!doctype html><html lang="en"><meta charset="utf-8"><title>Ada &amp; Co</title><style>')
    assert head.endswith("<h1>Ada &amp; Co</h1>")


def test_cells_have_as_many_digits_as_are_worth_reading() -> None:
    cells = {"a<": 0.123456, "b": 12.3456789, "c": None, "d": -9.87654, "e": {"x&": 1.5, "y": None}, "f": {}, "g": 7, "k": 10.0}  # fmt: skip
    shown = ("0.1235", "12.3457", "–", "-9.877", "x&amp; 1.5; y –", "–", "7", "10.0000")
    rows = (f"<tr><th>{html.escape(name)}</th><td>{cell}</td></tr>" for name, cell in zip(cells, shown, strict=True))
    assert page.table(cells) == f"<table>{''.join(rows)}</table>"
    assert page.rows([{"n": 1, "m": 2.5}, {"n": 3, "m": None}]) == (
        "<table><tr><th>n</th><th>m</th></tr><tr><td>1</td><td>2.5</td></tr><tr><td>3</td><td>–</td></tr></table>"
    )
    assert page.drawing("a<b", "<svg/>") == "<figure><svg/><figcaption>a&lt;b</figcaption></figure>"
