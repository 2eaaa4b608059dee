"""The page's tables are those measured, and one cause by itself does what physics says."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bench.phase_bias.page import BEGIN, END, write_page
from tests.support.bias import ripple


def test_tables_of_the_page_are_those_measured(tmp_path: Path) -> None:
    measured, page = tmp_path / "rows.json", tmp_path / "page.md"
    rows = [
        {"table": "periods", "name": "16 px", "values": {"ripple, px": 0.0668, "rms, µm": 22.93}},
        {"table": "periods", "name": "32 px", "values": {"ripple, px": 0.157, "rms, µm": 144.5}},
    ]
    measured.write_text(json.dumps({"rows": rows}))
    page.write_text(f"before\n{BEGIN}\nold 99\n{END}\nafter\n")
    for _ in range(2):
        write_page(measured, page)
    text = page.read_text()
    assert "| 16 px | 0.0668 | 22.9 |" in text
    assert "| 32 px | 0.16 | 144 |" in text or "| 32 px | 0.16 | 145 |" in text
    assert "old" not in text
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    page.write_text("no marks")
    with pytest.raises(ValueError, match="no marks"):
        write_page(measured, page)


def test_a_ripple_is_found_with_its_amplitude_and_nothing_else_is() -> None:
    rng = np.random.default_rng(1)
    at = rng.uniform(0.0, 1024.0, 200_000)
    error = 0.3 + 0.02 * np.sin(8 * np.pi * (at + 0.5) / 16 + 1.0) + rng.normal(0.0, 0.05, at.size)
    assert ripple(error, at, 16) == pytest.approx(0.02, rel=0.03)
    assert ripple(error, at, 32) < 0.001
    error[::7] = np.nan
    assert ripple(error, at, 16) == pytest.approx(0.02, rel=0.03)
