"""What the worker runs at its start has loaded every kernel that a scan can need: nobody under water waits for a compiler."""

from __future__ import annotations

import sys
import tarfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numba.core.registry import CPUDispatcher

from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.patterns import build_sequence
from appliance.measure.light.sides import SIDES
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.procedure import SequenceProcessor
from appliance.measure.warm import run_remaining_kernels
from appliance.store.config import load_rig
from appliance.store.origin import SourceScan
from appliance.store.wish import ScanOptions
from tests.behaviour.frozen import RECORDINGS
from tests.support import synthetic

SCANS = {"compensated": "000004", "turbid water": "000007", "milk": "000008", "specks": "000009"}
FLICKERS = "000001"


def signatures() -> dict[str, int]:
    """Of the product's kernels: how many each has been compiled or loaded for."""
    things = (one for module in list(sys.modules.values()) for one in list(vars(module).values()))
    kernels = (one for one in things if issubclass(type(one), CPUDispatcher))
    mine = (kernel for kernel in kernels if kernel.py_func.__module__.startswith("appliance."))
    return {f"{kernel.py_func.__module__}.{kernel.py_func.__name__}": len(kernel.signatures) for kernel in mine}


@pytest.fixture(scope="module")
def warm() -> Iterator[None]:
    """As the worker is when it says that it is ready."""
    sequence, calibration = build_sequence(16), synthetic.calibration(144, 108)
    nothing = np.zeros((len(sequence), 108, 144), np.uint8)
    with Pipeline(calibration, synthetic.WATER, sequence) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, synthetic.WATER)
        processor.process(dict.fromkeys(SIDES, nothing), AcquisitionSettings())
        run_remaining_kernels(sequence)
        yield


@pytest.mark.usefixtures("warm")
def test_no_scan_needs_a_kernel_that_is_not_there(tmp_path: Path) -> None:
    before = signatures()
    assert before
    with tarfile.open(RECORDINGS) as packed:
        packed.extractall(tmp_path, filter="data")
    wish = ScanOptions(rig=load_rig(tmp_path / "rig.toml"), root=tmp_path / "root")
    for number in (*SCANS.values(), FLICKERS):
        source = SourceScan.open(tmp_path / "root" / "scans" / number, wish)
        calibration = source.calibration_for(wish).calibration
        played = source.scan.manifest.record.sequence
        sequence = build_sequence(played.period_px, played.width_px, played.height_px)
        with Pipeline(calibration, calibration.water, sequence) as pipeline:
            frames = {side: one.copy() for side, one in source.scan.frames.items()}  # writable, as in the store
            if number == FLICKERS:  # at 20 Hz, which no recording does
                light = 1.0 + 0.06 * np.sin(2.0 * np.pi * np.arange(len(sequence)) / 3.0)[:, None, None]
                frames = {side: np.rint(one * light).clip(0, 255).astype(np.uint8) for side, one in frames.items()}
            SequenceProcessor(pipeline, calibration, calibration.water).process(frames, AcquisitionSettings())
    after = signatures()
    assert {kernel for kernel, count in after.items() if count != before.get(kernel, 0)} == set()


@pytest.mark.usefixtures("warm")
def test_a_scan_that_moves_along_with_the_fringes_needs_no_compiler_either() -> None:
    # The scans above do not move so.
    known = signatures()
    kernels = {
        "residuals.accumulate", "stripes.accumulate_gray", "phase_solver.depth_rows", "phase_solver.solve_rows",
        "redecode.drop_edges",
    }  # fmt: skip
    assert {kernel: known[f"appliance.measure.motion.{kernel}"] for kernel in kernels} == dict.fromkeys(kernels, 1)
