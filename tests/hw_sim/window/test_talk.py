"""The two processes' conversation: lines come whole, waits end, and pictures arrive as they left."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

import numpy as np
import pytest

from hw_sim.window.pictures import ROOMS, Pictures, Writer
from hw_sim.window.talk import LONGEST_LINE, Lines, say, sizes_as_words, words_as_sizes


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    reader, writer = os.pipe()
    yield reader, writer
    for descriptor in (reader, writer):
        try:
            os.close(descriptor)
        except OSError:
            continue


def test_lines_come_whole_one_after_the_other(pipe: tuple[int, int]) -> None:
    reader, writer = pipe
    lines = Lines(reader)
    os.write(writer, b"down scan 12\nup sc")
    assert lines.read(1.0) == "down scan 12"
    assert lines.read(0.0) is None
    os.write(writer, b"an 13\nwant\n")
    assert [lines.read(1.0), lines.read(0.0)] == ["up scan 13", "want"]
    assert not lines.ended


def test_what_was_said_before_the_end_is_still_heard(pipe: tuple[int, int]) -> None:
    reader, writer = pipe
    lines = Lines(reader)
    say(writer, "failed", "no display\nserver")
    os.close(writer)
    assert lines.read(1.0) == "failed no display server", "one line, whatever the text"
    assert not lines.ended
    assert lines.read(1.0) is None
    assert lines.ended


def test_a_wait_for_a_line_ends(pipe: tuple[int, int]) -> None:
    start_s = time.monotonic()
    assert Lines(pipe[0]).read(0.05) is None
    assert 0.04 < time.monotonic() - start_s < 5.0


def test_a_line_without_end_is_an_error(pipe: tuple[int, int]) -> None:
    reader, writer = pipe
    lines = Lines(reader)
    os.write(writer, b"x" * (LONGEST_LINE + 10))
    lines.read(0.1)
    with pytest.raises(ValueError, match="a line of more than"):
        lines.read(0.1)


def test_nobody_there_is_said_so(pipe: tuple[int, int]) -> None:
    reader, writer = pipe
    assert say(writer, "want")
    os.close(reader)
    assert not say(writer, "want")


def test_sizes_survive_as_words() -> None:
    sizes = {"display": (800, 480), "left": (400, 300)}
    assert words_as_sizes(sizes_as_words(sizes)) == sizes


def test_pictures_arrive_in_another_mapping_and_only_changes_are_named() -> None:
    rng = np.random.default_rng(3)
    display = rng.integers(0, 256, (480, 640, 3), np.uint8)  # of the smaller mode
    projector = rng.integers(0, 256, (768, 1024), np.uint8)
    here = Pictures.create()
    there = Pictures(os.dup(here.descriptor))
    writer = Writer(here)
    assert writer.write({"display": display, "projector": projector}) == {
        "display": (640, 480),
        "projector": (1024, 768),
    }
    assert np.array_equal(there.view("display", 640, 480), display)
    assert np.array_equal(there.view("projector", 1024, 768)[:, :, 0], projector)
    assert writer.write({"display": display, "projector": projector}) == {}
    display[470, 630, 1] ^= 1
    assert writer.write({"display": display, "projector": projector}) == {"display": (640, 480)}
    assert np.array_equal(there.view("display", 640, 480), display)
    for pictures in (here, there):
        pictures.close()


def test_a_picture_that_does_not_fit_is_refused() -> None:
    pictures = Pictures.create()
    with pytest.raises(ValueError, match="display 801x480; allowed are 1x1 to 800x480"):
        pictures.view("display", ROOMS["display"].width_px + 1, 480)
    pictures.close()
