"""The table that compares the simulator's veil with photons stands where the page has its place, and says what was measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from bench.bench_veil import PAGE, figures
from bench.veil.table import BEGIN, END, Checked, write_page

ROW = Checked(
    1.0, 1.1, (101, 150), 1.53, 0.02, 1.012,
    ((0.951, 0.96, 0.97), (0.64, 0.69, 0.72)), ((0.954, 0.96, 0.97), (0.65, 0.68, 0.71)), (0.003, 0.002, 0.001),
)  # fmt: skip


def test_the_table_is_written_into_its_place_and_nothing_else_changes(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"Words.\n\n{BEGIN}\nan old table\n{END}\n\nMore words.\n", encoding="utf-8")
    write_page([ROW, replace(ROW, per_m=3.0, more=4.0, more_error=0.2)], page)
    text = page.read_text(encoding="utf-8")
    assert text.startswith(f"Words.\n\n{BEGIN}\n")
    assert text.endswith(f"{END}\n\nMore words.\n")
    assert "old table" not in text
    assert "| 1 /m, n 1.1 | 101, 150 | 1.53 | 1.01 | 0.95; 0.95 | 0.64; 0.65 | 0.69; 0.68 | 0.72; 0.71 |" in text
    assert "1 % of brightness and 0.003 of contrast at 1 /m, 5 % of brightness and 0.003 of contrast at 3 /m" in text


def test_a_page_without_a_place_is_left_as_it_was(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"{BEGIN}\n", encoding="utf-8")
    with pytest.raises(ValueError, match="no place for the table"):
        write_page([ROW], page)
    assert page.read_text(encoding="utf-8") == f"{BEGIN}\n"


def test_the_world_s_page_has_the_place() -> None:
    text = (Path(__file__).parents[2] / PAGE).read_text(encoding="utf-8")
    assert text.count(BEGIN) == text.count(END) == 1


def test_a_veil_that_differs_from_that_of_photons_misses_its_bounds() -> None:
    assert all(one.kept for one in figures([ROW]))
    brighter = replace(ROW, over=1.2)
    smoother = replace(ROW, simulated=(ROW.simulated[0], (0.65, 0.60, 0.71)))
    for wrong in (brighter, smoother):
        assert sum(not one.kept for one in figures([wrong])) == 1
