"""A benchmark that misses its bound, crashes or is misspelt is noticed; one that keeps it is recorded."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

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


def test_a_benchmark_without_measure_is_an_error_not_a_silence(package: Path) -> None:
    (package / "bench_empty.py").write_text('"""Measures nothing."""\n')
    with pytest.raises(TypeError, match="bench_empty has no function measure"):
        find("measured_here")


def test_not_a_number_keeps_no_bound() -> None:
    assert not Measured("error", math.nan, "mm", at_most=1.0).kept
