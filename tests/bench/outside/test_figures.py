"""What is counted over the scans of the world ``outside``, and the page that it is written to."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bench.bench_outside import main
from bench.outside.figures import of_scenes, summary
from bench.outside.page import BEGIN, END, compact, tables, write_page
from bench.outside.picture import draw_scenes


def a_row(**other: Any) -> dict[str, Any]:
    return {
        "families": ["lens"], "accepted": True, "faults": [], "complete_percent": 90.0, "points": 1000, "outliers": 0,
        "error_over_sigma": 1.0, "rms_um": 50.0, "number": 0, "attenuation_per_m": 0.5, **other,
    }  # fmt: skip


def of(rows: list[dict[str, Any]], name: str) -> float:
    return next(one.value for one in of_scenes(rows) if one.name == name)


def test_outliers_of_refused_scans_are_counted_apart() -> None:
    rows = [a_row(), a_row(accepted=False, outliers=10)]
    assert of(rows, "outliers over 1 mm in accepted scans") == 0.0
    assert of(rows, "outliers over 1 mm in all scans") == 5000.0


def test_soft_scenes_are_counted_apart() -> None:
    rows = [a_row(), a_row(families=["soft"], outliers=7, error_over_sigma=9.0)]
    assert of(rows, "outliers over 1 mm in all scans") == 0.0
    assert of(rows, "error over sigma in these, median") == 9.0


def test_a_scan_that_errs_far_more_than_expected_counts_only_if_nothing_was_said() -> None:
    rows = [a_row(), a_row(error_over_sigma=1.6), a_row(error_over_sigma=1.7, faults=["WATER_DIRTY"])]
    assert of(rows, "of these above 1.5 and nothing said") == 1.0


def test_an_alarm_that_no_scene_deserves_misses_its_bound() -> None:
    alarms = next(one for one in of_scenes([a_row(faults=["LIGHT_FLICKERS"])]) if one.name == "false alarms of light")
    assert alarms.value == 1.0
    assert not alarms.kept


def test_a_rate_has_its_interval() -> None:
    alarms = next(one for one in of_scenes([a_row()] * 300) if one.name == "false alarms of light")
    # Exact limits of 0 of 300: 1 - 0.025^(1/300) = 1.22 %.
    assert alarms.unit == "of 300 (0.0 to 1.2 %)"


def test_no_scan_at_all_is_no_figure() -> None:
    assert math.isnan(of([], "error over sigma, median of accepted"))


def content(value: float, rows: list[dict[str, Any]]) -> dict[str, Any]:
    measured = [one.as_dict() for one in of_scenes(rows)]
    measured[2]["value"] = value
    return {
        "seed": 3,
        "parts": {
            "scenes": {"measured": measured, "data": {"families": [summary("lens", rows)], "rows": {"all": rows}}}
        },
    }


def test_the_page_shows_the_product_before_beside_the_present_one() -> None:
    text = tables(content(87.5, [a_row()]), content(61.25, [a_row()]))
    line = next(line for line in text.splitlines() if line.startswith("| completeness, median of accepted"))
    assert line.split("|")[3].strip() == "61.2"
    assert line.split("|")[4].strip() == "87.5 %"


def test_what_is_kept_of_the_product_before_has_no_single_scans() -> None:
    kept = compact(content(1.0, [a_row(texts={"water": "long"}), a_row(families=["soft"])]))["parts"]["scenes"]["data"]
    assert "rows" not in kept
    assert kept["families"]
    assert kept["scenes"] == [
        {"attenuation_per_m": 0.5, "complete_percent": 90.0, "error_over_sigma": 1.0, "accepted": True}
    ]


def test_each_scene_is_a_dot_at_its_water_and_a_refused_one_is_hollow(tmp_path: Path) -> None:
    path = tmp_path / "scenes.png"
    dots = [
        {"attenuation_per_m": per_m, "complete_percent": 50.0, "error_over_sigma": None, "accepted": accepted}
        for per_m, accepted in ((0.5, True), (1.5, False))
    ]
    draw_scenes(path, [], dots)
    image = cv2.imread(str(path))
    assert image is not None
    row = image[40 + 150, 60:620].astype(int)
    blue = np.flatnonzero(row[:, 0] - row[:, 2] > 60) / 560.0 * 2.0
    # Of a panel of 560 px for 2 /m: a disc of nine pixels about 0.5 /m; of the ring about 1.5 /m only its sides.
    assert np.abs(blue[blue < 1.0] - 0.5).max() < 0.03
    assert np.count_nonzero(blue < 1.0) >= 7
    assert np.abs(blue[blue > 1.0] - 1.5).min() > 0.005


def test_a_page_without_a_place_for_figures_is_not_written_over(tmp_path: Path) -> None:
    data, page = tmp_path / "data.json", tmp_path / "page.md"
    data.write_text(json.dumps(content(1.0, [a_row()])), encoding="utf-8")
    page.write_text("# A page\n", encoding="utf-8")
    with pytest.raises(ValueError, match="no place for figures"):
        write_page(data, tmp_path / "none.json", page, tmp_path)
    assert page.read_text(encoding="utf-8") == "# A page\n"
    assert BEGIN != END


def test_an_unknown_part_is_refused_with_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as refused:
        main(["--parts", "fog"])
    assert refused.value.code == 2
    assert "'fog' is unknown; allowed are scenes" in capsys.readouterr().err
