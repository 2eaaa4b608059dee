"""The small simulated instrument, a diver's script, and what is true of the scans that a dive leaves."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.cli.simrig import SimOptions, apply_options, default_sim_rig
from appliance.measure.accept.ball_bar import BallBar, find_ball_bar
from appliance.measure.calibration.file import Calibration, encode_calibration
from appliance.measure.light.patterns import PatternSequence
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.points.quality import QualityLimits
from appliance.store.config import Rig, load_rig
from appliance.store.instrument import Instrument
from appliance.store.library import Library
from hw_sim.options import options_from
from hw_sim.rendering.render import Renderer
from hw_sim.world import true_rig
from tests.support.truth import left_to_rig, true_calibration

SMALL = default_sim_rig().with_name("small.toml")
BENCH = 'object = "plane"\nobject_pose = [0, 0, 540, 0, 0, 0]\nmedium = "air"\nstills = true\n'


def instrument(folder: Path, script: str, rig_file: Path | None = None, size: str = "400x300", **options: Any) -> Rig:
    """Return a rig whose diver follows ``script`` and whose storage is ``folder / "root"``; other ``options`` are those of ``sim``."""
    path = folder / "dive.script"
    path.write_text(script, encoding="utf-8")
    wanted = SimOptions(root=folder / "root", size=size, script=path, **options)
    return apply_options(load_rig(rig_file or default_sim_rig()), wanted)


class Service:
    """``kingfisher sim`` in a process of its own, whose status is read as anybody may."""

    def __init__(self, root: Path, *options: str, **of_the_process: Any) -> None:
        self._status = root / "run" / "status.json"
        self._status.unlink(missing_ok=True)
        command = [sys.executable, "-m", "appliance.cli", "sim", "--root", str(root), *options]
        self.process = subprocess.Popen(command, **of_the_process)

    def status(self) -> dict[str, Any]:
        """Return the status file; empty while there is none."""
        try:
            return dict(json.loads(self._status.read_text(encoding="utf-8")))
        except (OSError, ValueError):
            return {}


def calibrate_exactly(rig: Rig) -> None:
    """Store the true rig's calibration, as if made on the day before."""
    path = Instrument(rig).calibration_file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(encode_calibration(true_calibration(true_rig(rig.rig.wires_options), rig.rig.serial)))


def off_surface_mm(rig: Rig, scan_id: str, **wires: Any) -> NDArray[np.float64]:
    """Return how far the points of a stored scan are from the true surface; ``wires``: what the world was otherwise then."""
    options = {**rig.rig.wires_options, **wires}
    cloud = Library(rig.storage.root).load(scan_id).cloud()
    assert cloud is not None
    truth = true_rig(options)
    surface = Renderer(truth, options_from(options).scene()).surface(0.0)
    return np.asarray(surface.distance_mm(left_to_rig(truth, cloud.points_mm)))


def ball_bar_mm(calibration: Calibration, sequence: PatternSequence, frames: Mapping[str, NDArray[np.uint8]]) -> float:
    """Return the length of the ball bar in a scan that ``calibration`` may fit badly."""
    with Pipeline(calibration, calibration.water, sequence, QualityLimits(max_gap_mm=20.0)) as pipeline:
        for k in range(len(sequence)):
            for side, taken in frames.items():
                pipeline.push(side, taken, k)
        pipeline.coarse()
        bar = find_ball_bar(pipeline.full())
    assert isinstance(bar, BallBar)
    return bar.length_mm


def at_the_bench(folder: Path, size_px: tuple[int, int], world: str = "", left: str = "") -> Path:
    """Return a rig file before a plane in air, with small cameras; ``world``: further options of the world, ``left``: keys of the left camera."""
    text = SMALL.read_text(encoding="utf-8")
    for old, new in (
        ("/var/tmp/kingfisher-sim", str(folder / "root")),
        ("width_px = 400", f"width_px = {size_px[0]}"),
        ("height_px = 300", f"height_px = {size_px[1]}"),
        ("pixel_um = 18.0", f"pixel_um = {18.0 * 400 / size_px[0]}"),
        ("[rig.wires_options]", f"[rig.wires_options]\n{BENCH}{world}\n"),
        ("[camera.left]", f"[camera.left]\n{left}\n"),
    ):
        assert old in text, old
        text = text.replace(old, new)
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return path
