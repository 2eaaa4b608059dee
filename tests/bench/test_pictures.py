"""The pictures of the README: small enough to be there, and a cloud is shown from the side that the diver saw."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from bench.pictures import CAPTIONS, TURN_DEG, captioned, view, write_gif

PICTURES = Path(__file__).parents[2] / "docs" / "pictures"


def two_steps() -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    """A near square on the left of a far one, 60 mm each."""
    x, y = (np.ravel(axis) for axis in np.meshgrid(np.linspace(-60.0, 60.0, 500), np.linspace(-30.0, 30.0, 250)))
    return np.stack([x, y, np.where(x < 0.0, 480.0, 520.0)], 1).astype(np.float32)


def test_what_is_near_is_yellow_wherever_it_is_turned() -> None:
    for degrees in (-20.0, 0.0, 20.0):
        picture = view(two_steps(), degrees)
        yellow = picture[..., 1] > 100
        purple = (picture[..., 1] < 15) & (picture[..., 0] > 30)
        assert yellow.sum() > 5_000
        assert purple.sum() > 5_000
        assert np.nonzero(yellow)[1].mean() < np.nonzero(purple)[1].mean()


def test_every_frame_is_in_the_animation(tmp_path: Path) -> None:
    frames = [captioned(view(two_steps(), degrees), "a caption") for degrees in (0.0, 10.0)]
    write_gif(tmp_path / "x.gif", frames, [500, 200])
    found, animation = cv2.imreadanimation(str(tmp_path / "x.gif"))
    assert found
    assert (len(animation.frames), list(animation.durations)) == (2, [500, 200])


def test_the_readmes_animation_is_whole_and_below_a_megabyte() -> None:
    path = PICTURES / "scan.gif"
    found, animation = cv2.imreadanimation(str(path))
    assert found
    assert len(animation.frames) == len(CAPTIONS) + len(TURN_DEG)
    assert path.stat().st_size < 1_000_000
