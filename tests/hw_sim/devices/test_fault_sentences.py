"""Every fault of the manual that touches a sequence, as it shows on the wires of a second, small host."""

from __future__ import annotations

from collections.abc import Callable

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
    if "frame=3" in fault:
        again = recorder.record()
        assert len(ids(again["left"])) == len(ids(again["right"])) == COUNT, "once means once"


def test_a_truncated_payload_ends_short_and_the_trailer_follows(bench: Bench, recorder: Recorder) -> None:
    bench.world.fault("camera.left garbage how=truncate frame=3")
    frames = good(recorder.record()["left"])
    assert [f.block_id for f in frames] == ALL
    sizes = [len(f.payload) for f in frames]
    assert sizes[:3] + sizes[4:] == [bench.size] * 7
    assert 0.4 * bench.size < sizes[3] < 0.6 * bench.size
    assert (frames[3].trailer[:4], frames[3].valid) == (b"U3VT", sizes[3])


@pytest.mark.parametrize(("part", "magic"), [("leader", b"U3VL"), ("trailer", b"U3VT")])
def test_noise_in_place_of_a_header(bench: Bench, recorder: Recorder, part: str, magic: bytes) -> None:
    bench.world.fault(f"camera.left garbage how={part} frame=3")
    frames = [f for f in recorder.record()["left"] if isinstance(f, GotFrame)]
    assert [getattr(f, part)[:4] == magic for f in frames] == [k != 3 for k in ALL]
    assert all(len(f.payload) == bench.size for f in frames), "in step again at once"


def test_a_camera_unplugged_in_a_sequence(bench: Bench, recorder: Recorder) -> None:
    bench.world.fault("camera.left off frame=5")
    got = recorder.record()
    assert got["left"][-1] == "USBError"
    assert 3 <= len(ids(got["left"])) <= 5
    assert ids(got["right"]) == ALL, "the other one goes on"


def test_a_stuck_camera_counts_on_with_the_same_image(bench: Bench, recorder: Recorder) -> None:
    bench.world.fault("camera.left stuck frame=4")
    got = recorder.record()
    frames, right = good(got["left"]), shades(got["right"])
    assert [f.block_id for f in frames] == ALL
    assert [(f.image == frames[3].image).all() for f in frames] == [k >= 3 for k in ALL]
    assert np.diff([f.time_ns for f in frames]).min() > 16e6, "its clock goes on"
    assert right == sorted(right)
    assert right[-1] > right[4]


def test_a_late_camera_is_late_by_so_many_milliseconds(bench: Bench, recorder: Recorder) -> None:
    plain = [f.time_ns for f in good(recorder.record()["left"])]
    bench.world.fault("camera.left delayed amount=2.0 frame=4")
    late = [f.time_ns for f in good(recorder.record()["left"])]
    assert (np.diff(late) - np.diff(plain)) / 1e6 == pytest.approx([0, 0, 0, 2, -2, 0, 0], abs=0.01)


def test_a_flip_or_the_picture_is_late_or_the_lamp_dark(bench: Bench, recorder: Recorder) -> None:
    plain = shades(recorder.record()["left"])
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


def test_lasers_light_the_scene_that_is_dark(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(width_px=400, height_px=300)
    recorder = Recorder({"left": bench.camera()}, bench.board, bench.projector(), [0, 0], bench.size)

    def brightest() -> int:
        return int(good(recorder.record()["left"])[1].image.max())

    dark = brightest()
    assert bench.board.ask("LASER", 1, 1) == ["1", "1"]
    assert brightest() > dark + 50
    assert bench.board.ask("LASER", 0, 0) == ["0", "0"]
    assert brightest() < dark + 20
    bench.world.fault("laser.left stuck")
    assert bench.board.ask("LASER", 0, 0) == ["1", "0"]
    assert brightest() > dark + 50
