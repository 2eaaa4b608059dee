"""Each bench runs at its smallest size: a bench that nobody could run proves nothing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import pytest

from bench import bench_compile, bench_endurance, bench_felt, bench_reconstruction, bench_whole_scan
from bench.result import Measurement
from bench.runner import find
from bench.whole_scan.scenes import DISC, timed_scene

BENCHES = find("bench")
SMALLEST = {
    "ablation": "--scans 1 --rules motion.harm.UNEVEN_LEFT",
    "architecture": "",
    "import_sequences": "--only 3ps",
    "import_wrong_words": "--count 1",
    "merge": "--parts pairs --pairs 1",
}
"""Words of those that have sizes."""


@pytest.mark.dive
@pytest.mark.parametrize("name", SMALLEST)
def test_a_bench_with_sizes_runs_at_its_smallest(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    main = BENCHES[name].main
    assert main is not None
    assert main(SMALLEST[name].split()) in (0, 1), "a bound of its full size may be missed"
    assert capsys.readouterr().out, "nothing was measured"


@pytest.mark.parametrize("name", BENCHES)
def test_a_bench_is_described_and_says_what_it_can(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert BENCHES[name].summary
    main = BENCHES[name].main
    if main is not None:
        with pytest.raises(SystemExit) as ended:
            main(["--help"])
        assert ended.value.code == 0
        assert f"./dev bench {name}" in capsys.readouterr().out


SMALL: Mapping[str, Callable[[Path], Iterable[Measurement]]] = {
    "compile": lambda folder: bench_compile.figures(
        bench_compile.compiled([("pattern identity", "appliance.measure.warm:judge_patterns")], 1), 1.0
    ),
    "endurance": lambda folder: bench_endurance.log_figures(bench_endurance.dive(folder, 2, "400x300")),
    "felt": lambda folder: bench_felt.key_to_answers(
        timed_scene(DISC, 400, folder), bench_felt.Effort(400, 1, 1, compensated=False), folder
    ),
    "reconstruction": lambda folder: bench_reconstruction.measured_with(
        bench_reconstruction.Effort(400, 300, 3, 1, 1, 2, 2, ask_peers=False), folder
    ),
    "whole_scan": lambda folder: bench_whole_scan.measured_with(
        bench_whole_scan.Effort(400, scans=2, rounds=1, folder=folder / "scenes", scenes=(DISC,)), folder
    ),
}


@pytest.mark.dive
@pytest.mark.parametrize("name", SMALL)
def test_a_bench_of_the_whole_product_measures_what_it_names(name: str, tmp_path: Path) -> None:
    found = list(SMALL[name](tmp_path))
    assert found
    assert all(math.isfinite(one.value) or one.why is not None for one in found), "each is a number or says why not"
