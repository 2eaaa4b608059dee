"""Owns the steps that are read from one measurement of the projector, and the keys that it writes into the rig file."""

from __future__ import annotations

import numpy as np

from appliance.bringup.bench import Bench, Shot, mean_levels
from appliance.bringup.conclusions import conclusions, keys_of
from appliance.bringup.guide import StepOutcome
from appliance.bringup.person import MOST_ASKED, numbered
from appliance.bringup.projector import measure_projector
from appliance.bringup.projector_steps import projector_outcomes
from appliance.bringup.rig_edit import KeyValue, replace_rig, with_keys
from appliance.service.bringup.workplace import Workplace
from appliance.service.light_bench import bench_on

WHITE_FRAMES = 12
"""Frames of white, as of black before them: more than the most blanks that a picture's light comes late."""
LEAST_LIGHT_DN = 4.0
"""Difference of an image's mean between black and white pictures from which something that is lit is seen."""


def projector_steps(at: Workplace) -> dict[str, StepOutcome]:
    """Do the measurement; the outcome of each step of the projector. Raises DeviceError, BringupError, GivenUp, StorageError."""
    with bench_on(at.rig, at.wires) as bench:
        return _measured(at, bench)


def _measured(at: Workplace, bench: Bench) -> dict[str, StepOutcome]:
    rig = at.rig
    # Before minutes of measuring: a file that cannot be read is known by then.
    text = at.rig_file.read_text(encoding="utf-8-sig")
    _before_white(at, bench)
    measured = measure_projector(bench, rig.scan.most_gain_db, at.say)
    written: dict[KeyValue, int | str | float | tuple[float, ...]] = {}
    findings = conclusions(measured, rig.projector.refresh_hz)
    # All or nothing: a mirrored picture's latency is right, but who puts it right measures again.
    if all(one.ok for one in findings):
        written = keys_of(measured, rig.projector.refresh_hz, rig.camera.left.exposure_ms)
        new = with_keys(text, written)
        if new != text:
            replace_rig(at.rig_file, text, new)
    return projector_outcomes(measured, rig.projector.refresh_hz, written)


def _before_white(at: Workplace, bench: Bench) -> None:
    """Ask for a white wall until the projector's light is seen on it by both cameras; at most so often, then it is tried as it is."""
    for turn in range(MOST_ASKED):
        at.person.ask(numbered(f"{wall(at)}, and darken the room", turn))
        at.say("looking for the projector's light", None)
        if _lit(at, bench):
            return


def wall(at: Workplace) -> str:
    """Return where the instrument is to stand for everything that is measured with its light."""
    return (
        "take the caps off and stand the instrument still before something white and flat, "
        f"{at.plane_mm:.0f} mm away and upright, that fills both images"
    )


def _lit(at: Workplace, bench: Bench) -> bool:
    """Tell whether both cameras see the projector's light at all."""
    width, height = bench.size_px
    bench.load([np.full((height, width), code, np.uint8) for code in (0, 255)], all_channels=False)
    # The latency is not known yet: enough frames of each that it does not matter.
    shot = Shot(at.rig.board.trigger_delay_us, round(1000.0 * at.rig.camera.left.exposure_ms))
    seen = bench.take([0] * WHITE_FRAMES + [1] * WHITE_FRAMES, shot)
    levels = [mean_levels(images, np.ones(images.shape[1:], np.bool_)) for images in seen.values()]
    return all(float(one.max() - one.min()) > LEAST_LIGHT_DN for one in levels)
