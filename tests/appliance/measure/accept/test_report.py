"""What an evaluation says: the largest errors with their units, and pictures that show where a surface deviates."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.accept.acceptance import Quantity, Symbol
from appliance.measure.accept.points import FitPoints, NotFound
from appliance.measure.accept.report import Evaluation, Item, deviation_map, summary
from appliance.measure.accept.result import Artefact, Length, Result


def used(residual_mm: NDArray[np.float64], pixel: NDArray[np.int64]) -> FitPoints:
    n = len(residual_mm)
    return FitPoints(np.arange(n), pixel.astype(np.uint32), residual_mm, np.arange(0))


def picture(png: bytes) -> NDArray[np.uint8]:
    """Red, green and blue (h, w, 3)."""
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return np.asarray(image[:, :, ::-1], np.uint8)


def test_the_map_shows_red_behind_blue_before_and_dark_where_there_is_nothing() -> None:
    """Every residual is a third of what gets full colour, or as far before."""
    width_px = 50
    v, u = (one.ravel() for one in np.mgrid[10:14, 20:26])
    sign = np.where(u < 23, 1.0, -1.0)
    here = ~((u == 22) & (v == 12))
    image = picture(deviation_map(used(0.05 * sign[here], (v * width_px + u)[here]), width_px, 0.15))
    assert image.shape == (4, 6, 3)
    assert (image[2, 2] == 32).all()
    behind, before = image[0, 0].astype(int), image[0, 5].astype(int)
    # A third of the way to full colour: two thirds of that from white to pale red, and to pale blue.
    assert behind.tolist() == pytest.approx([245, 192, 169], abs=1)
    assert before.tolist() == pytest.approx([180, 214, 230], abs=1)


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
    text = evaluation(bar(200.1)).as_html()
    assert text.endswith("</html>\n")
    assert "Scan &lt;0&gt;: ball-bar" in text
    assert "Not evaluated: why." in text
    assert "Ada &amp; Co" in text
    assert "d_r = 250 mm" in text
    assert "At most 0.3 %" in text
