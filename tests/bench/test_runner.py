"""A benchmark that misses its bound, crashes or is misspelt is noticed; one that keeps it is recorded."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench.document import BEGIN, END, FELT_BEGIN, FELT_END, write_figures
from bench.result import Measurement
from bench.runner import find, main, note_latest
from tests.test_docs import FIGURES

BODIES = {
    "crash": "yield Measurement('first', 1.0, 'ms'); raise RuntimeError('boom')",
    "good": "yield Measurement('time', 1.0, 'ms', at_most=2.0)",
    "missed": "yield Measurement('ratio', 39.0, '1', at_least=40.0)",
}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    folder = tmp_path / "measured_here"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] == "measured_here"]:
        del sys.modules[name]


def benchmark(package: Path, name: str) -> None:
    text = f'"""Measures."""\nfrom bench.result import Measurement\ndef measure():\n    {BODIES[name]}\n'
    (package / f"bench_{name}.py").write_text(text)


@pytest.mark.parametrize(("name", "code"), [("crash", 1), ("missed", 1), ("good", 0)])
def test_a_missed_bound_or_a_crash_fails_the_run_is_told_and_lets_the_others_run(
    package: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, code: int
) -> None:
    for one in {name, "good"}:
        benchmark(package, one)
    assert main([], "measured_here", tmp_path / "out") == code
    assert ("at least 40: MISSED" in capsys.readouterr().out) == (name == "missed")
    assert (tmp_path / "out" / "good.json").exists()
    record = json.loads((tmp_path / "out" / f"{name}.json").read_text())
    assert len(record["measured"]) == 1, "a crash keeps its numbers"
    assert ("boom" in str(record.get("error"))) == (name == "crash")


def test_a_benchmark_without_measure_is_an_error_and_not_a_number_keeps_no_bound(package: Path) -> None:
    (package / "bench_empty.py").write_text('"""Measures nothing."""\n')
    with pytest.raises(TypeError, match="bench_empty has no function measure"):
        find("measured_here")
    assert not Measurement("error", math.nan, "mm", at_most=1.0).is_kept


def test_the_first_table_of_the_page_has_a_figure_its_limit_and_the_day_of_both(tmp_path: Path) -> None:
    latest, page = tmp_path / "latest.json", tmp_path / "performance.md"
    page.write_text(f"Before.\n\n{FELT_BEGIN}\nold\n{FELT_END}\n\n{BEGIN}\nother\n{END}\n")
    note_latest([Measurement("key to verdict", 497.7, "ms", key="felt_verdict_ms")], latest)
    note_latest([Measurement("recording", 400.0, "ms", key="felt_recording_ms")], latest)
    write_figures(latest, page)
    lines = page.read_text().splitlines()
    assert "| key to verdict | 498 | ms | recording 400 |" in lines
    assert "| key to coarse cloud | — | ms | recording 400 |" in lines, "not measured"
    assert [line for line in lines if FIGURES.fullmatch(line)]
    assert (lines[0], lines[-2], "old" in lines) == ("Before.", "other", False)
