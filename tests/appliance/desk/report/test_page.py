"""The page for a client: it says everything it was given, asks for nothing from outside, and a browser shows the surface."""

from __future__ import annotations

import base64
import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.desk.report import content as told
from appliance.desk.report.content import Report, ReportScan, ReportVerdict
from appliance.desk.report.drawn_surface import surface_to_draw, thin_out
from appliance.desk.report.page import page, write_report
from appliance.desk.surface.deviation import deviations
from appliance.desk.surface.fusion import FusedCloud, PlacedScan, fuse
from appliance.desk.surface.mesh import mesh_of_scan
from appliance.desk.surface.nominal import nominal_of
from tests.support.browser import CHROMIUM, browse, browser
from tests.support.solids import Ball, Box, looking, seen

BALL = Ball((0.0, 0.0, 0.0), 15.0)
RED = (178, 24, 43)
"""The colour of the largest deviation."""
CUBE = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])  # fmt: skip
"""Faces of a cube by the numbers of its corners."""


@pytest.fixture(scope="module")
def surface() -> FusedCloud:
    eyes = [looking((x, 0.0, -400.0)) for x in (-60.0, 60.0)]
    balls = [seen([BALL], eye, k, noise_mm=0.01) for k, eye in enumerate(eyes)]
    return fuse([PlacedScan(ball, eye.rotation, eye.translation_mm) for ball, eye in zip(balls, eyes, strict=True)])


@pytest.fixture(scope="module")
def report(surface: FusedCloud) -> Report:
    """A ball that is compared with a smaller one, so that all of it deviates by more than the tolerance shows."""
    side = 14.0 / np.sqrt(3.0)
    corners = np.array([[x, y, z] for x in (-side, side) for y in (-side, side) for z in (-side, side)])
    deviation = deviations(surface.points_mm, surface.sigma_mm, nominal_of(corners, CUBE), limit_mm=20.0)
    return Report(
        title="Flange <3> & pipe",
        subtitle="two scans",
        about={"Instrument": "KF-0007", "Water": "11.2 °C"},
        scans=[
            ReportScan("000001", ReportVerdict.GOOD, "", "2026-11-21", 1_034_211, 480.0, 0.0221, 0.0083, (1.0, -2.0, 3.0), (0.1, 0.2, 0.3), 0.018),
            ReportScan("000002", ReportVerdict.REFUSED, "slides <along> the pipe", warnings=("too dark",)),
        ],
        pairs=[told.ReportPair("000001", "000002", ReportVerdict.REFUSED, "one direction is free", 43.0, 120, 0.0243, 1.25, 0.0041)],
        budget=told.ReportBudget(600.0, [told.ReportTerm("Poses", 0.021, "pose graph"), told.ReportTerm("Bending", 0.4, "calibration")], 0.4005),
        surface=surface,
        nominal=told.ReportNominal("box.stl", deviation, 0.05),
        warnings=["scan 000002 takes no part"],
    )  # fmt: skip


@pytest.fixture(scope="module")
def written(report: Report) -> str:
    return page(report)


def plain(text: str) -> str:
    """The page's words, without its elements and scripts."""
    body = re.sub(r"<(script|style)\b.*?</\1>", " ", text.partition("<body>")[2], flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]*>", " ", body).replace("\u202f", " ").split())


def test_everything_that_was_handed_in_is_said_with_its_unit(report: Report, written: str) -> None:
    said = plain(written)
    for words in (
        "Flange &lt;3&gt; &amp; pipe", "two scans", "KF-0007", "11.2 °C", "scan 000002 takes no part", "1 of 2",
        "✓ good", "✕ refused", "slides &lt;along&gt; the pipe too dark", "1 034 211", "480 mm", "22.1 µm", "8.3 µm", "1.00 −2.00 3.00",
        "0.100 0.200 0.300", "± 18.0 µm", "2026-11-21", "000001 – 000002", "43 %", "120", "24.3 µm", "± 1.250 mm", "± 0.0041°",
        "Uncertainty over 600 mm", "pose graph", "21.0 µm", "400 µm", "± 801 µm", "Deviation from box.stl", "Out of ± 50.0 µm 100.00 %",
    ):  # fmt: skip
        assert words in said, words
    assert report.nominal is not None
    values = report.nominal.deviation.deviation_mm.astype(float)
    for figure in (f"RMS {np.sqrt(np.mean(values**2)):.3f} mm", f"Mean {values.mean():.3f} mm", "above 0 (0.00 %)"):
        assert figure in said


def test_what_is_not_known_is_a_dash_and_what_is_absent_has_no_heading(surface: FusedCloud) -> None:
    said = plain(page(Report("One", scans=[ReportScan("7", ReportVerdict.DOUBTFUL)], surface=surface)))
    assert "7 ! doubtful – – – – – – –" in said
    for heading in ("Scan pairs", "Uncertainty over", "Deviation from", "Warnings"):
        assert heading not in said.partition("How to read this")[0]


def test_nothing_is_fetched_and_the_scripts_get_the_points_as_they_are(report: Report, written: str) -> None:
    assert "default-src 'none'" in written
    own = re.sub(r"<script>.*?</script>", "", written, flags=re.DOTALL)
    assert not re.search(r"""(?:src|href)=["'](?!data:)|url\(http|<link""", own)
    found = re.search(r'id="surface-data">(.*?)</script>', written)
    assert found is not None
    content, full = json.loads(found[1]), surface_to_draw(report)
    assert full is not None
    x = np.frombuffer(base64.b64decode(content["trace"]["x"]["bdata"]), "<f4")
    np.testing.assert_array_equal(x, thin_out(full).points_mm[:, 0])
    assert content["colourings"][0]["scale"][-1] == [1.0, "#" + "".join(f"{part:02x}" for part in RED)]


def test_a_comparison_of_other_points_is_refused(report: Report, surface: FusedCloud) -> None:
    fewer = replace(surface, points_mm=surface.points_mm[1:], grey=surface.grey[1:])
    with pytest.raises(ValueError, match="one deviation for each point"):
        replace(report, surface=fewer)


def test_few_points_are_drawn_and_they_are_all_over_the_surface(report: Report) -> None:
    full = surface_to_draw(report)
    assert full is not None
    few = thin_out(full, 2000)
    assert 1000 <= len(few.points_mm) <= 2000
    for corner in (full.points_mm.min(axis=0), full.points_mm.max(axis=0)):
        assert np.abs(few.points_mm - corner).min(axis=0).max() < 1.5
    assert [one.name for one in few.colourings] == ["Deviation", "Picture", "Sigma", "Scans"]
    # Each point keeps its own values.
    at = np.flatnonzero((full.points_mm == few.points_mm[77]).all(axis=1))
    assert few.colourings[2].values[77] == full.colourings[2].values[at[0]]


def test_a_thinned_mesh_is_still_the_surface() -> None:
    mesh = mesh_of_scan(seen([BALL], looking((0.0, 0.0, -400.0)), 1, noise_mm=0.0))
    full = surface_to_draw(Report("mesh", mesh=mesh))
    assert full is not None
    few = thin_out(full, 1500)
    assert few.faces is not None
    assert full.faces is not None

    def area(points: np.ndarray, faces: np.ndarray) -> float:
        a, b, c = (points[faces[:, k]].astype(float) for k in range(3))
        return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())

    assert len(few.points_mm) <= 1500
    assert area(few.points_mm, few.faces) == pytest.approx(area(full.points_mm, full.faces), rel=0.03)


def red_pixels(picture: Path) -> int:
    image = cv2.imread(str(picture))
    assert image is not None
    blue, green, red = (image[..., k].astype(int) for k in range(3))
    return int(np.count_nonzero((red > 2 * green) & (red > 2 * blue) & (red > 90)))


@pytest.mark.foreign
@browser
@pytest.mark.parametrize("options", [(), ("--disable-3d-apis",)], ids=["turned", "without-webgl"])
def test_a_browser_shows_the_surface_without_errors_and_network(
    options: tuple[str, ...], report: Report, tmp_path: Path
) -> None:
    write_report(tmp_path / "report.html", replace(report, scans=(), pairs=(), budget=None))
    console, asked = browse(tmp_path / "report.html", tmp_path, f"--screenshot={tmp_path / 'seen.png'}", *options)
    assert asked == []
    assert not re.search(r"(?i)error|uncaught|refused", console), console
    # The ball is as red as can be, in the middle of 1100 x 600 pixels; bars and scales are red in some thousand pixels only.
    assert red_pixels(tmp_path / "seen.png") > 30_000
    asks = '<!doctype html><img src="http://elsewhere.invalid/x.png"><script>throw new Error("no")</script>'
    (tmp_path / "asks.html").write_text(asks)
    console, asked = browse(tmp_path / "asks.html", tmp_path, f"--screenshot={tmp_path / 'asks.png'}")
    assert "http://elsewhere.invalid/x.png" in asked, "a page that asks for something is noticed"
    assert "Uncaught Error: no" in console


@pytest.mark.foreign
@browser
def test_what_is_shown_first_is_the_turning_view_and_on_paper_the_picture(report: Report, tmp_path: Path) -> None:
    write_report(tmp_path / "report.html", report)
    words = ["--dump-dom", "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    assert CHROMIUM is not None
    done = subprocess.run(
        [CHROMIUM, *words, "--virtual-time-budget=20000", f"--user-data-dir={tmp_path / 'one'}", (tmp_path / "report.html").as_uri()],
        capture_output=True, text=True, timeout=240, check=True,
    )  # fmt: skip
    assert '<body class="turning">' in done.stdout
    assert re.search(r'id="turned"[^>]*class="js-plotly-plot"', done.stdout)
    browse(tmp_path / "report.html", tmp_path, "--no-pdf-header-footer", f"--print-to-pdf={tmp_path / 'paper.pdf'}")
    paper = (tmp_path / "paper.pdf").read_bytes()
    # The still picture is 1400 pixels wide; a canvas on paper would be as wide as the window.
    assert re.search(rb"/Subtype /Image\s*/Width 1400", paper)
    assert len(re.findall(rb"/Type /Page\b", paper)) in (2, 3)


def test_a_mesh_of_more_points_than_a_browser_turns_has_a_page() -> None:
    wall = Box((-90.0, -90.0, 0.0), (90.0, 90.0, 10.0))
    mesh = mesh_of_scan(seen([wall], looking((0.0, 0.0, -400.0)), 1, size_px=(290, 240)))
    text = page(Report("wall", mesh=mesh))
    words = re.sub(r"(?<=\d) (?=\d)", "", plain(text))
    found = re.search(r"triangles between (\d+) of 69600 points", words)
    assert found is not None
    assert 20_000 < int(found[1]) <= 60_000
