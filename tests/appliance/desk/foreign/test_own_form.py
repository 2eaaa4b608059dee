"""A foreign set of our own form becomes a scan folder that everything else accepts; any other one is refused with the reason."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.cli.output import Exit
from appliance.desk.foreign.cameras import NO_PORT, ForeignRig
from appliance.desk.foreign.description import parse_description, with_counts
from appliance.desk.foreign.images import ImageSet
from appliance.desk.foreign.own_form import calibration_of, own_frames, own_sequence
from appliance.desk.foreign.points import ForeignScan
from appliance.desk.foreign.problem import ForeignError
from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.patterns import RISING_STEPS, STEPS, PatternSequence
from appliance.measure.light.pinhole import Lens
from appliance.store.ply import read_ply
from tests.support.commands import Shell
from tests.support.foreign_sets import ForeignSet
from tests.support.truth import left_to_rig

Sets = Callable[[str], ForeignSet]


@pytest.mark.dive
def test_two_directions_of_four_steps_become_a_scan_folder(shell: Shell, foreign_set: Sets, tmp_path: Path) -> None:
    made = foreign_set("two-directions")
    said = shell("import", made.description, "--out", tmp_path / "000001", "--json")
    assert (said.code, said.err) == (Exit.OK, "")
    assert (said.document["frames"], said.document["period_px"]) == (22, 32)
    # The instrument's own reconstruction, with its own four-step kernels, of the images in its own order.
    own = shell("cloud", tmp_path / "000001", "--out", tmp_path / "own.ply", "--json")
    assert own.code == Exit.OK, own.err
    points_mm = read_ply(tmp_path / "own.ply").points_mm
    distance = made.renderer.surface(0.0).distance_mm(left_to_rig(made.renderer.truth, points_mm))
    assert float(np.median(np.abs(distance))) < 0.08
    # The general decoder has found nearly the same pixels.
    assert abs(own.document["points"] / said.document["points"] - 1.0) < 0.02
    again = shell("import", made.description, "--out", tmp_path / "000001")
    assert again.code == Exit.FAILED
    assert "exists already" in again.error


def test_a_lens_that_our_files_cannot_hold_is_no_scan_folder() -> None:
    short = HousedCamera(640, 480, Lens((800.0, 800.0), (320.0, 240.0)), NO_PORT)
    long = replace(short, lens=Lens((800.0, 800.0), (320.0, 240.0), (0.1,) * 12), translation_mm=(100.0, 0.0, 0.0))
    said = parse_description(OWN, Path(), "set", "set.toml")
    with pytest.raises(ForeignError, match=r"no scan folder can be made: .* the distortion k1, k2, p1, p2, k3 only"):
        calibration_of(ForeignScan(said, ForeignRig(StereoRig(short, long), 1.0), {}, ()))


OWN = """
[images]
left = "l*"
right = "r*"
order = "bright dark gray-x*7 sine-x*4 gray-y*7 sine-y*4"
[projector]
width_px = 1024
height_px = 768
[x]
period_px = 16
steps = 4
gray = "complementary"
[y]
period_px = 16
steps = 4
gray = "complementary"
[cameras]
"""


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ((), ""),
        ((("gray-x*7", "gray-x*6"),), "x: 6 images of its code, and 7 are needed"),
        ((("bright dark", ""),), "it has no bright and dark image"),
        ((("gray-y*7 sine-y*4", ""), ("[y]\nperiod_px = 16\nsteps = 4\ngray = \"complementary\"\n", "")), "fringes of one direction only, x"),
        ((("sine-x*4", "sine-x*3"), ("steps = 4\ngray = \"complementary\"\n[y]", "steps = 3\ngray = \"complementary\"\n[y]")),
         "x: its steps 0°, 120°, 240° are not the four of 0°, 90°, 180°, 270°"),
        ((("steps = 4\ngray = \"complementary\"\n[y]", "steps = 4\n[y]"),), "x: its code does not count half periods from the edge"),
        ((("steps = 4\ngray", "steps = 4\ncode_offset_px = 8\ngray"),), "x: its code does not count half periods from the edge"),
        ((('right = "r*"\n', ""),), "it has no second camera"),
        ((("sine-x*4", "sine-x*4 sine-x2*4"), ("period_px = 16", "period_px = [16, 64]")), "x: it has 2 periods"),
        ((("period_px = 16", "period_px = 16.5"),), "x: its period is 16.5 px, no whole number"),
        ((("sine-x*4", "modulated-x*12"),), "x: its fringes have a carrier"),
        ((("gray-x*7 ", ""), ("period_px = 16\nsteps = 4\ngray = \"complementary\"", "period_px = 1024\nsteps = 4")), "x: it has no Gray code"),
        ((("steps = 4", "steps = 4\ncode = \"binary\""),), "x: its code is plain binary, or inverted"),
        ((("period_px = 16", "period_px = 32"),), "its two directions have different periods"),
        ((("period_px = 16", "period_px = 3"), ("period_px = 16", "period_px = 3"), ("gray-x*7", "gray-x*9")), "fringe period 3 px; allowed are 4..768 px"),
    ],
)  # fmt: skip
def test_the_reason_why_a_set_is_no_scan_of_our_form_is_named(
    changes: tuple[tuple[str, str], ...], reason: str
) -> None:
    text = OWN
    for before, after in changes:
        assert before in text
        text = text.replace(before, after, 1)
    said = parse_description(text, Path(), "own", "own.toml")
    assert said.order is not None
    images = ImageSet(said.order, (), np.zeros((len(said.order), 2, 2), np.uint8), 255.0)
    found = own_sequence(with_counts(said, said.order), images)
    assert isinstance(found, str) == bool(reason)
    assert reason in str(found)


@pytest.mark.parametrize(
    ("shown", "steps"),
    [("[0, 90, 270, 180]", STEPS), ("[0, 90, 180, 270]", RISING_STEPS), ("[0, 180, 90, 270]", RISING_STEPS)],
)
def test_a_set_keeps_the_order_of_its_steps_where_it_is_one_of_ours(shown: str, steps: tuple[int, ...]) -> None:
    said = parse_description(OWN.replace("steps = 4", f"steps_deg = {shown}"), Path(), "own", "own.toml")
    assert said.order is not None
    images = ImageSet(said.order, (), np.arange(len(said.order), dtype=np.uint8)[:, None, None], 255.0)
    described = with_counts(said, said.order)
    sequence = own_sequence(described, images)
    assert isinstance(sequence, PatternSequence)
    assert sequence.steps == steps
    # Frame 9 is the first step of X; either order of ours leaves the images where they are.
    found = own_frames(sequence, described, images).ravel()[9:13].tolist()
    assert found == ([9, 11, 10, 12] if shown == "[0, 180, 90, 270]" else [9, 10, 11, 12])


def test_images_are_put_into_our_order() -> None:
    """Steps that begin elsewhere, a code with its finest image first, and more images of it than are needed."""
    text = OWN.replace("bright dark", "dark bright").replace("gray-y*7", "gray-y*8")
    text = text.replace("steps = 4", "steps_deg = [180, 90, 0, 270]", 1)
    text = text.replace("steps = 4", 'steps = 4\nsign = "-"\nstart_deg = 90\ncode_order = "fine-first"')
    said = parse_description(text, Path(), "own", "own.toml")
    assert said.order is not None
    images = ImageSet(said.order, (), np.arange(len(said.order), dtype=np.uint8)[:, None, None], 255.0)
    described = with_counts(said, said.order)
    sequence = own_sequence(described, images)
    assert not isinstance(sequence, str), sequence
    wanted = [1, 0, *range(2, 9), 11, 10, 9, 12, *range(19, 12, -1), 22, 21, 24, 23]
    assert own_frames(sequence, described, images).ravel().tolist() == wanted
    assert own_sequence(described, replace(images, images=images.images.astype(np.uint16))) == "its images have 16 bits"
