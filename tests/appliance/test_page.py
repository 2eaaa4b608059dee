"""What every page and every drawing does: escapes what people wrote, keeps its pictures in itself, draws to scale."""

from __future__ import annotations

import base64
import html
import re

import cv2
import numpy as np
import pytest

from appliance.base import ColourScale, Html, Page, bars, draw_curves, histogram
from appliance.base.plot import BARS, HEIGHT_PX, WIDTH_PX


def made(page: Page) -> str:
    """What follows the head."""
    return page.as_html().partition("</header>")[2].partition("</main>")[0]


def test_a_page_is_whole_and_escapes_what_people_wrote() -> None:
    page = Page("Ada & Co", "two <scans>", {"who": "Ada & Co", "none": None})
    page.heading("a < b", "a&b")
    page.note("c & d")
    page.problem("e > f")
    page.tiles([("x<", "1 & 2", "y>")])
    text = page.as_html()
    assert text.startswith('<!doctype html>\n<html lang="en"><head><meta charset="utf-8">')
    assert text.endswith("</html>\n")
    assert "<title>Ada &amp; Co</title>" in text
    assert "<h1>Ada &amp; Co</h1><p>two &lt;scans&gt;</p><dl><div><dt>who</dt><dd>Ada &amp; Co</dd></div>" in text
    assert "<dt>none</dt><dd>–</dd>" in text
    assert made(page) == (
        '<h2 id="a&amp;b">a &lt; b</h2><p class="note">c &amp; d</p><p class="no">e &gt; f</p><section class="tiles"><div class="tile">'
        "<span>x&lt;</span><b>1 &amp; 2</b><small>y&gt;</small></div></section>"
    )
    assert re.findall(r"(default-src|script-src)[^;\"]*", text) == ["default-src"], "no script runs in a plain page"


def test_a_picture_lies_within_the_page_byte_for_byte_under_what_it_shows() -> None:
    page, png = Page("t"), bytes(range(256))
    page.figure("d_r < 250 mm & more", png)
    page.figure("a<b", "<svg/>")
    shown, drawn = re.findall(r"<figure.*?</figure>", made(page))
    assert shown.startswith('<figure class="shown"><img alt="d_r &lt; 250 mm &amp; more" src="data:image/png;base64,')
    assert shown.endswith('"><figcaption>d_r &lt; 250 mm &amp; more</figcaption></figure>')
    assert base64.b64decode(shown.partition("base64,")[2].partition('"')[0]) == png
    assert drawn == '<figure class="shown"><svg/><figcaption>a&lt;b</figcaption></figure>'


def test_cells_have_as_many_digits_as_are_worth_reading() -> None:
    cells = {"a<": 0.123456, "b": 12.3456789, "c": None, "d": -9.87654, "e": {"x&": 1.5, "y": None}, "f": {}, "g": 7, "k": 10.0}  # fmt: skip
    shown = ("0.1235", "12.3457", "–", "-9.877", "x&amp; 1.5; y –", "–", "7", "10.0000")
    page = Page("t")
    page.facts(cells)
    rows = (f"<tr><th>{html.escape(name)}</th><td>{cell}</td></tr>" for name, cell in zip(cells, shown, strict=True))
    assert made(page) == f'<div class="wide"><table>{"".join(rows)}</table></div>'
    page = Page("t")
    page.rows([{"n<": 1, "m": 2.5}, {"n<": Html("<i>3</i>"), "m": "WRONG"}], {"WRONG": "no"})
    page.table(["k"], [["<b>4</b>"]], "kind")
    assert made(page) == (
        '<div class="wide"><table class=""><thead><tr><th>n&lt;</th><th>m</th></tr></thead><tbody><tr><td>1</td><td>2.5</td></tr>'
        '<tr><td><i>3</i></td><td class="no">WRONG</td></tr></tbody></table></div>'
        '<div class="wide"><table class="kind"><thead><tr><th>k</th></tr></thead><tbody><tr><td><b>4</b></td></tr></tbody></table></div>'
    )


def test_the_histogram_is_as_high_as_the_commonest_value_and_marks_what_it_is_told() -> None:
    rng = np.random.default_rng(1)
    values = np.append(rng.normal(0.0, 100.0, 20000), [np.nan, *[5000.0] * 300])
    svg = histogram(values, -300.0, 300.0, "deviation in µm", (-150.0, 150.0), 30.0)
    tall = np.array([float(one) for one in re.findall(r'height="([\d.]+)" fill="#', svg)])
    assert len(tall) == BARS
    assert tall.max() == 184.0
    assert abs(int(tall.argmax()) - BARS // 2) <= 3
    assert tall[-1] > 5.0 * tall[-2], "what lies farther out is in the last one"
    # Bars are 600 / 61 µm wide; one standard deviation off the middle, a normal curve has e^-0.5 of its height.
    assert tall[[20, 40]] / tall[27:34].mean() == pytest.approx([np.exp(-0.5)] * 2, abs=0.08)
    assert re.findall(r'<line x1="([\d.]+)" x2="[\d.]+" y1="8"', svg) == ["170.0", "470.0"]
    assert 'd="M350.0 200' in svg
    assert re.findall(r'text-anchor="middle">([^<]+)<', svg) == ["−300", "−150", "0", "150", "300", "deviation in µm"]
    middle = int(re.findall(r'fill="#(\w{2})\w{4}"', svg)[30], 16)
    assert middle == 0xF7, "white in the middle"


def test_a_bar_is_as_long_as_its_share_and_red_where_it_is_marked() -> None:
    svg = bars({"tilt": 0.75, "a & b": 0.0}, {"a & b"})
    assert re.findall(r'<rect x="260" y="(\d+)" width="([\d.]+)" height="12" fill="(#\w+)"/>', svg) == [
        ("6", "200.0", "#ddd"), ("6", "150.0", "#2166ac"), ("23", "200.0", "#ddd"), ("23", "0.0", "#b2182b"),
    ]  # fmt: skip
    assert re.findall(r'y="(\d+)">([^<]+)<', svg) == [("16", "tilt"), ("33", "a &amp; b")]


def test_colours_lie_between_those_of_the_scale_and_nothing_is_light_grey() -> None:
    found = ColourScale.GREYS.of(np.array([-5.0, 0.0, 0.25, 1.0, np.nan]), 0.0, 1.0)
    assert found.tolist() == [[20] * 3, [20] * 3, [77.5] * 3, [250] * 3, [200] * 3]
    assert ColourScale.DIVERGING.stops[::2] == [(0.0, "#2166ac"), (0.5, "#f7f7f7"), (1.0, "#b2182b")]


def test_a_curve_goes_from_corner_to_corner_of_its_axes_and_a_mark_is_red() -> None:
    line = np.array([0.0, 10.0])
    image = cv2.imdecode(
        np.frombuffer(draw_curves({"rise": (line, line)}, "x", "y", [5.0]), np.uint8), cv2.IMREAD_COLOR
    )
    assert image is not None
    assert image.shape == (HEIGHT_PX, WIDTH_PX, 3)
    # OpenCV has blue first: the curve's colour at both corners and halfway, the mark's above and below it.
    for u, v in ((70, 296), (880, 30), (475, 163)):
        assert (np.abs(image[v - 1 : v + 2, u - 1 : u + 2].astype(int) - (158, 105, 17)).sum(-1) < 30).any(), (u, v)
    assert image[60, 475].tolist() == image[250, 475].tolist() == [30, 38, 179]


@pytest.mark.parametrize(("way", "left"), [(1.0, True), (-1.0, False)])
def test_the_names_of_curves_stand_where_these_are_low(way: float, left: bool) -> None:
    line = np.array([0.0, 10.0])
    image = cv2.imdecode(
        np.frombuffer(draw_curves({"curve": (line, way * line)}, "x", "y"), np.uint8), cv2.IMREAD_COLOR
    )
    assert image is not None
    coloured = (np.abs(image.astype(int) - (158, 105, 17)).sum(-1) < 60)[30:60]
    # The curve itself begins in the one corner or ends in the other.
    assert bool(coloured[:, 690:730].any()) is not left
    assert bool(coloured[:, 78:120].any())
