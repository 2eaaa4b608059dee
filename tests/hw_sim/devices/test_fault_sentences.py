"""Every fault of the manual that touches a sequence, as it shows on the wires of a second, small host."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import usb.core

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


def test_without_faults_all_is_well(recorder: Recorder) -> None:
    got = recorder.record()
    assert ids(got["left"]) == ids(got["right"]) == ALL


def test_a_frame_that_was_not_sent_has_used_up_its_number(bench: Bench, recorder: Recorder) -> None:
    bench.world.fault("camera.left intermittent frame=3")
    got = recorder.record()
    assert ids(got["left"]) == [0, 1, 2, 4, 5, 6, 7]
    assert got["left"][-1] == "USBTimeoutError"
    assert ids(got["right"]) == ALL
    assert len(ids(recorder.record()["left"])) == COUNT, "once means once"


def test_three_frames_may_be_lost(bench: Bench, recorder: Recorder) -> None:
    bench.world.fault("camera.right intermittent count=3")
    assert ids(recorder.record()["right"]) == [3, 4, 5, 6, 7]


def test_a_frame_sent_twice_has_the_same_number_and_content(bench: Bench, recorder: Recorder) -> None:
    bench.world.fault("camera.left wrong how=repeat frame=3")
    frames = good(recorder.record(frames=COUNT + 1)["left"])
    assert [f.block_id for f in frames] == [0, 1, 2, 3, 3, 4, 5, 6, 7]
    assert (frames[3].image == frames[4].image).all()


@pytest.mark.parametrize(("frame", "order"), [(3, [0, 1, 2, 4, 3, 5, 6, 7]), (7, [0, 1, 2, 3, 4, 5, 7, 6])])
def test_two_frames_change_places(bench: Bench, recorder: Recorder, frame: int, order: list[int]) -> None:
    bench.world.fault(f"camera.left wrong how=swap frame={frame}")
    frames = good(recorder.record()["left"])
    assert [f.block_id for f in frames] == order
    by_id = [float(f.image.mean()) for f in sorted(frames, key=lambda f: f.block_id)]
    assert by_id == sorted(by_id), "the pictures belong to their numbers"


def test_a_truncated_payload_ends_short_and_the_trailer_follows(bench: Bench, recorder: Recorder) -> None:
    bench.world.fault("camera.left garbage how=truncate frame=3")
    frames = good(recorder.record()["left"])
    assert [f.block_id for f in frames] == ALL
    sizes = [len(f.payload) for f in frames]
    assert sizes[:3] + sizes[4:] == [bench.size] * 7
    assert 0.4 * bench.size < sizes[3] < 0.6 * bench.size
    assert frames[3].trailer[:4] == b"U3VT"
    assert frames[3].valid == sizes[3]


@pytest.mark.parametrize("part", ["leader", "trailer"])
def test_noise_in_place_of_a_header(bench: Bench, recorder: Recorder, part: str) -> None:
    bench.world.fault(f"camera.left garbage how={part} frame=3")
    frames = recorder.record()["left"]
    magic = {"leader": b"U3VL", "trailer": b"U3VT"}[part]
    headers = [getattr(f, part)[:4] for f in frames if isinstance(f, GotFrame)]
    assert [h == magic for h in headers] == [k != 3 for k in ALL]
    assert all(len(f.payload) == bench.size for f in frames if isinstance(f, GotFrame)), "in step again at once"


def test_a_camera_unplugged_in_a_sequence(bench: Bench, recorder: Recorder) -> None:
    bench.world.fault("camera.left off frame=5")
    got = recorder.record()
    assert got["left"][-1] == "USBError"
    assert 3 <= len(ids(got["left"])) <= 5
    assert ids(got["right"]) == ALL, "the other one goes on"


def test_a_stuck_camera_counts_on_with_the_same_image(bench: Bench, recorder: Recorder) -> None:
    bench.world.fault("camera.left stuck frame=4")
    got = recorder.record()
    frames = good(got["left"])
    assert [f.block_id for f in frames] == ALL
    assert all((f.image == frames[3].image).all() for f in frames[4:])
    assert not (frames[2].image == frames[3].image).all()
    assert np.diff([f.time_ns for f in frames]).min() > 16e6, "its clock goes on"
    right = shades(got["right"])
    assert right == sorted(right)
    assert right[-1] > right[4]


def test_a_late_camera_is_late_by_so_many_milliseconds(bench: Bench, recorder: Recorder) -> None:
    plain = [f.time_ns for f in good(recorder.record()["left"])]
    bench.world.fault("camera.left delayed amount=2.0 frame=4")
    late = [f.time_ns for f in good(recorder.record()["left"])]
    shift_ms = (np.diff(late) - np.diff(plain)) / 1e6
    assert shift_ms == pytest.approx([0, 0, 0, 2, -2, 0, 0], abs=0.01)


def test_a_late_flip_shows_the_old_pattern_once_more(bench: Bench, recorder: Recorder) -> None:
    bench.world.fault("projector delayed frame=3")
    got = recorder.record()
    sequences = np.diff([flip["sequence"] for flip in recorder.flips]).tolist()
    assert sequences == [1, 1, 1, 1, 2, 1, 1, 1, 1]
    left = shades(got["left"])
    assert left[3] == pytest.approx(left[2], abs=1.0)
    assert left[4] > left[3] + 2


def test_a_slow_projector_shows_everything_one_frame_later(bench: Bench, recorder: Recorder) -> None:
    plain = shades(recorder.record()["left"])
    bench.world.fault("projector wrong")
    shifted = shades(recorder.record()["left"])
    assert shifted[1:] == pytest.approx(plain[:-1], abs=1.0)
    assert shifted[0] < plain[0]
    assert np.diff([flip["sequence"] for flip in recorder.flips]).tolist() == [1] * 9, "the flips say nothing"


def test_a_dark_lamp_from_a_frame_on(bench: Bench, recorder: Recorder) -> None:
    bench.world.fault("projector off frame=4")
    left = shades(recorder.record()["left"])
    assert left[:4] == sorted(left[:4])
    assert max(left[4:]) < left[0]


def test_a_missing_pulse_costs_both_cameras_a_frame(bench: Bench, recorder: Recorder) -> None:
    bench.world.fault("board intermittent frame=3")
    got = recorder.record()
    assert len(ids(got["left"])) == len(ids(got["right"])) == COUNT - 1
    reported = [int(bench.board.wait_report("PULSE")[3]) for _ in range(COUNT - 1)]
    assert reported == [0, 1, 2, 4, 5, 6, 7]


def test_a_board_reset_in_a_sequence_stops_the_pulses(bench: Bench, recorder: Recorder) -> None:
    bench.world.fault("board wrong how=reset frame=4")
    got = recorder.record()
    assert len(ids(got["left"])) == 4
    assert bench.board.wait_report("BOOT")[5] == "WATCHDOG"


def test_lasers_light_the_scene_that_is_dark(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(width_px=400, height_px=300)
    projector, camera = bench.projector(), bench.camera()
    recorder = Recorder({"left": camera}, bench.board, projector, [0, 0], bench.size)

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


def test_a_camera_that_falls_back_leaves_the_bus_and_returns_slower(bench: Bench) -> None:
    camera = bench.camera()
    bench.world.fault("camera.left slow for_s=1")
    with pytest.raises(usb.core.USBError):
        camera.read(0, 4)
    assert bench.camera().device.speed == 3
    bench.wires.clock.sleep_s(1.1)
    assert bench.camera().device.speed == 4


def test_unsupported_faults_are_refused_by_the_world(bench: Bench) -> None:
    with pytest.raises(ValueError, match=r"supported: camera\.left\|right intermittent"):
        bench.world.fault("display off")
