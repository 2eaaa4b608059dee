"""What does it cost to compare a scan with a CAD model, and to place seven scans? Processor time, memory, and whether one scan has one answer."""

from __future__ import annotations

import multiprocessing
import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from appliance.offline.comparing import NominalSurface, compare
from appliance.offline.objects import light_of
from appliance.registration.pair import ready
from appliance.registration.rigid import Rigid
from appliance.registration.solve import solve
from appliance.surface.nominal import read_nominal
from bench.merge.row import poses_along
from bench.result import Measured
from tests.support import synthetic
from tests.support.flanged import TRUE, cloud, finer, pipe, view
from tests.support.views import view as scan_of

POINTS, FEW = 220_000, 2_000
TOLERANCE_MM = 0.1
FAR_MM = np.array([3e5, 0.0, 0.0])
SIZE_PX = (400, 300)
SEED, ROW, SCANS = 3, 21, slice(7, 14)
"""Seven neighbours of a row along the main."""
TIMEOUT_S = 900.0
CASES = ("searched for", "started at the truth", "frame 300 m off", "finer triangles")
SEARCH_CPU_S, START_CPU_S, MEMORY_MB, OUT_PERCENT, SOLVE_CPU_S = 15.0, 6.0, 700.0, 0.05, 40.0


def measure() -> Iterator[Measured]:
    """Each comparison and the solution in a process of its own: the largest memory of a process never gets smaller."""
    for case in CASES:
        cpu_s, memory_mb, out_percent = _alone(_compared, case)
        most_s = SEARCH_CPU_S if case == CASES[0] else START_CPU_S
        yield Measured(f"compared, {case}: CPU", cpu_s, "s", at_most=most_s)
        yield Measured(f"{case}: largest memory", memory_mb, "MB", at_most=MEMORY_MB)
        yield Measured(f"{case}: beyond {TOLERANCE_MM:g} mm", out_percent, "%", at_most=OUT_PERCENT)
    cpu_s, memory_mb, placed = _alone(_solved, "main")
    yield Measured(f"seven scans of {SIZE_PX[0]} x {SIZE_PX[1]} px, placed: CPU", cpu_s, "s", at_most=SOLVE_CPU_S)
    yield Measured("placed: largest memory", memory_mb, "MB", at_most=MEMORY_MB)
    yield Measured("placed: scans", placed, "", at_least=7)


def _alone(step: Callable[[str], tuple[float, float]], case: str) -> tuple[float, float, float]:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        cpu_s, found = pool.apply_async(step, (case,)).get(timeout=TIMEOUT_S)
        memory_mb = pool.apply_async(_largest_memory_mb).get(timeout=TIMEOUT_S)
    return cpu_s, memory_mb, found


def _largest_memory_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _compared(case: str) -> tuple[float, float]:
    by_mm = FAR_MM if case == CASES[2] else np.zeros(3)
    vertices, faces = finer() if case == CASES[3] else pipe(256)
    start = None if case == CASES[0] else Rigid(TRUE.rotation, TRUE.translation_mm + by_mm)
    model: Any = trimesh.Trimesh(vertices + by_mm, faces, process=False)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "pipe.obj"
        model.export(file)
        for points in (FEW, POINTS):  # few first: compiling is not measured
            seen, begun = cloud(view(20.0, 200.0, points)), time.process_time()
            found = compare(seen, NominalSurface("pipe", read_nominal(file)), start=start)
            cpu_s = time.process_time() - begun
            out = ~(np.abs(found.deviation.deviation_mm) <= TOLERANCE_MM)
    return cpu_s, 100.0 * float(np.mean(out))


def _solved(name: str) -> tuple[float, float]:
    calibration = synthetic.calibration(*SIZE_PX)
    poses = poses_along(SEED, ROW, 0)[SCANS]
    clouds = [scan_of(name, pose, "slight", SEED + k, calibration).cloud for k, pose in enumerate(poses)]
    for count in (2, len(clouds)):
        begun = time.process_time()
        scans = [
            ready(one, calibration.rig.left, synthetic.WATER.index, light_of(calibration)) for one in clouds[:count]
        ]
        placed = solve(scans, lambda *_: None).placed.poses
    return time.process_time() - begun, float(len(placed))
