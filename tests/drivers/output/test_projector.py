"""How a projector plays and a display presents, on a surface whose blanks are the test's."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.api import DeviceGone, Flip
from drivers.output.display import PictureDisplay
from drivers.output.projector import PatternProjector
from drivers.output.surface import FlipStamp

PERIOD_NS = 16_666_667


class Picture:
    """Memory of the test's own."""

    def __init__(self) -> None:
        self.pixels = np.zeros((2, 3, 4), np.uint8)

    def write(self, pixels: NDArray[np.uint8]) -> None:
        self.pixels[...] = pixels


class Lamp:
    """A ``drivers.output.surface.Surface`` of 3 x 2 pixels."""

    device = "projector"
    size_px = (3, 2)

    def __init__(self, refresh_hz: float = 60.0, counts_after: int | None = 0) -> None:
        self.refresh_hz = refresh_hz
        self.pictures: list[Picture] = []
        self.shown: list[Picture] = []
        self.timeouts_s: list[float] = []
        self.steps: list[float] = []
        """Periods that the next flips take, in place of one."""
        self.connected, self.closed = True, 0
        self._counts_after, self._blank, self._time_ns = counts_after, 100, 7_000_000_000

    def create_picture(self) -> Picture:
        self.pictures.append(Picture())
        return self.pictures[-1]

    def flip(self, picture: Picture, timeout_s: float) -> FlipStamp:
        step = self.steps.pop(0) if self.steps else 1.0
        self._time_ns += round(step * PERIOD_NS)
        self._blank += max(1, round(step))
        self.shown.append(picture)
        self.timeouts_s.append(timeout_s)
        counted = self._counts_after is not None and len(self.shown) > self._counts_after
        return FlipStamp(self._blank if counted else None, self._time_ns)

    def check_connection(self) -> None:
        if not self.connected:
            raise DeviceGone("projector", "HDMI-A-1 was unplugged", "Check its cable")

    def describe(self) -> tuple[str, Mapping[str, str]]:
        return "lit", {"gamma": "linear"}

    def close(self) -> None:
        self.closed += 1


def loaded(lamp: Lamp, number: int = 4) -> PatternProjector[Picture]:
    projector = PatternProjector(lamp)
    projector.load([np.full((2, 3), 10 * k, np.uint8) for k in range(number)])
    lamp.shown.clear()
    return projector


def codes(lamp: Lamp) -> list[int]:
    """The green light of what was shown."""
    return [int(picture.pixels[0, 0, 1]) for picture in lamp.shown]


@pytest.mark.parametrize(("refresh_hz", "timeout_s"), [(60.0, 1.0), (6.0, 1.0), (5.0, 1.2)])
def test_a_flip_may_take_a_second_or_six_periods(refresh_hz: float, timeout_s: float) -> None:
    lamp = Lamp(refresh_hz)
    loaded(lamp).show(0)
    assert set(lamp.timeouts_s) == {timeout_s}


@pytest.mark.parametrize(("counts_after", "tries"), [(0, 1), (1, 2), (2, 3), (None, 3)])
def test_whether_blanks_are_counted_is_known_after_three_flips(counts_after: int | None, tries: int) -> None:
    lamp = Lamp()
    projector = loaded(lamp)
    lamp._counts_after = counts_after
    seen: list[Flip] = []

    def start(flip: Flip) -> None:
        seen.append(flip)
        assert codes(lamp) == [0] * tries

    projector.play([], 0, start, lambda: False)
    assert (seen[0].sequence is None) == (counts_after is None)


@pytest.mark.parametrize(("agreed", "ahead"), [(None, 1), (2, 2), (3, 3), (600, 600)])
def test_a_play_begins_at_the_blank_that_was_agreed_once_or_at_the_next(agreed: int | None, ahead: int) -> None:
    lamp = Lamp()
    projector = loaded(lamp)
    asked: list[Flip] = []

    def start(flip: Flip) -> int | None:
        asked.append(flip)
        return None if agreed is None else (flip.sequence or 0) + agreed

    flips = projector.play([1, 2], 3, start, lambda: False)
    assert [(flip.index, flip.sequence) for flip in asked] == [(3, 102)]
    assert [(flip.index, flip.sequence) for flip in flips] == [(1, 102 + ahead), (2, 103 + ahead)]
    assert codes(lamp) == [*[30] * ahead, 10, 20, 30], "idle before and behind"
    lamp.shown.clear()
    with pytest.raises(ValueError, match=r"601 blanks ahead; allowed are 2\.\.600"):
        projector.play([1], 3, lambda flip: (flip.sequence or 0) + 601, lambda: False)
    assert codes(lamp) == [30], "idle stays"


@pytest.mark.parametrize(("ahead", "polls", "shown"), [(9, 2, [30, 30, 30]), (3, 4, [30, 30, 30, 10, 20, 30])])
def test_an_abort_ends_within_one_blank_on_idle(ahead: int, polls: int, shown: list[int]) -> None:
    lamp = Lamp()
    asked = iter([*[False] * polls, True])
    loaded(lamp).play([1, 2, 0], 3, lambda flip: (flip.sequence or 0) + ahead, lambda: next(asked))
    assert codes(lamp) == shown


@pytest.mark.parametrize(("ahead", "steps"), [(0, []), (3, [1.0, 4.0])])
def test_a_start_that_is_past_or_missed_is_one_late_flip(ahead: int, steps: list[float]) -> None:
    lamp = Lamp()
    projector = loaded(lamp)
    lamp.steps = steps
    flips = projector.play([1, 2], 0, lambda flip: (flip.sequence or 0) + ahead, lambda: False)
    assert [flip.index for flip in flips] == [1]


@pytest.mark.parametrize(("periods", "played"), [(1.0, 3), (1.4, 3), (1.6, 2), (2.0, 2)])
def test_without_a_counter_a_flip_is_late_after_one_and_a_half_periods(periods: float, played: int) -> None:
    lamp = Lamp(counts_after=None)
    projector = loaded(lamp)
    lamp.steps = [*[1.0] * 3, 5.0, periods, 1.0]  # the first of the play is late to nobody
    flips = projector.play([0, 1, 2], 3, lambda flip: None, lambda: False)
    assert [flip.index for flip in flips] == [0, 1, 2][:played]
    assert codes(lamp)[-1] == 30


def test_frames_are_counted_from_nought_and_there_are_none_before_a_load_or_after_one_that_failed() -> None:
    lamp = Lamp()
    projector = loaded(lamp, 3)
    assert [projector.show(k).index for k in (0, 2)] == [0, 2]
    for wrong in (-1, 3):
        with pytest.raises(IndexError, match=f"projector frame {wrong}; 3 are loaded"):
            projector.show(wrong)
        with pytest.raises(IndexError):
            projector.play([0], wrong, lambda flip: None, lambda: False)

    def fail(pixels: NDArray[np.uint8]) -> None:
        raise DeviceGone("projector", "its memory is gone", "Restart")

    lamp.pictures[2].write = fail  # type: ignore[method-assign]
    with pytest.raises(DeviceGone, match="its memory is gone"):
        projector.load([np.zeros((2, 3), np.uint8)] * 3)
    for none_loaded in (projector, PatternProjector(Lamp())):
        with pytest.raises(IndexError, match="projector frame 0; 0 are loaded"):
            none_loaded.show(0)


def test_a_counter_that_begins_to_count_after_the_start_was_agreed_leaves_the_clock_to_tell_it() -> None:
    lamp = Lamp()
    projector = loaded(lamp)
    lamp._counts_after = 4
    begun: list[int] = []

    def start(flip: Flip) -> int:
        assert flip.sequence is None
        begun.append(flip.time_ns)
        return 6

    flips = projector.play([1, 2], 3, start, lambda: False)
    assert [round((flip.time_ns - begun[0]) / PERIOD_NS) for flip in flips] == [6, 7]
    assert [flip.index for flip in flips] == [1, 2]


def test_a_projector_without_its_cable_is_asked_before_it_plays_and_says_so_in_its_health() -> None:
    lamp = Lamp()
    projector = loaded(lamp)
    assert (projector.health().ok, projector.health().summary) == (True, "lit")
    lamp.connected = False
    for use in (lambda: projector.show(0), lambda: projector.play([0], 0, lambda flip: None, lambda: False)):
        with pytest.raises(DeviceGone):
            use()
    assert lamp.shown == []
    health = projector.health()
    assert (health.device, health.ok) == ("projector", False)
    assert health.summary == "HDMI-A-1 was unplugged. Check its cable"
    assert health.details == {"gamma": "linear"}


def test_a_display_takes_turns_between_two_pictures_with_red_and_blue_changed_over() -> None:
    lamp = Lamp()
    display = PictureDisplay(lamp)
    image = np.arange(18, dtype=np.uint8).reshape(2, 3, 3)
    flips = [display.present(image + k, 0.5) for k in range(3)]
    assert [flip.index for flip in flips] == [-1] * 3
    assert [flip.sequence for flip in flips] == [101, 102, 103]
    assert lamp.shown == [lamp.pictures[0], lamp.pictures[1], lamp.pictures[0]]
    assert set(lamp.timeouts_s) == {0.5}
    np.testing.assert_array_equal(lamp.shown[2].pixels[:, :, :3], (image + 2)[:, :, ::-1])
    assert (display.size_px, display.health().ok) == ((3, 2), True)
    display.close()
    assert lamp.closed == 1


def test_what_does_not_fit_is_refused_and_what_fits_is_drawn_into_green_or_into_all_channels() -> None:
    lamp = Lamp()
    display, projector = PictureDisplay(lamp), loaded(lamp)
    for bad in (np.zeros((3, 2, 3), np.uint8), np.zeros((2, 3, 4), np.uint8), np.zeros((2, 3, 3))):
        with pytest.raises(ValueError, match=r"\(2, 3, 3\) uint8"):
            display.present(bad, 0.5)  # type: ignore[arg-type]
    for frame in (np.zeros((3, 2), np.uint8), np.zeros((2, 3), np.uint16)):
        with pytest.raises(ValueError, match=r"frame 1 is .*\(2, 3\) uint8"):
            projector.load([np.zeros((2, 3), np.uint8), frame])  # type: ignore[list-item]
    assert lamp.shown == []
    for all_channels, drawn in ((False, [0, 7, 0, 0]), (True, [7, 7, 7, 0])):
        projector = PatternProjector(lamp, all_channels=all_channels)
        projector.load([np.full((2, 3), 7, np.uint8)])
        projector.show(0)
        assert lamp.shown[-1].pixels.reshape(-1, 4).tolist() == [drawn] * 6
