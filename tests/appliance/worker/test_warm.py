"""What the worker runs at its start has loaded every kernel that a scan can need: nobody under water waits for a compiler."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np
import pytest
from numba.core.registry import CPUDispatcher

from appliance.patterns.sequence import build_sequence
from appliance.processing.procedure import SequenceProcessor
from appliance.reconstruct.pipeline import Pipeline
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.sides import SIDES
from appliance.worker.warm import run_what_an_empty_scan_does_not
from hw_sim.light.daylight import Daylight
from hw_sim.objects.motion import Motion
from hw_sim.scene import Scene
from hw_sim.water.drift import Drift
from hw_sim.water.medium import turbid
from tests.support.rendered import render_scan
from tests.support.truth import WATER, true_calibration

SCENES = {
    "at rest": Scene("pipe"),
    "moving": Scene("plane", texture="slight", motion=Motion(velocity_mm_s=(2.0, 0.0, 10.0))),
    "in turbid water": Scene("pipe", water=turbid(1.5)),
    "in flickering light": Scene("plane", ambient=0.3, daylight=Daylight(flicker_depth=1.0)),
    "with snow": Scene("pipe", drift=Drift(particles_per_l=100.0)),
}


def signatures() -> dict[str, int]:
    """Of the product's kernels: how many each has been compiled or loaded for."""
    things = (one for module in list(sys.modules.values()) for one in list(vars(module).values()))
    kernels = (one for one in things if issubclass(type(one), CPUDispatcher))
    mine = (kernel for kernel in kernels if kernel.py_func.__module__.startswith("appliance."))
    return {f"{kernel.py_func.__module__}.{kernel.py_func.__name__}": len(kernel.signatures) for kernel in mine}


@pytest.fixture(scope="module")
def warm() -> Iterator[None]:
    """As the worker is when it says that it is ready."""
    sequence = build_sequence(16)
    scan = render_scan(SCENES["at rest"], "nominal", 1, 200, 16)
    calibration = true_calibration(scan.renderer.truth)
    nothing = np.zeros((len(sequence), 150, 200), np.uint8)
    with Pipeline(calibration, WATER, sequence) as pipeline:
        SequenceProcessor(pipeline, calibration, WATER).process(dict.fromkeys(SIDES, nothing), AcquisitionSettings())
        run_what_an_empty_scan_does_not(sequence)
        yield


@pytest.mark.usefixtures("warm")
@pytest.mark.parametrize("name", [name for name in SCENES if name != "at rest"])
def test_no_scan_needs_a_kernel_that_is_not_there(name: str) -> None:
    before = signatures()
    scene = SCENES[name]
    scan = render_scan(scene, "nominal", 1, 200, 16, frame_s=0.0 if scene.still else 1 / 60)
    calibration = true_calibration(scan.renderer.truth)
    with Pipeline(calibration, WATER, scan.sequence) as pipeline:
        SequenceProcessor(pipeline, calibration, WATER).process(scan.frames, AcquisitionSettings())
    after = signatures()
    assert before
    assert {kernel for kernel, count in after.items() if count != before.get(kernel, 0)} == set()


@pytest.mark.usefixtures("warm")
def test_a_scan_that_moves_along_with_the_fringes_needs_no_compiler_either() -> None:
    # Its steps shrink until the albedo is asked for: the scenes above do not move so.
    known = signatures()
    kernels = {
        "residuals.accumulate", "stripes.accumulate_gray", "phase_solver.depth_rows", "phase_solver.solve_rows",
        "albedo.gather", "redecode.drop_edges",
    }  # fmt: skip
    assert {kernel: known[f"appliance.compensation.{kernel}"] for kernel in kernels} == dict.fromkeys(kernels, 1)
