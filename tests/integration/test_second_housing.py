"""A second housing works by its rig file alone: baseline 120 mm, at 300 mm, with a projector of 1280 × 720; in small pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.cli.simtruth import bring_calibration
from appliance.config import Rig, load_rig
from appliance.service.app import run
from appliance.storage.library import Library, ScanEntry
from appliance.storage.ply import read_ply
from hw_sim.options import options_from
from hw_sim.rendering.render import Renderer
from hw_sim.world import true_rig
from tests.support.truth import left_to_rig

pytestmark = pytest.mark.devices

COMPACT = default_sim_rig().with_name("compact.toml")
PLANE, PIPE = (0.0, 0.0, 300.0, 8.0, 12.0, 0.0), (0.0, 0.0, 336.0, 0.0, 6.0, 20.0)
SCAN = """
press scan
wait state REVIEW 90
pause 2
press scan                  # keep
wait state AIM 60
"""
DIVE = f"""
wait state AIM 90
wait distance 300 6 30      # by the laser dots
{SCAN}
object pipe {" ".join(f"{v:g}" for v in PIPE)}
{SCAN}
pause 0.5
end
"""


def dived(folder: Path, dive: str, changed: Callable[[Rig], Rig] = lambda rig: rig) -> Rig:
    """Return the rig whose storage root is left by a dive."""
    script = folder / "dive.script"
    script.write_text(dive)
    options = SimOptions(
        root=folder / "root",
        object_name="plane",
        texture="none",
        truth="nominal",
        seed=3,
        size="480x300",
        script=script,
    )
    rig = changed(simulated(load_rig(COMPACT), options))
    wires = {**rig.rig.wires_options, "object_pose": list(PLANE)}
    rig = replace(rig, rig=replace(rig.rig, wires_options=wires))
    bring_calibration(rig)
    assert run(rig) == 0
    return rig


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    """A dive in which a plane and a pipe were scanned and kept."""
    return dived(tmp_path_factory.mktemp("second"), DIVE)


def kept(rig: Rig) -> list[ScanEntry]:
    return sorted(Library(rig.storage.root).entries(), key=lambda one: one.scan_id)


@pytest.mark.parametrize(("number", "thing", "pose"), [(0, "plane", PLANE), (1, "pipe", PIPE)])
def test_points_lie_on_the_true_surface(rig: Rig, number: int, thing: str, pose: tuple[float, ...]) -> None:
    entry = kept(rig)[number]
    assert entry.manifest is not None
    record = entry.manifest.record
    assert len(record.sequence.patterns) == 25, "8 + 7 Gray images, 8 sines and two references"
    assert {verdict.name: verdict.passed for verdict in record.verdicts if verdict.name in ("identity", "sides")} == {
        "identity": True,
        "sides": True,
    }
    wires = {**rig.rig.wires_options, "object": thing, "object_pose": pose}
    truth = true_rig(wires)
    points = left_to_rig(truth, read_ply(entry.folder / "cloud.ply").points_mm)
    off_mm = Renderer(truth, options_from(wires).scene()).surface(0.0).distance_mm(points)
    assert len(points) > 50_000
    assert float(np.sqrt(np.mean(off_mm**2))) < 0.03
    assert 265.0 < float(np.median(points[:, 2])) < 335.0


def test_exchanged_serial_numbers_are_named_after_the_first_scan(tmp_path: Path) -> None:
    def exchanged(rig: Rig) -> Rig:
        left, right = rig.camera.left, rig.camera.right
        cameras = replace(rig.camera, left=replace(left, serial=right.serial), right=replace(right, serial=left.serial))
        return replace(rig, camera=cameras)

    dive = f"wait state AIM 90\n{SCAN.replace('pause 2', 'wait alert SIDES_EXCHANGED 30')}pause 0.5\nend\n"
    (entry,) = kept(dived(tmp_path, dive, exchanged))
    assert entry.manifest is not None
    verdict = next(one for one in entry.manifest.record.verdicts if one.name == "sides")
    assert verdict.passed is False
    assert "exchange the serial numbers" in verdict.text
