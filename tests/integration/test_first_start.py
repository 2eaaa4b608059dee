"""The first start compiles what a scan needs before anything opens, says so, and the next start does not."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from appliance import kernel_cache
from appliance.cli.simrig import simulator_kernels
from appliance.kernel_build import Piece, compile_pieces
from appliance.worker.warm import PIECES

pytestmark = pytest.mark.dive

SCRIPT = "wait state AIM 120\nend\n"


@pytest.mark.timeout(600)
def test_a_first_start_says_what_it_compiles_before_the_self_test_begins(tmp_path: Path) -> None:
    mine = kernel_cache.use().path
    compile_pieces(mine, (*PIECES, *(Piece(*piece) for piece in simulator_kernels())))
    kernels = tmp_path / kernel_cache.fingerprint()
    shutil.copytree(mine, kernels)
    kernels.chmod(0o700)
    # As after a start that was broken off: one piece is not there. (All of them would take this test a minute.)
    for found in (kernels / kernel_cache.MARKS).glob("*judge_patterns"):
        found.unlink()
    for compiled in kernels.glob("identity_*/counts.*"):
        compiled.unlink()
    script = tmp_path / "dive.script"
    script.write_text(SCRIPT, encoding="utf-8")

    first = _dive(script, tmp_path, kernels)
    begun = next(k for k, line in enumerate(first) if "compiling, once: 0 of 1 done; pattern identity" in line)
    ended = next(k for k, line in enumerate(first) if "compiled in" in line)
    opened = next(k for k, line in enumerate(first) if "SELF_TEST" in line)
    assert begun < ended < opened

    script.write_text("wait state SELF_TEST 120\nend\n", encoding="utf-8")
    again = _dive(script, tmp_path, kernels)
    assert not any("compil" in line for line in again)
    assert any("SELF_TEST" in line for line in again)
    assert not any("uncalibrated" in line for line in (*first, *again)), "the nominal rig is as drawn"


def _dive(script: Path, folder: Path, kernels: Path) -> list[str]:
    """What ``kingfisher sim`` says on stderr."""
    options = ["--truth", "nominal", "--size", "160x120", "--script", str(script), "--root", str(folder / "root")]
    ran = subprocess.run(
        [sys.executable, "-m", "appliance.cli", "sim", *options],
        env={**os.environ, kernel_cache.VARIABLE: str(kernels)}, capture_output=True, text=True, timeout=280,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    return ran.stderr.splitlines()
