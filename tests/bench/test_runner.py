"""A benchmark that misses its bound, crashes or is misspelt is noticed; one that keeps it is recorded."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench.document import BEGIN, END, HEALTH_BEGIN, HEALTH_END, write_figures, write_health
from bench.result import Measured
from bench.runner import find, main


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    folder = tmp_path / "measured_here"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] == "measured_here"]:
        del sys.modules[name]


def benchmark(package: Path, name: str, body: str) -> None:
    (package / f"bench_{name}.py").write_text(
        f'"""Measures {name}."""\nfrom bench.result import Measured\ndef measure():\n    {body}\n'
    )


def test_kept_bounds_end_with_zero_and_a_record(package: Path, tmp_path: Path) -> None:
    benchmark(package, "good", "yield Measured('time', 2.0, 'ms', at_most=2.0)")
    assert main([], "measured_here", tmp_path / "out") == 0
    record = json.loads((tmp_path / "out" / "good.json").read_text())
    assert record["measured"] == [
        {
            "name": "time",
            "value": 2.0,
            "unit": "ms",
            "at_most": 2.0,
            "at_least": None,
            "kept": True,
            "why": None,
            "spread": None,
            "share": None,
        }
    ]


def test_a_missed_bound_fails_the_run_and_says_so(
    package: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    benchmark(package, "bad", "yield Measured('ratio', 39.0, '1', at_least=40.0)")
    benchmark(package, "good", "yield Measured('time', 1.0, 'ms', at_most=2.0)")
    assert main([], "measured_here", tmp_path / "out") == 1
    assert "at least 40: MISSED" in capsys.readouterr().out
    assert (tmp_path / "out" / "good.json").exists()


def test_a_crash_fails_the_run_keeps_its_numbers_and_lets_the_others_run(package: Path, tmp_path: Path) -> None:
    benchmark(package, "a", "yield Measured('first', 1.0, 'ms'); raise RuntimeError('boom')")
    benchmark(package, "b", "yield Measured('time', 1.0, 'ms')")
    assert main([], "measured_here", tmp_path / "out") == 1
    record = json.loads((tmp_path / "out" / "a.json").read_text())
    assert "boom" in record["error"]
    assert [number["name"] for number in record["measured"]] == ["first"]
    assert (tmp_path / "out" / "b.json").exists()


def test_only_the_named_ones_run(package: Path, tmp_path: Path) -> None:
    benchmark(package, "a", "yield Measured('time', 1.0, 'ms')")
    benchmark(package, "b", "yield Measured('time', 1.0, 'ms')")
    assert main(["b"], "measured_here", tmp_path / "out") == 0
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["b.json"]


def test_a_misspelt_name_is_answered_with_the_nearest(
    package: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    benchmark(package, "decode", "yield Measured('time', 1.0, 'ms')")
    assert main(["decoed"], "measured_here", tmp_path / "out") == 2
    assert "'decoed'; there is: decode" in capsys.readouterr().err


def test_a_benchmark_without_measure_is_an_error_not_a_silence(package: Path) -> None:
    (package / "bench_empty.py").write_text('"""Measures nothing."""\n')
    with pytest.raises(TypeError, match="bench_empty has no function measure"):
        find("measured_here")


def test_not_a_number_keeps_no_bound() -> None:
    assert not Measured("error", math.nan, "mm", at_most=1.0).kept


def test_every_benchmark_of_the_project_is_found_and_described() -> None:
    for name, found in find("bench").items():
        assert found.summary, f"bench_{name} has no docstring"


def test_figures_in_the_document_are_those_measured(tmp_path: Path) -> None:
    document, latest = tmp_path / "performance.md", tmp_path / "latest.json"
    document.write_text(f"before\n{BEGIN}\nold 99 ms\n{END}\nafter\n")
    latest.write_text(
        json.dumps({"scan_cpu_ms": 61.25, "fringes_cpu_ms": None, "why": {"fringes_cpu_ms": "no network"}})
    )
    for _ in range(2):
        write_figures(latest, document)
    text = document.read_text()
    assert "| whole scan | 61.2 | | ms CPU | |" in text
    assert "| — | | | no network |" in text
    assert "old" not in text
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    document.write_text("no marks")
    with pytest.raises(ValueError, match="no marks"):
        write_figures(latest, document)


def test_a_benchmark_may_have_options_of_its_own(package: Path, tmp_path: Path) -> None:
    benchmark(
        package, "good", "yield Measured('time', 2.0, 'ms', at_most=2.0)\ndef main(arguments): return len(arguments)"
    )
    assert main(["good", "--size", "3"], "measured_here", tmp_path / "out") == 2
    assert not (tmp_path / "out").exists()
    assert main(["good"], "measured_here", tmp_path / "out") == 0


def test_the_table_of_the_health_is_replaced_as_a_whole(tmp_path: Path) -> None:
    out, docs = tmp_path / "out", tmp_path / "docs"
    out.mkdir()
    docs.mkdir()
    document = docs / "calibration-health.md"
    document.write_text(f"before\n{HEALTH_BEGIN}\nold\n{HEALTH_END}\nafter\n")
    write_health(out, docs)
    assert "old" in document.read_text(), "nothing was measured, nothing is written"
    (out / "health.md").write_text("| new |\n")
    (out / "health.png").write_bytes(b"picture")
    for _ in range(2):
        write_health(out, docs)
    assert document.read_text() == f"before\n{HEALTH_BEGIN}\n\n| new |\n\n{HEALTH_END}\nafter\n"
    assert (docs / "pictures" / "calibration-health.png").read_bytes() == b"picture"


def test_what_was_just_measured_gets_into_the_document_also_where_a_bound_was_missed(
    package: Path, tmp_path: Path
) -> None:
    benchmark(package, "bad", "yield Measured('time', 304.0, 'ms', at_most=120.0, key='full_latency_p95_ms')")
    benchmark(package, "other", "raise RuntimeError('not asked for')")
    docs = tmp_path / "docs"
    docs.mkdir()
    (docs / "performance.md").write_text(f"{BEGIN}\nold\n{END}\n")
    assert main(["bad", "--write-docs"], "measured_here", tmp_path / "out", docs) == 1
    assert "| the same, 95 % | 304 | | ms | ≤ 120 **missed** |" in (docs / "performance.md").read_text()
    (docs / "performance.md").write_text(f"{BEGIN}\nold\n{END}\n")
    assert main(["--write-docs"], "measured_here", tmp_path / "out", docs) == 0, "nothing is measured"
    assert "| 304 |" in (docs / "performance.md").read_text()
