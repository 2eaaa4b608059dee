"""The page about a season: its dots are where the numbers are, nothing of a table becomes a part of the page, and refused scans are all there."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.desk.anew.results import COLUMNS
from appliance.desk.anew.season import season_page
from tests.support.browser import browse, browser
from tests.support.commands import Shell

FIRST, SECOND = "#11698e", "#b25c00"
"""Colours of the largest group and of the next one."""
UNKNOWN = {"points": "", "gap_mm": "", "noise_mm": "", "temperature_c": ""}
"""Of a scan that failed."""


def cells(number: int, **more: object) -> dict[str, str]:
    """A row as a table has it: scan ``number`` of the season, one a day."""
    given = {
        "scan": f"{number:06d}", "state": "done", "recorded": f"2031-05-{number:02d}T09:12:00+00:00", "points": 70_000 + number,
        "noise_mm": 0.026, "gap_mm": 0.007, "spoilt": False, "temperature_c": 15.0, "salinity_psu": 35.0, "calibration": "a" * 64,
        "folder": f"/disk/scans/{number:06d}", **more,
    }  # fmt: skip
    return {name: str(given.get(name, "")) for name in COLUMNS}


def page_of(*rows: dict[str, str]) -> str:
    return season_page(list(rows), "/a/table.csv")


def lengths(*errors_mm: float) -> str:
    return page_of(*(cells(k, length_error_mm=error, artefact="frustum") for k, error in enumerate(errors_mm, 1)))


def words_of(page: str) -> str:
    return " ".join(re.sub(r"<[^>]*>", " ", page.partition("<body>")[2]).split())


def chart(page: str, what: str) -> str:
    """The drawing with that label."""
    found = re.search(rf'<svg[^>]*aria-label="{re.escape(what)}">(.*?)</svg>', page, re.DOTALL)
    assert found is not None, what
    return found[1]


def caption(page: str, what: str) -> str:
    return page.partition(f"{what}; scans")[2].partition("</figcaption>")[0]


def dots(drawing: str) -> list[tuple[float, float, str, str]]:
    """Place, colour and words of each dot."""
    found = re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)" r="3" fill="(#\w+)"[^>]*><title>(.*?)</title>', drawing)
    return [(float(x), float(y), colour, words) for x, y, colour, words in found]


def scale(drawing: str) -> tuple[float, float]:
    """Value at the drawing's top edge, and per unit downwards, by the numbers beside its lines."""
    found = re.findall(r'x="54" y="([\d.]+)" text-anchor="end">([−\d.e+]+)</text>', drawing)
    labels = [(float(y) - 4.0, float(text.replace("−", "-"))) for y, text in found]
    (y0, v0), (y1, v1) = labels[0], labels[-1]
    each = (v1 - v0) / (y1 - y0)
    for y, value in labels:
        assert v0 + (y - y0) * each == pytest.approx(value, abs=abs(each)), "the numbers are in proportion"
    return v0 - y0 * each, each


@pytest.mark.parametrize(
    "errors_mm",
    [(0.002, 0.004, -0.003, -0.2039, -0.2021, 0.001), (0.0131,), (-0.5, -0.5, -0.5), (0.0, 0.0), (1234.5, -0.001), (1e-7, 3e-7, 2e-7)],
)  # fmt: skip
def test_each_dot_is_where_its_number_is(errors_mm: tuple[float, ...]) -> None:
    drawing = chart(lengths(*errors_mm), "length error, µm")
    top, each = scale(drawing)
    for k, ((x, y, _, words), error) in enumerate(zip(dots(drawing), errors_mm, strict=True)):
        assert top + y * each == pytest.approx(1000.0 * error, abs=abs(each)), "within a pixel"
        assert x == pytest.approx(62 + (k + 0.5) * (1060 - 62 - 40) / len(errors_mm), abs=0.1)
        assert words.startswith(f"{k + 1:06d}  2031-05-{k + 1:02d} 09:12")
        assert 14 <= y <= 190, "within the frame"


@pytest.mark.parametrize("pair", [(-1e12, 1e12), (5e-324, 1e-323), (445387194.6094142, 445387194.6094143)])
def test_numbers_of_any_size_have_an_axis_with_round_numbers(pair: tuple[float, float]) -> None:
    page = lengths(*pair)
    assert all(14.0 <= y <= 190.0 for _, y, _, _ in dots(chart(page, "length error, µm")))
    assert 2 <= chart(page, "length error, µm").count('text-anchor="end"') <= 16


@pytest.mark.parametrize(("count", "step"), [(1, 1), (10, 1), (19, 2)])
def test_of_few_scans_none_lacks_its_number(count: int, step: int) -> None:
    drawing = chart(page_of(*map(cells, range(1, count + 1))), "ray gap, µm")
    assert [int(text) for text in re.findall(r">(\d{6})</text>", drawing)] == list(range(1, count + 1, step))


def test_of_a_large_archive_what_stands_out_is_drawn() -> None:
    rows = [cells(1, gap_mm=0.007 + 0.0001 * (k % 7)) | {"scan": f"{k:06d}"} for k in range(1, 5_001)]
    rows[2_345] |= {"gap_mm": "0.09"}
    page = page_of(*rows)
    drawing = chart(page, "ray gap, µm")
    top, each = scale(drawing)
    values = [top + y * each for _, y, _, _ in dots(drawing)]
    assert len(values) <= 1000
    assert (max(values), min(values)) == pytest.approx((90.0, 7.0), abs=abs(each))
    assert len(page) < 1_000_000


def test_what_is_not_known_is_left_out_and_not_drawn_as_nothing() -> None:
    unknown = [
        cells(1, gap_mm=""),
        cells(2, gap_mm="nan"),
        cells(5, gap_mm="inf"),
        cells(6, verdicts="compensation=yes"),
    ]
    page = page_of(*unknown, cells(3, verdicts="compensation=no"), cells(4, gap_mm=0.007))
    assert [words[:6] for *_, words in dots(chart(page, "ray gap, µm"))] == ["000003", "000004"]
    assert season_page([], "t.csv").count("No values in the table.") == 4
    failed = page_of(cells(1, state="failed", reason="x: missing", **UNKNOWN))
    assert (failed.count("No values in the table."), "x: missing" in failed, "0 of 1" in failed) == (4, True, True)


def test_groups_have_their_colours_and_the_rare_ones_share_one() -> None:
    page = page_of(*(cells(k, calibration=("a" if k < 7 else "b") * 64) for k in range(1, 11)))
    assert [colour for *_, colour, _ in dots(chart(page, "ray gap, µm"))] == [FIRST] * 6 + [SECOND] * 4
    said = caption(page, "ray gap, µm")
    assert (said.count("aaaaaaaaaaaa"), said.count("bbbbbbbbbbbb")) == (1, 1)
    for groups, more in ((6, "thing 5"), (7, " and 1 more")):
        page = page_of(*(cells(k + 1, length_error_mm=0.1, artefact=f"thing {k}") for k in range(groups)))
        assert len({colour for *_, colour, _ in dots(chart(page, "length error, µm"))}) == 6
        assert caption(page, "length error, µm").endswith(more)
    page = page_of(cells(1, grade="good"), cells(2, spoilt=True, salinity_psu=0.0), cells(3), cells(4, salinity_psu=""))
    assert all(word in caption(page, "noise, µm") for word in ("good", "spoilt", "not graded"))
    assert all(word in caption(page, "water, °C") for word in ("35 psu", "0 psu", "not known"))


def test_the_head_and_the_tiles_are_counts_and_medians_of_the_rows() -> None:
    page = page_of(
        cells(1, points=1_000_000, noise_mm=0.020, grade="good", e_l_percent=-0.25, recorded=""),
        cells(2, points=2_000_000, noise_mm=0.030, grade="good", e_l_percent=0.125, calibration="b" * 64),
        cells(3, points=1_500_000, noise_mm=0.060, grade="poor", spoilt=True, faults="MOTION: 3 mm", calibration="c" * 64),
        cells(4, state="failed", reason="dark", points="", noise_mm="", calibration="d" * 64),
    )  # fmt: skip
    words = words_of(page)
    for said in (
        "4 scans From 2031-05-02 09:12 To 2031-05-04 09:12", f"Calibrations {'a' * 12}, {'b' * 12}, {'c' * 12} and 1 more Table /a/table.csv",
        "Scans with points 2 of 4 2 good, 1 spoilt, 1 without points", "Points 4.5 million 1,500,000 a scan (median)",
        "Noise 30 µm median over scans", "Largest length error 0.250 % 2 scans of artefacts",
    ):  # fmt: skip
        assert said in words
    three = page_of(*(cells(k, calibration="abc"[k - 1] * 64, recorded="") for k in (1, 2, 3)))
    assert f"{'c' * 12}</dd>" in three, "three are named, and no more are there"
    assert three.count("no clock") == 2


def test_every_refused_scan_is_there_with_its_reason_and_marked_where_it_was_taken() -> None:
    rows = [cells(k) for k in range(1, 9)]
    damaged = "frames_left.npy: damaged (its checksum does not fit) in sine-x-180; restore it"
    for k in (2, 5):
        rows[k - 1] = cells(k, state="failed", reason=f"/disk/scans/{k:06d}: {damaged}", **UNKNOWN)
    rows[6] = cells(7, spoilt=True, faults="MOTION: the hands moved by 3 mm; BLURRED: edges of 4 px")
    page = page_of(*rows)
    words = words_of(page)
    for said in (
        "5 of 8 1 spoilt, 2 without points", "frames_left.npy: damaged 2", "MOTION 1", f"000005 2031-05-05 09:12 {damaged}",
        "000007 2031-05-07 09:12 MOTION: the hands moved by 3 mm; BLURRED: edges of 4 px",
    ):  # fmt: skip
        assert said in words
    marks = [float(x) for x in re.findall(r'<path d="M([\d.]+) ', chart(page, "ray gap, µm"))]
    assert marks == [pytest.approx(62 + (k - 0.5) * 958 / 8, abs=0.1) for k in (2, 5, 7)]
    for reason, kind in (("dark (7 of 9); open it", "dark"), ("/disk/scans/000001: dark", "dark"), ("", "not known")):
        page = page_of(cells(1, state="failed", reason=reason))
        assert f"<tbody><tr><td>{kind}</td><td>1</td></tr></tbody>" in page
    assert '<h2>Rejected scans, with reasons</h2><p class="note">None.</p>' in page_of(cells(1))


HOSTILE = """<script>throw new Error("in")</script><img src=x onerror=alert(1)>"'&amp;"""


class Elements(HTMLParser):
    """Names of all elements, and of their attributes that do something."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.names: set[str] = set()
        self.doing: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.names.add(tag)
        self.doing += [name for name, _ in attrs if name.startswith("on") or name in ("src", "href")]


def test_nothing_of_a_table_becomes_an_element_of_the_page() -> None:
    """Every column has it, in a scan with points, in one that is spoilt and in one that failed."""
    rows = [
        cells(1, artefact=HOSTILE, length_error_mm=0.1, calibration=HOSTILE, recorded=HOSTILE, salinity_psu=HOSTILE),
        cells(2, spoilt=True, faults=f"{HOSTILE}: {HOSTILE}", scan=HOSTILE),
        cells(3, state="failed", reason=HOSTILE, folder=HOSTILE, e_l_percent=HOSTILE, points=HOSTILE), cells(4, state=HOSTILE),
    ]  # fmt: skip
    page = season_page(rows, f"{HOSTILE}/table.csv")
    found = Elements(page)
    assert (found.names & {"script", "img"}, found.doing) == (set(), [])
    assert "throw new Error" in page, "it is shown as text"


def test_a_page_under_another_formats_name_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = Shell(capsys)("report", tmp_path / "table.csv", "--out", tmp_path / "s.pdf")
    assert (said.code, "s.html" in said.error) == (2, True)
    assert not (tmp_path / "s.pdf").exists()


def blobs(picture: Path, colour: str) -> int:
    """Number of dots of that colour: round places of 15 to 60 pixels."""
    image = cv2.imread(str(picture))
    assert image is not None
    want = np.array([int(colour[k : k + 2], 16) for k in (5, 3, 1)], float)
    paper = 0.75 * want + 0.25 * 255.0  # dots let a quarter of the paper through
    like = (np.abs(image - paper).max(axis=2) < 12).astype(np.uint8)
    _, _, stats, _ = cv2.connectedComponentsWithStats(like)
    return int(np.count_nonzero((stats[1:, cv2.CC_STAT_AREA] >= 15) & (stats[1:, cv2.CC_STAT_AREA] <= 60)))


@pytest.mark.foreign
@browser
def test_a_browser_shows_every_dot_asks_for_nothing_and_cuts_no_chart_on_paper(tmp_path: Path) -> None:
    rows = [
        cells(k, calibration=("a" if k < 14 else "b") * 64, gap_mm=0.007 + 0.001 * (k % 5), artefact="frustum", length_error_mm=0.002 * (k % 3))
        for k in range(1, 23)
    ]  # fmt: skip
    page, seen, paper = (tmp_path / name for name in ("season.html", "seen.png", "paper.pdf"))
    page.write_text(page_of(*rows), encoding="utf-8")
    assert browse(page, tmp_path, f"--screenshot={seen}", "--window-size=1200,2400") == ("", [])
    assert blobs(seen, FIRST) == 3 * 22 + 13, "four charts, one of them in two colours"
    assert blobs(seen, SECOND) == 9
    browse(page, tmp_path, "--no-pdf-header-footer", f"--print-to-pdf={paper}")
    assert len(re.findall(rb"/Type /Page\b", paper.read_bytes())) in (2, 3)
