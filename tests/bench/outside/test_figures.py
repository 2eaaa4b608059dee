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
from bench.outside.figures import false_alarms, of_scenes, summary
from bench.outside.page import begin, block, end, together, write_page
from bench.outside.parts import PARTS
from bench.outside.picture import draw_scenes
from bench.outside.record import added, compact, read
from bench.result import Measured
from bench.verdict.binomial import rate


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


def a_part(rows: list[dict[str, Any]], value: float | None = None, count: int = 7) -> dict[str, Any]:
    measured = [one.as_dict() for one in of_scenes(rows)]
    measured[2]["value"] = value
    data = {"families": [summary("lens", rows)]}
    return {"count": count, "measured_on": "2020-02-20", "measured": measured, "data": data}


def of_parts(**parts: dict[str, Any]) -> dict[str, Any]:
    return {"parts": {name: {"3": part} for name, part in parts.items()}}


def test_the_page_shows_the_product_before_beside_the_present_one() -> None:
    text = block("scenes", "3", a_part([a_row()], 87.5), of_parts(scenes=a_part([a_row()], 61.25)))
    line = next(line for line in text.splitlines() if line.startswith("| completeness, median of accepted"))
    assert line.split("|")[3].strip() == "61.2"
    assert line.split("|")[4].strip() == "87.5 %"


def test_where_the_product_before_was_not_measured_there_is_no_column_of_it() -> None:
    other_seed = {"parts": {"scenes": {"4": a_part([a_row()], 61.25)}}}
    assert "the product before" not in block("scenes", "3", a_part([a_row()], 87.5), other_seed)


def test_what_is_kept_of_the_product_before_has_no_single_scans() -> None:
    rows = [a_row(texts={"water": "long"}), a_row(families=["soft"])]
    part = a_part(rows)
    part["data"]["rows"] = {"all": rows}
    kept = compact(of_parts(scenes=part))["parts"]["scenes"]["3"]["data"]
    assert "rows" not in kept
    assert kept["families"]
    assert kept["scenes"] == [
        {"attenuation_per_m": 0.5, "complete_percent": 90.0, "error_over_sigma": 1.0, "accepted": True}
    ]


def a_page(path: Path, **inside: str) -> Path:
    """Write a page with a place for each of these parts, and what stands there already."""
    places = [f"{begin(name)}\n{text}\n{end(name)}" for name, text in inside.items()]
    path.write_text("# A page\n\n" + "\n\nWords.\n\n".join(places) + "\n\nLast words.\n", encoding="utf-8")
    return path


def written(tmp_path: Path, page: Path, content: dict[str, Any]) -> str:
    data = tmp_path / "data.json"
    data.write_text(json.dumps(content), encoding="utf-8")
    write_page(data, tmp_path / "none.json", page, tmp_path)
    return page.read_text(encoding="utf-8")


def test_a_run_of_one_part_leaves_the_tables_of_the_others(tmp_path: Path) -> None:
    page = a_page(
        tmp_path / "page.md", milk="### Milk\n\n<!-- seed 3 -->\nold milk", rigs="### Rigs\n\n<!-- seed 3 -->\nold rigs"
    )
    text = written(tmp_path, page, of_parts(milk=a_part([a_row()], 87.5)))
    assert "old rigs" in text
    assert "old milk" not in text
    assert "87.5 %" in text
    assert text.count("Words.") == 1
    assert text.endswith("Last words.\n")


def test_figures_are_written_into_the_place_of_their_part_alone(tmp_path: Path) -> None:
    page = a_page(tmp_path / "page.md", milk="", rigs="")
    text = written(tmp_path, page, of_parts(milk=a_part([a_row()], 87.5)))
    assert text.count("87.5 %") == 1
    assert text.index(begin("milk")) < text.index("87.5 %") < text.index(end("milk"))
    assert written(tmp_path, page, of_parts(milk=a_part([a_row()], 87.5))) == text


def test_a_run_of_another_seed_stands_beside_the_one_before_and_each_says_which_it_is(tmp_path: Path) -> None:
    page = a_page(tmp_path / "page.md", milk="### Milk\n\n<!-- seed 12 -->\nolder milk\n")
    text = written(tmp_path, page, of_parts(milk=a_part([a_row()], 87.5, count=5)))
    assert "older milk" in text
    assert text.index("<!-- seed 3 -->") < text.index("<!-- seed 12 -->")
    assert "Seed 3: `./dev bench outside --parts milk --seed 3 --count 5`, measured on 2020-02-20." in text
    again = written(tmp_path, page, of_parts(milk=a_part([a_row()], 12.5)))
    assert "older milk" in again
    assert "87.5 %" not in again


def test_a_file_of_one_seed_is_added_to_by_another(tmp_path: Path) -> None:
    content: dict[str, Any] = {"parts": {}}
    for name, seed in (("milk", 1), ("milk", 4), ("rigs", 4), ("milk", 1)):
        content = added(content, name, seed, [Measured("a figure", 10.0 * seed, "")], {"count": 2, "data": {}})
    path = tmp_path / "outside.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    parts = read(path)["parts"]
    assert {name: list(seeds) for name, seeds in parts.items()} == {"milk": ["1", "4"], "rigs": ["4"]}
    assert [one["measured"][0]["value"] for one in parts["milk"].values()] == [10.0, 40.0]
    assert parts["milk"]["1"]["count"] == 2


def test_a_file_that_is_no_measurement_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "outside.json"
    path.write_text(json.dumps({"seed": 1, "parts": {"milk": {"measured": [], "data": {}}}}), encoding="utf-8")
    with pytest.raises(ValueError, match="no measurement by parts and seeds"):
        read(path)


def lines_of(*measured: Measured) -> list[str]:
    part = {"count": 1, "measured_on": "", "measured": [one.as_dict() for one in measured], "data": {}}
    return block("milk", "1", part, {"parts": {}}).splitlines()[4:]


def test_what_misses_its_bound_by_less_than_three_digits_show_does_not_look_as_if_it_kept_it() -> None:
    (line,) = lines_of(rate("found", 9997, 10_000, at_least=100.0))
    assert "99.97 % (9997 of 10000;" in line
    assert "**missed**" in line
    (line,) = lines_of(Measured("length", 0.0250004, "%", at_most=0.025))
    assert "| 0.0250004 % **missed** |" in line
    (line,) = lines_of(rate("all found", 10, 10, at_least=100.0))
    assert "100.0 % (10 of 10; 69.2 to 100.0)" in line
    assert "missed" not in line


def test_what_there_was_none_of_has_no_unit_and_says_so() -> None:
    (line,) = lines_of(rate("found, shown on 1 to 2 %", 0, 0, at_least=100.0))
    assert line == "| found, shown on 1 to 2 % |  | — (none to count) |"


def test_false_alarms_are_added_up_over_scenes_soft_scenes_and_health() -> None:
    rows = [a_row()] * 180 + [a_row(families=["soft"], faults=["LIGHT_FLICKERS"])] + [a_row(families=["soft"])] * 19
    health = {"measured": [one.as_dict() for one in false_alarms([a_row()] * 112)], "data": {}}
    text = together(of_parts(scenes=a_part(rows), health=health))
    (light,) = (line for line in text if line.startswith("| false alarms of light"))
    # Exact limits of 1 of 312: 0.008 and 1.77 %.
    assert "| 0 of 180 + 1 of 20 + 0 of 112 | 1 of 312 (0.01 to 1.8 %) **missed** |" in light
    assert together(of_parts(scenes=a_part(rows))) == []


def test_soft_scenes_of_a_sample_count_where_the_scenes_have_none() -> None:
    soft = [a_row(families=["soft"])] * 20
    parts = of_parts(
        scenes=a_part([a_row()] * 180), sample=a_part([*[a_row()] * 30, *soft]), health=a_part([a_row()] * 112)
    )
    (light,) = (line for line in together(parts) if line.startswith("| false alarms of light"))
    assert "| 0 of 180 + 0 of 112 + 0 of 20 | 0 of 312 (0.0 to 1.2 %) |" in light


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


def test_a_page_without_a_place_for_a_part_is_not_written_over(tmp_path: Path) -> None:
    page = a_page(tmp_path / "page.md", milk="old milk")
    before = page.read_text(encoding="utf-8")
    with pytest.raises(ValueError, match="no place for the figures of 'rigs'"):
        written(tmp_path, page, of_parts(milk=a_part([a_row()]), rigs=a_part([a_row()])))
    assert page.read_text(encoding="utf-8") == before


def test_the_page_has_a_place_for_every_part() -> None:
    text = (Path(__file__).parents[3] / "docs" / "outside.md").read_text(encoding="utf-8")
    for name in (*PARTS, "together"):
        assert text.count(begin(name)) == text.count(end(name)) == 1


def test_an_unknown_part_is_refused_with_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as refused:
        main(["--parts", "fog"])
    assert refused.value.code == 2
    assert "'fog' is unknown; allowed are scenes" in capsys.readouterr().err
