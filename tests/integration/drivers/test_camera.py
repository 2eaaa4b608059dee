"""The camera driver against the simulated cameras: what the rest of the product may rely on, fault by fault."""

from __future__ import annotations

import threading
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from drivers.api import CameraSettings, DeviceGone, DeviceRefused, Flip, Frame, FrameStatus, Pulse, PulsesDone
from drivers.camera import UsbVisionCamera
from tests.integration.drivers.conftest import HEIGHT, SETTINGS, WIDTH, Rig

LIVE_US = (500, 8000)


def slot() -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    return np.zeros((HEIGHT, WIDTH), np.uint8)


def live_frames(rig: Rig, camera: UsbVisionCamera, count: int) -> list[Frame]:
    rig.board().live(2, *LIVE_US)
    return grab(camera, count)


def grab(camera: UsbVisionCamera, count: int) -> list[Frame]:
    return [camera.next_frame(slot(), 1.0) for _ in range(count)]


def test_identity_is_what_the_camera_says(rig: Rig) -> None:
    camera = rig.camera("left")
    assert camera.identity.serial == "KF-CAM-L"
    assert camera.identity.link_speed_mbps == 5000
    assert camera.link_is_fast
    assert camera.health().ok, camera.health()


def test_settings_come_back_as_the_camera_holds_them(rig: Rig) -> None:
    camera = rig.camera()
    got = camera.configure(CameraSettings(WIDTH, HEIGHT, 8000.0, 3.0))
    assert (got.width_px, got.height_px) == (WIDTH, HEIGHT)
    assert got.exposure_us == pytest.approx(8000.0, abs=1.0)
    assert got.gain_db == pytest.approx(3.0, abs=0.05)
    with pytest.raises(DeviceRefused, match=r"ExposureTime: .* refused, allowed"):
        camera.configure(CameraSettings(WIDTH, HEIGHT, 1e9, 0.0))
    with pytest.raises(DeviceRefused, match="Width"):
        camera.configure(CameraSettings(WIDTH + 16000, HEIGHT, 8000.0, 0.0))


def test_the_temperature_is_that_of_a_running_camera(rig: Rig) -> None:
    temperature_c = rig.camera().temperature_c()
    assert temperature_c is not None
    assert 5.0 < temperature_c < 90.0


def test_without_a_trigger_there_is_no_frame(rig: Rig) -> None:
    camera = rig.camera()
    camera.start()
    begin_ns = rig.wires.clock.now_ns()
    assert camera.next_frame(slot(), 0.2).status is FrameStatus.TIMEOUT
    assert 0.19 < (rig.wires.clock.now_ns() - begin_ns) * 1e-9 < 0.4


def test_live_frames_are_whole_consecutive_and_of_the_triggers_rhythm(rig: Rig) -> None:
    camera = rig.camera()
    camera.start()
    frames = live_frames(rig, camera, 6)
    assert [f.status for f in frames] == [FrameStatus.COMPLETE] * 6, frames
    ids = [f.block_id for f in frames if f.block_id is not None]
    assert np.diff(ids).tolist() == [1] * 5
    times = [f.camera_time_ns for f in frames if f.camera_time_ns is not None]
    np.testing.assert_allclose(np.diff(times), 2e9 / 60, rtol=1e-3)


def test_a_second_start_throws_away_what_is_queued(rig: Rig) -> None:
    camera = rig.camera()
    camera.start()
    board = rig.board()
    board.live(2, *LIVE_US)
    first = camera.next_frame(slot(), 1.0)
    rig.wires.clock.sleep_s(0.3)
    board.stop()
    rig.wires.clock.sleep_s(0.1)  # an exposure that had begun ends, and its frame arrives
    camera.start()
    assert camera.next_frame(slot(), 0.2).status is FrameStatus.TIMEOUT
    board.live(2, *LIVE_US)
    again = camera.next_frame(slot(), 1.0)
    assert again.status is FrameStatus.COMPLETE
    assert again.block_id == first.block_id


def test_a_stopped_camera_gives_no_frame_and_starts_again(rig: Rig) -> None:
    camera = rig.camera()
    camera.start()
    camera.stop()
    camera.stop()
    with pytest.raises(DeviceRefused, match="stopped"):
        camera.next_frame(slot(), 0.1)
    camera.start()
    assert live_frames(rig, camera, 1)[0].status is FrameStatus.COMPLETE


def test_a_slow_link_is_seen_at_opening(rig: Rig) -> None:
    rig.world.fault("camera.left slow")
    camera = rig.camera()
    assert camera.identity.link_speed_mbps == 480
    assert camera.link_is_fast is False
    assert not camera.health().ok


def test_unplugging_is_a_lost_device_and_plugging_in_again_works(rig: Rig) -> None:
    camera = rig.camera()
    camera.start()
    live_frames(rig, camera, 2)
    rig.world.fault("camera.left off")
    with pytest.raises(DeviceGone, match=r"camera\.left"):
        grab(camera, 10)
    with pytest.raises(DeviceGone):
        camera.stop()
    assert not camera.health().ok
    camera.close()
    with pytest.raises(DeviceGone, match="KF-CAM-L not found; the bus has KF-CAM-R"):
        rig.camera("left")
    rig.world.clear_faults()
    again = rig.camera("left")
    again.start()
    assert again.next_frame(slot(), 1.0).status is FrameStatus.COMPLETE


def test_an_opened_camera_cannot_be_opened_twice(rig: Rig) -> None:
    rig.camera("left")
    with pytest.raises(DeviceRefused, match="another program"):
        rig.camera("left")


# ------------------------------------------------------------------------------------------ an armed sequence

COUNT = 8
FAULTY = 3


class Sequence:
    """Eight patterns of growing brightness, played, triggered and recorded by both cameras."""

    def __init__(self, rig: Rig, fault: str = "") -> None:
        self.cameras = [rig.camera("left"), rig.camera("right")]
        self.board = rig.board()
        self.frames: list[list[Frame]] = [[], []]
        self.images: list[list[np.ndarray[tuple[int, int], np.dtype[np.uint8]]]] = [[], []]
        self.lost: list[DeviceGone | None] = [None, None]
        outputs = rig.outputs()
        projector = outputs.open_projector()
        outputs.open_display()
        steps = [np.full((768, 1024), round(255 * k / COUNT), np.uint8) for k in range(COUNT + 1)]
        projector.load(steps)
        for camera in self.cameras:
            camera.start()
        if fault:
            rig.world.fault(fault)
        readers = [
            threading.Thread(target=self._record, args=(index, camera), name=f"test-{index}", daemon=True)
            for index, camera in enumerate(self.cameras)
        ]
        for reader in readers:
            reader.start()
        self.flips = projector.play(range(1, COUNT + 1), 0, self._arm, lambda: False)
        for reader in readers:
            reader.join(20.0)
            assert not reader.is_alive(), "the recording did not end"

    def _arm(self, flip: Flip) -> int | None:
        assert flip.sequence is not None
        first = flip.sequence + 6
        now = self.board.vsync()
        # Both count the same blanks: the board from its reset, the card from its own zero.
        self.board.arm(COUNT, now.count + (first - flip.sequence), *LIVE_US)
        return first

    def _record(self, index: int, camera: UsbVisionCamera) -> None:
        try:
            # One more than there are, to see that nothing else comes.
            for _ in range(COUNT + 1):
                memory = slot()
                frame = camera.next_frame(memory, 0.5)
                if frame.status is FrameStatus.TIMEOUT:
                    return
                self.frames[index].append(frame)
                self.images[index].append(memory)
        except DeviceGone as error:
            self.lost[index] = error

    def events(self) -> list[object]:
        events: list[object] = []
        while not any(isinstance(event, PulsesDone) for event in events):
            event = self.board.next_event(1.0)
            assert event is not None, f"no DONE after {events}"
            events.append(event)
        return events


def statuses(frames: list[Frame]) -> list[FrameStatus]:
    return [frame.status for frame in frames]


def ids(frames: list[Frame]) -> list[int | None]:
    first = next(f.block_id for f in frames if f.block_id is not None)
    return [None if f.block_id is None else f.block_id - first for f in frames]


def test_a_sequence_arrives_whole_with_one_pulse_per_frame(rig: Rig) -> None:
    sequence = Sequence(rig)
    pulses = [event for event in sequence.events() if isinstance(event, Pulse)]
    assert [pulse.index for pulse in pulses] == list(range(COUNT))
    for frames, images in zip(sequence.frames, sequence.images, strict=True):
        assert statuses(frames) == [FrameStatus.COMPLETE] * COUNT, frames
        assert ids(frames) == list(range(COUNT))
        means = [float(image.mean()) for image in images]
        assert all(b > a + 1.0 for a, b in pairwise(means)), means
    spacing_us = np.diff([pulse.board_time_us for pulse in pulses])
    np.testing.assert_allclose(spacing_us, 1e6 / 60, rtol=1e-3)


WHOLE = FrameStatus.COMPLETE


def swapped(frames: list[Frame]) -> None:
    assert statuses(frames) == [WHOLE] * COUNT
    assert ids(frames) == [0, 1, 2, 4, 3, 5, 6, 7]


def repeated(frames: list[Frame]) -> None:
    assert statuses(frames) == [WHOLE] * (COUNT + 1)
    assert ids(frames) == [0, 1, 2, 3, 3, 4, 5, 6, 7]


def dropped(frames: list[Frame]) -> None:
    assert statuses(frames) == [WHOLE] * (COUNT - 1)
    assert ids(frames) == [0, 1, 2, 4, 5, 6, 7]


def damaged(status: FrameStatus) -> Callable[[list[Frame]], None]:
    def check(frames: list[Frame]) -> None:
        expected = [WHOLE] * COUNT
        expected[FAULTY] = status
        assert statuses(frames) == expected, frames
        good = [k for k in range(COUNT) if k != FAULTY]
        assert [ids(frames)[k] for k in good] == good

    return check


@pytest.mark.parametrize(
    ("verb", "check"),
    [
        ("intermittent", dropped),
        ("wrong how=repeat", repeated),
        ("wrong how=swap", swapped),
        ("garbage how=truncate", damaged(FrameStatus.TRUNCATED)),
        ("garbage how=leader", damaged(FrameStatus.CORRUPT)),
        ("garbage how=trailer", damaged(FrameStatus.CORRUPT)),
    ],
    ids=["dropped", "repeated", "swapped", "truncated", "leader", "trailer"],
)
def test_each_damage_costs_exactly_what_it_damaged(rig: Rig, verb: str, check: Callable[[list[Frame]], None]) -> None:
    sequence = Sequence(rig, f"camera.left {verb} frame={FAULTY}")
    check(sequence.frames[0])
    assert statuses(sequence.frames[1]) == [WHOLE] * COUNT


def test_a_camera_unplugged_in_the_middle_ends_the_recording_not_the_other_camera(rig: Rig) -> None:
    sequence = Sequence(rig, f"camera.left off frame={FAULTY}")
    assert isinstance(sequence.lost[0], DeviceGone)
    assert len(sequence.frames[0]) <= FAULTY + 1
    assert sequence.lost[1] is None
    assert WHOLE in statuses(sequence.frames[1])


def test_settings_survive_a_reconfiguration_while_streaming(rig: Rig) -> None:
    camera = rig.camera()
    camera.start()
    board = rig.board()
    board.live(2, *LIVE_US)
    dark, bright = slot(), slot()
    camera.configure(CameraSettings(WIDTH, HEIGHT, SETTINGS.exposure_us / 8, 0.0))
    assert camera.next_frame(dark, 1.0).status is FrameStatus.COMPLETE
    camera.configure(SETTINGS)
    assert camera.next_frame(bright, 1.0).status is FrameStatus.COMPLETE
    assert bright.mean() > dark.mean()
