"""A script at the desk gets the points of the instrument, and others where it asks for another calibration or other water."""

from __future__ import annotations

import ast
import importlib
import inspect
import pydoc
import re
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from appliance.calibrate.calibrations import Calibrations
from appliance.desk.scripting import export, open_dive, open_scan, save_calibration
from appliance.desk.surface.fusion import PlacedScan, fuse
from appliance.desk.surface.mesh import mesh_of_scan
from appliance.measure.calibration.file import CalibrationError, encode_calibration
from appliance.measure.light.water import Water
from appliance.measure.verdict import Grade, Verdict
from appliance.store.instrument import Instrument, load_calibration
from appliance.store.library import Library, UnknownScan
from appliance.store.scan import ScanError
from tests.appliance.store.scenes import ORIGIN, frames, record
from tests.support.commands import ROOT, notebook_says
from tests.support.planes import small_rig, store_plane

PACKAGE = importlib.import_module("kingfisher")
Dive = tuple[Path, NDArray[np.float32]]


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Dive:
    """A storage root with one scan and its calibration, and the points that the instrument had."""
    rig = small_rig(tmp_path_factory.mktemp("dive"))
    folder, points = store_plane(rig)
    Calibrations(rig.storage.root, rig.rig.serial).install(Instrument(rig).design(), "2026-01-01")
    return folder.parent.parent, points


def test_a_dive_gives_the_points_of_the_instrument_and_what_is_known_of_them(dive: Dive) -> None:
    root, points = dive
    opened = open_dive(str(root))
    assert ([scan.name for scan in opened], len(opened)) == (["000001"], 1)
    scan = opened.scan(1)
    assert scan == opened[1] == opened.scan("000001")
    made = scan.points()
    np.testing.assert_array_equal(made.points_mm, points)
    assert (made.sigma_mm.shape, made.cloud.shape) == ((len(points),), (300, 400))
    assert open_scan(scan.folder).name == "000001"
    stored = np.load(scan.folder / "frames_right.npy")
    np.testing.assert_array_equal(scan.frames("right"), stored)
    assert not np.array_equal(scan.frames(), stored)
    with pytest.raises(ScanError, match="one exposure"):
        scan.frames(second=True)
    said = scan.manifest.record
    assert (said.sequence.period_px, said.sequence.patterns[0]) == (16, "bright")
    assert scan.time == (None if said.wall_time is None else datetime.fromisoformat(said.wall_time))
    assert (scan.object, scan.exposure, scan.warnings) == (said.object, said.exposure, ())
    assert re.fullmatch(rf"<scan 000001: ({len(points):,}|no) points.*>", repr(scan))
    assert repr(opened) == f"<dive {root}: 1 scans>"
    assert re.fullmatch(rf"<{len(points):,} points, \d+ µm>", repr(made))


def test_another_calibration_and_other_water_give_other_points(dive: Dive, tmp_path: Path) -> None:
    root, points = dive
    scan = open_dive(root).scan("000001")
    salt, own = scan.points(water=Water(20.0, 35.0, 530.0)), scan.points()
    both = salt.cloud.mask & own.cloud.mask
    # Behind a flat port tan θ goes down as the index goes up, so that the same pixels see a smaller piece of the plane.
    share = salt.water.index / Water(20.0, 0.0, 530.0).index - 1.0
    narrower = 1.0 - salt.cloud.points_mm[both, 0].std() / own.cloud.points_mm[both, 0].std()
    assert 0.5 * share < narrower < 1.5 * share
    design = Instrument(small_rig(root)).design()
    left = replace(design.rig.left, port=replace(design.rig.left.port, distance_mm=33.0))
    other = replace(design, method="bundle", rig=replace(design.rig, left=left))
    (tmp_path / "other.json").write_bytes(encode_calibration(other))
    by_value, by_path = scan.points(calibration=other), scan.points(calibration=str(tmp_path / "other.json"))
    np.testing.assert_array_equal(by_value.points_mm, by_path.points_mm)
    assert abs(by_value.points_mm[:, 2].max() - points[:, 2].max()) > 0.2
    larger = replace(other, rig=replace(other.rig, left=replace(left, width_px=800)))
    with pytest.raises(CalibrationError, match="800x300"):
        scan.points(calibration=larger)


def test_what_the_diver_read_is_said(tmp_path: Path) -> None:
    library = Library(tmp_path)
    library.prepare()
    judged = (
        Verdict("motion", False, {}, "MOVED: 0.4 px"), Verdict("ledger", True), Verdict("light", False), Verdict("sides", None),
        Verdict("grade", None, {}, "usable"),
    )  # fmt: skip
    # Its numbers alone are good ones: the grade is what the diver read.
    kept = record(verdicts=judged, cloud={"points": 282679.0, "noise_mm": 0.021, "coverage_percent": 90.0})
    library.begin(frames(1), kept, ORIGIN).publish(kept)
    scan = open_dive(tmp_path)[1]
    assert (scan.warnings, scan.verdicts, scan.grade) == (("motion: MOVED: 0.4 px", "light"), judged, Grade.USABLE)
    assert repr(scan) == "<scan 000001: 282,679 points, 21 µm, usable>"


def test_each_kind_of_result_is_written_and_a_calibration_once(dive: Dive, tmp_path: Path) -> None:
    made = open_dive(dive[0]).scan(1).points()
    mesh = mesh_of_scan(made.cloud)
    for what, name in ((made, "scan.ply"), (made.cloud, "cloud.ply"), (mesh, "mesh.ply")):
        export(what, str(tmp_path / name))
        read: Any = trimesh.load(tmp_path / name, process=False)
        assert len(read.vertices) > 0.9 * len(dive[1])
    surface = fuse([PlacedScan(made.cloud, np.eye(3), np.zeros(3))], spacing_mm=2.0)
    export(surface, tmp_path / "surface.ply", title="plane")
    assert b"plane: unit mm, object frame" in (tmp_path / "surface.ply").read_bytes()[:300]
    calibration, path = Instrument(small_rig(tmp_path)).design(), tmp_path / "mine.json"
    save_calibration(calibration, str(path))
    with pytest.raises(CalibrationError, match="never replaced"):
        save_calibration(replace(calibration, made_at="2031-01-01"), path)
    assert load_calibration(str(path)) == calibration


def test_what_is_not_there_or_damaged_is_said(dive: Dive, tmp_path: Path) -> None:
    with pytest.raises(NotADirectoryError, match="storage root"):
        open_dive(tmp_path / "none")
    with pytest.raises(UnknownScan):
        open_dive(dive[0]).scan(99)
    with pytest.raises(ScanError):
        open_scan(tmp_path)
    folder, _ = store_plane(small_rig(tmp_path))
    path = folder / "frames_left.npy"
    path.chmod(0o644)
    raw = path.read_bytes()
    path.write_bytes(raw[:5000] + bytes([raw[5000] ^ 1]) + raw[5001:])
    with pytest.raises(ScanError, match="frames_left"):
        open_scan(folder).points()


def test_every_name_of_the_package_is_the_programs_own_and_in_its_help() -> None:
    tree = ast.parse((ROOT / "appliance/desk/python/kingfisher/__init__.py").read_text())
    typed = {
        alias.asname: (node.module, alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module != "__future__"
        for alias in node.names
        if alias.asname
    }
    assert typed.keys() == set(dir(PACKAGE)) - {"__version__"}, "type checkers see what there is"
    for name, (module, attribute) in typed.items():
        assert module is not None
        own = getattr(importlib.import_module(module), attribute)
        assert inspect.unwrap(getattr(PACKAGE, name)) is own, name
    with pytest.raises(AttributeError, match="opendive"):
        _ = PACKAGE.opendive
    doc = PACKAGE.__doc__ or ""
    for name in set(PACKAGE.__all__) - {"__version__"}:
        assert re.search(rf"\b{name}\b", doc), name
    # What `help` prints for a module without `__all__` has no name that it loads when it is asked for.
    text = pydoc.plain(pydoc.render_doc(PACKAGE))
    for name in ("open_dive(", "export(", "class Dive(", "class ScanOfDive("):
        assert f"\n    {name}" in text


def test_the_page_names_what_there_is_and_calls_functions_as_they_are() -> None:
    page = (ROOT / "docs/python.md").read_text()
    for name in dir(PACKAGE):
        if not name.startswith(("Report", "__")) and not name.endswith("Error"):
            assert f"`{name}" in page or f" {name}" in page or f"{name}`" in page, name
    called = re.findall(r"`(\w+)\(([^`]*)\)`", page)
    of_package = [(name, words) for name, words in called if name in PACKAGE.__all__]
    assert len(of_package) > 15
    for name, words in of_package:
        parameters = inspect.signature(getattr(PACKAGE, name)).parameters
        for k, word in enumerate(filter(None, re.split(r", (?![^(]*\))", words))):
            if word != "…":
                named = word.partition("=")[0]
                assert named in parameters, f"{name}: {named}"
                assert "=" in word or list(parameters)[k] == named, f"{name}: {named} is not number {k}"


def test_the_notebook_runs_from_the_first_cell_to_the_last(
    dive: Dive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("KINGFISHER_ROOT", str(dive[0]))
    monkeypatch.chdir(tmp_path)
    said = notebook_says("first_scan.ipynb")
    # A plane by itself slides along itself.
    for words in (f"{len(dive[1])} points", "seen 2 times", "accepted: False", "1 placed, left out: ["):
        assert words in said
    assert {"first.stl", "first.npz", "first.html"} == {path.name for path in tmp_path.iterdir()}
