"""The page about a season: its dots are where the numbers are, nothing of a table becomes a part of the page, and refused scans are all there."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.offline.anew.results import COLUMNS
from appliance.offline.anew.season import season_page
from tests.support.browser import browse, browser
from tests.support.commands import Shell

FIRST, SECOND = "#11698e", "#b25c00"
"""Colours of the largest group and of the next one."""


def cells(number: int, **more: object) -> dict[str, str]:
    """A row as a table has it: scan ``number`` of the season, one a day."""
    given = {
        "scan": f"{number:06d}", "state": "done", "recorded": f"2031-05-{number:02d}T09:12:00+00:00", "points": 70_000 + number,
        "noise_mm": 0.026, "gap_mm": 0.007, "spoilt": False, "temperature_c": 15.0, "salinity_psu": 35.0, "calibration": "a" * 64,
        "folder": f"/disk/scans/{number:06d}", **more,
    }  # fmt: skip
    return {name: str(given.get(name, "")) for name in COLUMNS}


def chart(page: str, what: str) -> str:
    """The drawing with that label."""
    found = re.search(rf'<svg[^>]*aria-label="{re.escape(what)}">(.*?)</svg>', page, re.DOTALL)
    assert found is not None, what
    return found[1]


def dots(drawing: str) -> list[tuple[float, float, str, str]]:
    """Place, colour and words of each dot."""
    found = re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)" r="3" fill="(#\w+)"[^>]*><title>(.*?)</title>', drawing)
    return [(float(x), float(y), colour, words) for x, y, colour, words in found]


def scale(drawing: str) -> tuple[float, float]:
    """Value at the drawing's top edge, and per unit downwards, by the numbers beside its lines."""
    labels = re.findall(r'x="54" y="([\d.]+)" text-anchor="end">([−\d.e+]+)</text>', drawing)
    labels = [(float(y) - 4.0, float(text.replace("−", "-"))) for y, text in labels]
    assert len(labels) >= 2, labels
    (y0, v0), (y1, v1) = labels[0], labels[-1]
    each = (v1 - v0) / (y1 - y0)
    for y, value in labels:
        assert v0 + (y - y0) * each == pytest.approx(value, abs=abs(each)), "the numbers are in proportion"
    return v0 - y0 * each, each


# ------------------------------------------------------------------------------------------- the charts


@pytest.mark.parametrize(
    "errors_mm",
    [
        (0.002, 0.004, -0.003, -0.2039, -0.2021, 0.001),
        (0.0131,),
        (-0.5, -0.5, -0.5),
        (0.0, 0.0),
        (1234.5, -0.001),
        (1e-7, 3e-7, 2e-7),
    ],
)
def test_each_dot_is_where_its_number_is(errors_mm: tuple[float, ...]) -> None:
    rows = [cells(k + 1, length_error_mm=error, artefact="frustum") for k, error in enumerate(errors_mm)]
    drawing = chart(season_page(rows, "t.csv"), "length error, µm")
    top, each = scale(drawing)
    found = dots(drawing)
    assert len(found) == len(errors_mm)
    for (x, y, _, words), error, k in zip(found, errors_mm, range(len(errors_mm)), strict=True):
        assert top + y * each == pytest.approx(1000.0 * error, abs=abs(each)), "within a pixel"
        assert x == pytest.approx(62 + (k + 0.5) * (1060 - 62 - 40) / len(errors_mm), abs=0.1)
        assert words.startswith(f"{k + 1:06d}  2031-05-{k + 1:02d} 09:12")
    assert all(14 <= y <= 190 for _, y, _, _ in found), "within the frame"


@pytest.mark.parametrize(
    "pair", [(-1e12, 1e12), (5e-324, 1e-323), (0.0, 5e-324), (445387194.6094142, 445387194.6094143), (0.0, 0.0)]
)
def test_numbers_of_any_size_have_an_axis_with_round_numbers(pair: tuple[float, float]) -> None:
    page = season_page([cells(k + 1, length_error_mm=value, temperature_c=value) for k, value in enumerate(pair)], "t")
    for what in ("length error, µm", "water, °C"):
        assert all(14.0 <= y <= 190.0 for _, y, _, _ in dots(chart(page, what)))
        assert 2 <= chart(page, what).count('text-anchor="end"') <= 16


def test_a_page_under_another_formats_name_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = Shell(capsys)("season", tmp_path / "table.csv", "--out", tmp_path / "s.pdf")
    assert said.code == 2
    assert "a page is written as .html; give s.html" in said.error
    assert not (tmp_path / "s.pdf").exists()


def test_each_calibration_has_its_colour_and_is_named_once() -> None:
    rows = [cells(k, calibration=("a" if k < 7 else "b") * 64, gap_mm=0.007 if k < 7 else 0.09) for k in range(1, 11)]
    page = season_page(rows, "t.csv")
    assert [colour for *_, colour, _ in dots(chart(page, "ray gap, µm"))] == [FIRST] * 6 + [SECOND] * 4
    caption = page.partition("ray gap, µm; scans")[2].partition("</figcaption>")[0]
    assert (caption.count("aaaaaaaaaaaa"), caption.count("bbbbbbbbbbbb")) == (1, 1)


@pytest.mark.parametrize(
    ("count", "named"),
    [(1, [1]), (2, [1, 2]), (10, list(range(1, 11))), (19, list(range(1, 20, 2)))],
)
def test_of_few_scans_none_lacks_its_number(count: int, named: list[int]) -> None:
    page = season_page([cells(number) for number in range(1, count + 1)], "/a/table.csv")
    drawing = chart(page, "ray gap, µm")
    assert [int(text) for text in re.findall(r">(\d{6})</text>", drawing)] == named
    assert "/a/table.csv" in page


def test_of_a_large_archive_what_stands_out_is_drawn() -> None:
    rows = [cells(1, gap_mm=0.007 + 0.0001 * (k % 7)) | {"scan": f"{k:06d}"} for k in range(1, 20_001)]
    rows[12_345] |= {"gap_mm": "0.09"}
    page = season_page(rows, "t.csv")
    drawing = chart(page, "ray gap, µm")
    top, each = scale(drawing)
    values = [top + y * each for _, y, _, _ in dots(drawing)]
    assert len(values) <= 1000
    assert max(values) == pytest.approx(90.0, abs=abs(each))
    assert min(values) == pytest.approx(7.0, abs=abs(each))
    assert len(page) < 1_000_000


def test_what_is_not_known_is_left_out_and_not_drawn_as_nothing() -> None:
    rows = [cells(1, gap_mm=""), cells(2, gap_mm="nan"), cells(3, gap_mm="inf"), cells(4, gap_mm=0.007)]
    page = season_page(rows, "t.csv")
    assert [words[:6] for *_, words in dots(chart(page, "ray gap, µm"))] == ["000004"]
    assert "Nothing in the table." in page.partition("Lengths over time")[2].partition("Health")[0]
    assert "no scan is in a --list" in page


def test_a_chart_has_its_frame_its_zero_line_and_its_words_below() -> None:
    rows = [cells(k + 1, length_error_mm=error, artefact="frustum") for k, error in enumerate((0.004, -0.004, 0.0))]
    rows.append(cells(4, state="failed", reason="dark", gap_mm="", noise_mm="", temperature_c=""))
    page = season_page(rows, "t.csv")
    assert '<svg viewBox="0 0 1060 230"' in page
    drawing = chart(page, "length error, µm")
    lines = re.findall(r'<line x1="62" x2="1020" y1="([\d.]+)" y2="([\d.]+)" stroke="(#\w+)"/>', drawing)
    assert [float(y) for y, _, _ in lines] == [pytest.approx(190.0 - k * 176.0 / 4, abs=0.1) for k in range(5)]
    assert [ink for *_, ink in lines] == ["#d5dde5", "#d5dde5", "#8a97a4", "#d5dde5", "#d5dde5"], "zero is dark"
    assert re.findall(r'x="54" y="[\d.]+" text-anchor="end">([−\d]+)</text>', drawing) == ["−4", "−2", "0", "2", "4"]
    assert re.findall(r'y="(208|223)" text-anchor="middle"', drawing) == ["208", "223"] * 4
    assert re.findall(r'<path d="M[\d.]+ (\d+v\d+)"', drawing) == ["191v6"]
    low = chart(page, "ray gap, µm")
    assert "#8a97a4" not in re.sub(r"<text.*?</text>", "", low), "no zero line where all numbers are above"


@pytest.mark.parametrize(("groups", "colours", "more"), [(6, 6, ""), (7, 6, " and 1 more")])
def test_of_many_groups_the_rare_ones_share_a_colour(groups: int, colours: int, more: str) -> None:
    rows = [cells(k + 1, length_error_mm=0.1, artefact=f"thing {k}") for k in range(groups)]
    page = season_page(rows, "t.csv")
    assert len({colour for *_, colour, _ in dots(chart(page, "length error, µm"))}) == colours
    caption = page.partition("length error, µm; scans")[2].partition("</figcaption>")[0]
    assert re.findall(r"thing (\d)", caption) == [str(k) for k in range(6)]
    assert caption.endswith(more or "thing 5")


def test_the_head_and_the_tiles_are_counts_and_medians_of_the_rows() -> None:
    rows = [
        cells(1, points=1_000_000, noise_mm=0.020, grade="good", e_l_percent=-0.25, recorded=""),
        cells(2, points=2_000_000, noise_mm=0.030, grade="good", e_l_percent=0.125, calibration="b" * 64),
        cells(3, points=1_500_000, noise_mm=0.060, grade="poor", spoilt=True, faults="MOTION: 3 mm", calibration="c" * 64),
        cells(4, state="failed", reason="dark", points="", noise_mm="", calibration="d" * 64),
    ]  # fmt: skip
    page = season_page(rows, "t.csv")
    words = " ".join(re.sub(r"<[^>]*>", " ", page.partition("<body>")[2]).split())
    assert "4 scans From 2031-05-02 09:12 To 2031-05-04 09:12 Calibrations " in words
    assert f"Calibrations {'a' * 12}, {'b' * 12}, {'c' * 12} and 1 more Table t.csv" in words
    assert "Scans with points 2 of 4 2 good, 1 spoilt, 1 without points" in words
    assert "Points 4.5 million 1,500,000 a scan (median)" in words
    assert "Noise 30 µm median over scans" in words
    assert "Largest length error 0.250 % 2 scans of artefacts" in words
    three = season_page([cells(k, calibration="abc"[k - 1] * 64, recorded="") for k in (1, 2, 3)], "t.csv")
    assert f"{'c' * 12}</dd>" in three, "three are named, and no more are there"
    assert three.count("no clock") == 2


def test_charts_group_noise_by_grade_and_water_by_salt_and_know_no_gap_of_compensated_scans() -> None:
    rows = [
        cells(1, grade="good", verdicts="motion=no compensation=yes"), cells(2, spoilt=True, salinity_psu=0.0),
        cells(3, verdicts="compensation=no"), cells(4, salinity_psu=""),
    ]  # fmt: skip
    page = season_page(rows, "t.csv")
    captions = {
        what: page.partition(f"{what}; scans")[2].partition("</figcaption>")[0] for what in ("noise, µm", "water, °C")
    }
    assert all(word in captions["noise, µm"] for word in ("good", "spoilt", "not graded"))
    assert all(word in captions["water, °C"] for word in ("35 psu", "0 psu", "not known"))
    assert [words[:6] for *_, words in dots(chart(page, "ray gap, µm"))] == ["000002", "000003", "000004"]


# ------------------------------------------------------------------------------------------- refused scans


def test_every_refused_scan_is_there_with_its_reason_and_marked_where_it_was_taken() -> None:
    rows = [cells(k) for k in range(1, 9)]
    damaged = "/disk/scans/{0}: frames_left.npy: damaged (its checksum does not fit) in sine-x-180; bring it back"
    for k in (2, 5):
        rows[k - 1] = cells(k, state="failed", reason=damaged.format(f"{k:06d}"), points="", gap_mm="", noise_mm="")
    rows[6] = cells(7, spoilt=True, faults="MOTION: the hands moved by 3 mm; BLURRED: edges of 4 px")
    page = season_page(rows, "t.csv")
    text = re.sub(r"<[^>]*>", " ", page.partition("<body>")[2])
    words = " ".join(text.split())
    assert "5 of 8 1 spoilt, 2 without points" in words
    assert "frames_left.npy: damaged 2" in words, "counted by its kind"
    assert "MOTION 1" in words
    assert (
        "000005 2031-05-05 09:12 frames_left.npy: damaged (its checksum does not fit) in sine-x-180; bring it back"
        in words
    )
    assert "000007 2031-05-07 09:12 MOTION: the hands moved by 3 mm; BLURRED: edges of 4 px" in words
    marks = [float(x) for x in re.findall(r'<path d="M([\d.]+) ', chart(page, "ray gap, µm"))]
    assert marks == [pytest.approx(62 + (k - 0.5) * 958 / 8, abs=0.1) for k in (2, 5, 7)]


@pytest.mark.parametrize(
    ("reason", "kind"),
    [
        ("dark (7 of 9); open it", "dark"),
        ("/disk/scans/000001: dark", "dark"),
        ("", "not known"),
    ],
)
def test_a_reasons_kind_is_its_beginning_without_the_numbers_of_one_scan(reason: str, kind: str) -> None:
    page = season_page([cells(1, state="failed", reason=reason)], "t.csv")
    assert f"<tbody><tr><td>{kind}</td><td>1</td></tr></tbody>" in page
    assert '<h2>Refused scans, and why</h2><p class="note">None.</p>' in season_page([cells(1)], "t.csv")


def test_a_season_without_any_result_says_why() -> None:
    page = season_page(
        [cells(1, state="failed", reason="x: missing", points="", gap_mm="", noise_mm="", temperature_c="")], "t.csv"
    )
    assert page.count("Nothing in the table.") == 4
    assert "x: missing" in page
    assert "0 of 1" in page


def test_a_table_without_scans_is_a_page_without_any() -> None:
    assert season_page([], "t.csv").count("Nothing in the table.") == 4


# ------------------------------------------------------------------------------------------- escaping


HOSTILE = """<script>throw new Error("in")</script><img src=x onerror=alert(1)>"'&amp;"""


def hostile_page() -> str:
    """Every column has it, in a scan with points, in one that is spoilt and in one that failed."""
    rows = [
        cells(1, artefact=HOSTILE, length_error_mm=0.1, calibration=HOSTILE, recorded=HOSTILE, salinity_psu=HOSTILE),
        cells(2, spoilt=True, faults=f"{HOSTILE}: {HOSTILE}", scan=HOSTILE),
        cells(3, state="failed", reason=HOSTILE, folder=HOSTILE, e_l_percent=HOSTILE, points=HOSTILE),
        cells(4, state=HOSTILE),
    ]
    return season_page(rows, f"{HOSTILE}/table.csv")


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
    found = Elements(hostile_page())
    assert found.names & {"script", "img"} == set()
    assert found.doing == []
    assert "throw new Error" in hostile_page(), "it is shown as text"


# ------------------------------------------------------------------------------------------- in a browser


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
def test_a_browser_shows_every_dot_and_asks_for_nothing(tmp_path: Path) -> None:
    rows = [
        cells(k, calibration=("a" if k < 14 else "b") * 64, gap_mm=0.007 + 0.001 * (k % 5), artefact="frustum", length_error_mm=0.002 * (k % 3))
        for k in range(1, 23)
    ]  # fmt: skip
    (tmp_path / "season.html").write_text(season_page(rows, "t.csv"), encoding="utf-8")
    console, asked = browse(
        tmp_path / "season.html", tmp_path, f"--screenshot={tmp_path / 'seen.png'}", "--window-size=1200,2400"
    )
    assert asked == []
    assert console == ""
    # Four charts, one of them in two colours.
    assert blobs(tmp_path / "seen.png", FIRST) == 3 * 22 + 13
    assert blobs(tmp_path / "seen.png", SECOND) == 9


@pytest.mark.foreign
@browser
def test_a_browser_runs_nothing_of_a_hostile_table(tmp_path: Path) -> None:
    (tmp_path / "season.html").write_text(hostile_page(), encoding="utf-8")
    console, asked = browse(tmp_path / "season.html", tmp_path, f"--screenshot={tmp_path / 'seen.png'}")
    assert (console, asked) == ("", [])


@pytest.mark.foreign
@browser
def test_on_paper_no_chart_is_cut(tmp_path: Path) -> None:
    (tmp_path / "season.html").write_text(season_page([cells(k) for k in range(1, 20)], "t.csv"), encoding="utf-8")
    browse(tmp_path / "season.html", tmp_path, "--no-pdf-header-footer", f"--print-to-pdf={tmp_path / 'paper.pdf'}")
    assert len(re.findall(rb"/Type /Page\b", (tmp_path / "paper.pdf").read_bytes())) in (2, 3)
