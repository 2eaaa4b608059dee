"""What a first run compiles is told kernel by kernel, each without what it calls."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.bench_compile import Compiled, compiled, dearest, figures, table
from bench.document import COMPILE_BEGIN, COMPILE_END, COMPILING, write_figures

PIECE = Compiled(
    "light",
    3.0,
    [("appliance.light.fit", 1.0), ("numba.np.arrayobj.sort.<locals>.impl", 0.25), ("appliance.light.fit", 0.5), ("appliance.light.add", 0.125)],
    {"nopython_type_inference": 0.5, "native_lowering": 1.25},
)  # fmt: skip


def test_a_kernel_of_two_forms_counts_once_and_the_dearest_come_first() -> None:
    assert dearest(PIECE) == [("light.fit", 1.5, 2), ("sort.impl", 0.25, 1), ("light.add", 0.125, 1)]


def test_the_sum_is_judged_and_the_table_says_so() -> None:
    said = {one.key: one for one in figures([PIECE] * 20, 40.0)}
    assert said["compile_cpu_s"].value == 60.0
    assert not said["compile_cpu_s"].kept
    assert said["compile_of_numba_cpu_s"].value == pytest.approx(5.0)
    assert said["compile_finding_types_cpu_s"].value == pytest.approx(10.0)
    text = table([PIECE] * 20, 15, 40.0)
    assert "60 s of CPU (≤ 48 **missed**), 45 of them the product's, and 40 s by the clock" in text
    assert "| light | 3.0 | 4 | `light.fit` 1.5 (× 2), `sort.impl` 0.2, `light.add` 0.1 |" in text


def test_the_table_gets_into_the_document(tmp_path: Path) -> None:
    (tmp_path / "latest.json").write_text("{}")
    (tmp_path / COMPILING).write_text(table([PIECE], 1, 2.0))
    document = tmp_path / "performance.md"
    document.write_text(
        f"before\n{COMPILE_BEGIN}\nold\n{COMPILE_END}\nbehind\n<!-- figures: ./dev bench --write-docs -->\n<!-- end of figures -->\n"
    )
    write_figures(tmp_path / "latest.json", document)
    text = document.read_text()
    assert "`light.fit` 1.5 (× 2)" in text
    assert "\nold\n" not in text


@pytest.mark.dive
def test_what_is_compiled_is_compiled_anew_and_what_cannot_be_is_named() -> None:
    piece = "appliance.worker.warm:judge_patterns"
    (first,) = compiled([("pattern identity", piece)], 2)
    assert first.cpu_s > 0.5, "nothing was in the folder"
    own_s = sum(own_s for _, own_s in first.kernels)
    assert 0.5 * first.cpu_s < own_s < first.cpu_s
    assert 0.0 < first.stages_s["nopython_type_inference"] < first.stages_s["native_lowering"] < own_s
    assert any(name.startswith("appliance.verdict.identity.") for name, _ in first.kernels)
    with pytest.raises(RuntimeError, match="nothing at all: the compiling process ended"):
        compiled([("nothing at all", "appliance.worker.warm:no_such_piece")], 1)
