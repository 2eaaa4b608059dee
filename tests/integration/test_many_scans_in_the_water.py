"""A dive along a metre of pipe with a flange: a numbered object, the overlap on the screen, and one call at the desk.

Fourteen scans, held by hand, with keys alone. Once the diver goes too far, reads NO OVERLAP: GO BACK, and goes back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from appliance.calibration.file import encode
from appliance.cli.main import main
from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.config import Rig, load_rig
from appliance.machine.words import english
from appliance.screens.painter import Painter
from appliance.screens.views import AimView, AnyView, ReviewView
from appliance.service.app import run
from appliance.storage import objects
from appliance.storage.library import Library, LibraryFolder
from appliance.storage.manifest import read
from hw_sim.objects.motion import pose_matrix
from hw_sim.world import true_rig
from tests.support.truth import left_to_rig, true_calibration

pytestmark = pytest.mark.dive

SCANS, TOO_FAR = 14, 6
END_MM, JUMP_MM, DISTANCE_MM = 400.0, 330.0, 550.0
CPU_S = 0.5
"""Of the overlap, as the worker measures it itself. A processor that others use at the same time is slower, and still within twice that."""
BEGIN = """
wait state AIM 120
press back                # UNCALIBRATED: seen
pause 0.5
press up
wait state MENU 5
press down
press down
press down
press down
press scan
press up                  # 1 NEW
press scan
press back
wait state AIM 5
"""
Array = NDArray[np.float64]


def held() -> list[tuple[float, ...]]:
    """Poses of the main in the rig's frame, one for each scan: along its axis, each a hand's breadth on, shaken; the one that is too far in its
    place."""
    rng = np.random.default_rng(4)
    along = list(np.linspace(-END_MM, END_MM, SCANS))
    along.insert(TOO_FAR, along[TOO_FAR - 1] + JUMP_MM)
    poses = []
    for x in along:
        turned = tuple(rng.normal(size=3) * 4.0)
        R, _ = pose_matrix((0.0, 0.0, 0.0, *turned))
        at = np.array([0.0, 0.0, DISTANCE_MM]) + rng.normal(size=3) * (6.0, 6.0, 8.0) - R @ np.array([x, 0.0, 0.0])
        poses.append((*map(float, at), *map(float, turned)))
    return poses


def script(poses: Sequence[tuple[float, ...]]) -> str:
    lines, kept = [BEGIN], 0
    for number, pose in enumerate(poses):
        lines.append("motion tremor_mm=0.03,0.03,0.03" if number == 3 else "motion off")
        lines.append("object main " + " ".join(f"{value:.3f}" for value in pose))
        lines += ["pause 0.3", "press scan", "wait state REVIEW 90"]
        if number == TOO_FAR:
            lines += ["wait overlap NO* 60", "press back 1", "wait state AIM 20"]
        else:
            kept += 1
            lines += (["wait overlap OVERLAP* 60"] if number else []) + [
                "press scan",
                f"wait scans {kept} 60",
                "wait state AIM 60",
            ]
    return "\n".join([*lines, "end", ""])


@dataclass(frozen=True)
class Dive:
    rig: Rig
    shown: tuple[tuple[int, str], ...]
    """Words about the overlap as they were drawn, each with the number of its review in the dive, from 0."""
    aimed: tuple[str, ...]
    """The same on the screen for aiming."""
    poses: tuple[tuple[float, ...], ...]

    @property
    def library(self) -> Library:
        return Library(self.rig.storage.root)


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Dive:
    folder = tmp_path_factory.mktemp("pipe")
    poses = held()
    (folder / "dive.script").write_text(script(poses))
    options = SimOptions(
        root=folder / "root", object_name="main", texture="slight", truth="nominal", seed=3, size="400x300",
        script=folder / "dive.script",
    )  # fmt: skip
    rig = simulated(load_rig(default_sim_rig()), options)
    shown: list[tuple[int, str]] = []
    aimed: list[str] = []
    reviews, before = -1, ""
    draw = Painter.draw

    def drawn(painter: Painter, view: AnyView, time_s: float) -> NDArray[np.uint8]:
        nonlocal reviews, before
        reviews += isinstance(view, ReviewView) and before != "ReviewView"
        before = type(view).__name__
        if isinstance(view, ReviewView | AimView) and view.overlap is not None:
            words = english(view.overlap.words)
            if isinstance(view, AimView):
                aimed.append(words)
            else:
                shown.append((reviews, words))
        return draw(painter, view, time_s)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Painter, "draw", drawn)
        assert run(rig) == 0
    return Dive(rig, tuple(dict.fromkeys(shown)), tuple(dict.fromkeys(aimed)), tuple(poses))


def points(dive: Dive, scan: str) -> Array:
    cloud = dive.library.load(scan).cloud()
    assert cloud is not None
    return left_to_rig(true_rig(dive.rig.rig.wires_options), cloud.points_mm)


def in_the_object(points_mm: Array, pose: Sequence[float]) -> Array:
    R, t = pose_matrix(tuple(pose))
    return np.asarray((points_mm - t) @ R)


def test_every_scan_that_was_kept_carries_the_objects_number(dive: Dive) -> None:
    entries = dive.library.entries()
    assert len(entries) == SCANS
    assert [entry.ok for entry in entries] == [True] * SCANS
    assert {entry.manifest.record.object for entry in entries if entry.manifest is not None} == {1}
    (rejected,) = dive.library.entries(LibraryFolder.REJECTED)
    assert read(rejected.folder).record.object == 1


def test_the_screen_says_the_true_overlap_and_sends_back_who_went_too_far(dive: Dive) -> None:
    said = dict(dive.shown)
    assert len(said) == len(dive.shown), "one thing is said of each scan"
    assert said.pop(TOO_FAR) == "NO OVERLAP: GO BACK"
    of_kept = [number for number in range(len(dive.poses)) if number != TOO_FAR]
    assert sorted(said) == of_kept[1:], "of each scan but the first"
    kept = [pose for number, pose in enumerate(dive.poses) if number != TOO_FAR]
    clouds = [in_the_object(points(dive, scan), pose) for scan, pose in zip(dive.library.ids(), kept, strict=True)]
    for number in range(1, SCANS):
        distance, _ = cKDTree(clouds[number - 1]).query(clouds[number][::20], distance_upper_bound=3.0)
        true_percent = 100.0 * np.isfinite(distance).mean()
        assert 30.0 < true_percent < 95.0, "the track is what it is meant to be"
        overlap, percent, _ = said[of_kept[number]].split()
        assert overlap == "OVERLAP"
        assert float(percent) == pytest.approx(true_percent, abs=5.0)
    assert "NO OVERLAP: GO BACK" not in dive.aimed, "a scan that was rejected is not spoken of any more"


def test_the_overlap_costs_the_worker_less_than_it_may(dive: Dive) -> None:
    spent = [
        entry.manifest.record.stage_times_s["overlap_cpu"]
        for entry in dive.library.entries()[1:]
        if entry.manifest is not None
    ]
    assert len(spent) == SCANS - 1
    assert float(np.median(spent)) < CPU_S


def test_one_call_at_the_desk_makes_points_mesh_and_page_of_it(dive: Dive, tmp_path: Path) -> None:
    root = dive.rig.storage.root
    truth = tmp_path / "truth.json"
    truth.write_bytes(encode(true_calibration(true_rig(dive.rig.rig.wires_options))))
    outs = [tmp_path / name for name in ("object.e57", "object.stl", "report.html")]
    words = ["object", "solve", "pipe", "--taken-as", "1", "--root", str(root), "--spacing", "1"]
    words += ["--calibration", str(truth), "--foreign-calibration"]
    assert main([*words, *(word for out in outs for word in ("--out", str(out)))]) == 0
    assert [out.stat().st_size > 10_000 for out in outs] == [True] * 3
    stored = objects.read(root, "pipe")
    assert stored.places is not None
    assert list(stored.places.places) == dive.library.ids()
    ends = [np.array(stored.places.places[scan].middle_mm) for scan in (dive.library.ids()[0], dive.library.ids()[-1])]
    kept = [pose for number, pose in enumerate(dive.poses) if number != TOO_FAR]
    true_ends = [
        np.median(in_the_object(points(dive, scan), pose), axis=0)
        for scan, pose in ((dive.library.ids()[0], kept[0]), (dive.library.ids()[-1], kept[-1]))
    ]
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(
        float(np.linalg.norm(true_ends[1] - true_ends[0])), abs=6.0
    )
