"""Cost of forty scans of full size: poses, surface, mesh, deviations and files, each in its own process.

The scans are ideal ones (exact rays, noise along them), because their frames would take an hour to render; the cost is
the same.
"""

from __future__ import annotations

import multiprocessing
import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import numpy as np

from appliance.desk.export.content import OBJECT_FRAME, Metadata
from appliance.desk.export.files import write_mesh, write_scans, write_surface
from appliance.desk.objects import light_of
from appliance.desk.registration.solve import solve
from appliance.desk.surface.deviation import deviations
from appliance.desk.surface.fusion import FusedCloud, PlacedScan, fuse
from appliance.desk.surface.mesh import Mesh
from appliance.desk.surface.nominal import nominal_of_mesh
from appliance.desk.surface.object_mesh import mesh_of_surface
from appliance.measure.overlap.pair import ready
from appliance.measure.overlap.rigid import Rigid
from appliance.measure.points.organised import OrganisedCloud
from bench.merge.row import poses_along
from bench.result import Measurement
from bench.spread import spread
from tests.support import synthetic
from tests.support.views import view

FORTH, BACK = 21, 19
SIZE_PX = (1600, 1200)
SPACING_MM = 0.3
SOLVE_CPU_S = 240.0
MEMORY_MB = 1500.0
LITTLE = 2
ABOUT = Metadata("pipe", OBJECT_FRAME)


def measure(seed: int, keep: Path | None) -> list[Measurement]:
    """Return CPU time and largest memory of each step."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = keep or Path(temporary)
        poses = poses_along(seed, FORTH, BACK)
        list(spread(partial(_seen, folder=folder, seed=seed), list(enumerate(poses))))
        count = len(poses)
        measured: list[Measurement] = []
        steps: list[tuple[str, Callable[[Path, int], dict[str, float]], float | None]] = [
            ("placing", _place, SOLVE_CPU_S),
            ("one surface", _fuse, None),
            ("its mesh", _mesh, None),
            ("its deviations", _deviate, None),
            ("its points as PLY, E57 and LAS", _write_points, None),
            ("its mesh as PLY, STL and OBJ", _write_meshes, None),
            ("its scans as NPZ", _write_grids, None),
        ]
        for name, step, limit in steps:
            # A process each: the largest memory of a process never gets smaller.
            with multiprocessing.get_context("spawn").Pool(1) as pool:
                result = pool.apply_async(partial(_measured, step), (folder, count)).get(timeout=3600.0)
            measured.append(
                Measurement(f"{count} scans of full size, {name}: CPU", result.pop("cpu_s"), "s", at_most=limit)
            )
            measured.append(Measurement(f"{name}: largest memory", result.pop("memory_mb"), "MB", at_most=MEMORY_MB))
            measured += [Measurement(f"{name}: {what}", value, "") for what, value in result.items()]
        return measured


def _measured(step: Callable[[Path, int], dict[str, float]], folder: Path, count: int) -> dict[str, float]:
    # Once on little, so that compiling is not measured.
    step(folder, LITTLE)
    begun = time.process_time()
    result = step(folder, count)
    cpu_s = time.process_time() - begun
    return {**result, "cpu_s": cpu_s, "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0}


def _file(folder: Path, number: int) -> Path:
    return folder / f"large-{number}.npz"


def _seen(item: tuple[int, tuple[float, ...]], folder: Path, seed: int) -> None:
    number, pose = item
    file = _file(folder, number)
    if file.exists():
        return
    ideal = view("main", pose, "slight", 1000 * seed + number, synthetic.calibration(*SIZE_PX))
    cloud = ideal.cloud
    draft = file.with_suffix(".draft")
    with draft.open("wb") as opened:
        np.savez(
            opened, points=cloud.points_mm, sigma=cloud.sigma_mm, grey=cloud.grey,
            rotation=ideal.place.rotation, translation=ideal.place.translation_mm,
        )  # fmt: skip
    draft.replace(file)


def _read(folder: Path, number: int) -> tuple[OrganisedCloud, Rigid]:
    with np.load(_file(folder, number)) as stored:
        sigma = stored["sigma"]
        nothing = np.full(sigma.shape, np.nan, np.float32)
        cloud = OrganisedCloud(stored["points"], sigma, nothing, nothing, stored["grey"])
        return cloud, Rigid(stored["rotation"], stored["translation"])


def _place(folder: Path, count: int) -> dict[str, float]:
    calibration = synthetic.calibration(*SIZE_PX)
    scans, points = [], 0
    for number in range(count):
        cloud, _ = _read(folder, number)
        points += int(cloud.mask.sum())
        scans.append(ready(cloud, calibration.rig.left, synthetic.WATER.index, light_of(calibration)))
    solved = solve(scans, lambda *_: None)
    return {"points a scan": points / count, "pairs": len(solved.compared), "placed": len(solved.placed.poses)}


def _placed(folder: Path, number: int) -> PlacedScan:
    cloud, place = _read(folder, number)
    return PlacedScan(cloud, place.rotation, place.translation_mm)


def _fuse(folder: Path, count: int) -> dict[str, float]:
    surface = fuse((_placed(folder, number) for number in range(count)), SPACING_MM)
    np.savez(
        folder / "surface.npz",
        **{name: getattr(surface, name) for name in ("points_mm", "normals", "sigma_mm", "grey", "views")},
    )
    return {"points": len(surface.grey)}


def _surface(folder: Path, count: int) -> FusedCloud:
    with np.load(folder / "surface.npz") as stored:
        every = max(1, FORTH + BACK - count)
        return FusedCloud(*(stored[name][::every] for name in ("points_mm", "normals", "sigma_mm", "grey", "views")))


def _mesh(folder: Path, count: int) -> dict[str, float]:
    mesh = mesh_of_surface(_surface(folder, count), 2.0 * SPACING_MM)
    np.savez(folder / "mesh.npz", **{mesh_field.name: getattr(mesh, mesh_field.name) for mesh_field in fields(mesh)})
    return {"triangles": len(mesh.faces)}


def _deviate(folder: Path, count: int) -> dict[str, float]:
    surface = _surface(folder, count)
    nominal = nominal_of_mesh(mesh_of_surface(_surface(folder, 2), 4.0))
    compared = deviations(surface.points_mm, surface.sigma_mm, nominal, surface.normals)
    return {"points compared": compared.summary.points}


def _write_points(folder: Path, count: int) -> dict[str, float]:
    surface, size = _surface(folder, count), 0.0
    for suffix in (".ply", ".e57", ".las"):
        path = folder / f"points{suffix}"
        write_surface(path, surface, ABOUT)
        size += path.stat().st_size / 1e6
    return {"MB": size}


def _write_meshes(folder: Path, count: int) -> dict[str, float]:
    with np.load(folder / "mesh.npz") as stored:
        mesh = Mesh(**{name: stored[name] for name in stored.files})
    # The first call is only there to have everything loaded.
    mesh = mesh if count > LITTLE else replace(mesh, faces=mesh.faces[:1000])
    size = 0.0
    for suffix in (".ply", ".stl", ".obj"):
        path = folder / f"mesh{suffix}"
        write_mesh(path, mesh, ABOUT)
        size += path.stat().st_size / 1e6
    return {"MB": size}


def _write_grids(folder: Path, count: int) -> dict[str, float]:
    def grids() -> Iterator[PlacedScan]:
        for number in range(count):
            scan = _placed(folder, number)
            yield replace(scan, name=f"{number + 1:06}", covariance=np.zeros((6, 6)), middle_mm=np.zeros(3))

    path = folder / "grids.npz"
    write_scans(path, grids(), ABOUT)
    return {"MB": path.stat().st_size / 1e6}
