"""Faults of the manual that touch a sequence, as they show on the wires of a second, small host."""

from __future__ import annotations

import numpy as np
import pytest

from tests.hw_sim.conftest import Bench
from tests.hw_sim.devices.host import GotFrame, Recorder, good

COUNT = 8
ALL = list(range(COUNT))


@pytest.fixture
def recorder(bench: Bench) -> Recorder:
    return bench.recorder(patterns=COUNT)


def ids(frames: list[GotFrame | str]) -> list[int]:
    return [f.block_id for f in good(frames)]


def shades(frames: list[GotFrame | str]) -> list[float]:
    return [float(f.image.mean()) for f in good(frames)]


@pytest.mark.parametrize(
    ("fault", "left", "right"),
    [
        ("camera.left intermittent frame=3", [0, 1, 2, 4, 5, 6, 7], ALL),
        ("camera.right intermittent count=3", ALL, [3, 4, 5, 6, 7]),
        ("camera.left wrong how=repeat frame=3", [0, 1, 2, 3, 3, 4, 5, 6, 7], ALL),
        ("camera.left wrong how=swap frame=3", [0, 1, 2, 4, 3, 5, 6, 7], ALL),
        ("camera.left wrong how=swap frame=7", [0, 1, 2, 3, 4, 5, 7, 6], ALL),
        ("board intermittent frame=3", ALL[:-1], ALL[:-1]),
        ("board wrong how=reset frame=4", ALL[:4], ALL[:4]),
    ],
)
def test_frames_are_lost_sent_twice_or_change_places_once(
    bench: Bench, recorder: Recorder, fault: str, left: list[int], right: list[int]
) -> None:
    bench.world.fault(fault)
    got = recorder.record(frames=COUNT + 1)
    assert (ids(got["left"]), ids(got["right"])) == (left, right)
    assert got["right"][-1] == "USBTimeoutError"
    for side in got:
        by_id = [float(f.image.mean()) for f in sorted(good(got[side]), key=lambda f: f.block_id)]
        assert by_id == sorted(by_id), "the pictures belong to their numbers"


def test_damage_to_one_part_of_a_frame_leaves_the_others_in_step(bench: Bench, recorder: Recorder) -> None:
    for number, part in enumerate(("leader", "trailer", "truncate")):
        bench.world.fault(f"camera.left garbage how={part} frame={number + 2}")
    frames = [f for f in recorder.record()["left"] if isinstance(f, GotFrame)]
    assert [f.leader[:4] == b"U3VL" for f in frames] == [k != 2 for k in ALL]
    assert [f.trailer[:4] == b"U3VT" for f in frames] == [k != 3 for k in ALL]
    assert [len(f.payload) == bench.size for f in frames] == [k != 4 for k in ALL]
    assert 0.4 * bench.size < len(frames[4].payload) == frames[4].valid < 0.6 * bench.size
    assert len(good(recorder.record()["left"])) == COUNT, "once means once"


def test_a_stuck_camera_counts_on_with_the_same_image(bench: Bench, recorder: Recorder) -> None:
    bench.world.fault("camera.left stuck frame=4")
    got = recorder.record()
    frames, right = good(got["left"]), shades(got["right"])
    assert [f.block_id for f in frames] == ALL
    assert [(f.image == frames[3].image).all() for f in frames] == [k >= 3 for k in ALL]
    assert np.diff([f.time_ns for f in frames]).min() > 16e6, "its clock goes on"
    assert right == sorted(right)
    assert right[-1] > right[4]


def test_a_camera_a_flip_or_the_picture_is_late_or_the_lamp_dark(bench: Bench, recorder: Recorder) -> None:
    frames = good(recorder.record()["left"])
    plain, plain_ns = shades([*frames]), [f.time_ns for f in frames]
    bench.world.fault("camera.left delayed amount=2.0 frame=4")
    late_ns = [f.time_ns for f in good(recorder.record()["left"])]
    assert (np.diff(late_ns) - np.diff(plain_ns)) / 1e6 == pytest.approx([0, 0, 0, 2, -2, 0, 0], abs=0.01)
    bench.world.fault("projector delayed frame=3")
    late = shades(recorder.record()["left"])
    assert np.diff([flip["sequence"] for flip in recorder.flips]).tolist() == [1, 1, 1, 1, 2, 1, 1, 1, 1]
    assert late[3] == pytest.approx(late[2], abs=1.0), "the old pattern once more"
    assert late[4] > late[3] + 2
    bench.world.fault("projector wrong")
    shifted = shades(recorder.record()["left"])
    assert shifted[1:] == pytest.approx(plain[:-1], abs=1.0), "everything one frame later"
    assert np.diff([flip["sequence"] for flip in recorder.flips]).tolist() == [1] * 9, "the flips say nothing"
    bench.world.clear_faults()
    bench.world.fault("projector off frame=4")
    dark = shades(recorder.record()["left"])
    assert dark[:4] == sorted(dark[:4])
    assert max(dark[4:]) < dark[0]
