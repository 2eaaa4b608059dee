"""Images are read as their files hold them: a half, a colour, few or many bits; and headers tell at once what does not belong."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.desk.foreign import images as images_module
from appliance.desk.foreign.description import Description, parse_description
from appliance.desk.foreign.first_look import check_images
from appliance.desk.foreign.images import first_of_side, read_side
from appliance.desk.foreign.problem import ForeignError

PICTURE = np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3)


def described(folder: Path, images: str) -> Description:
    text = f"[images]\n{images}\n[projector]\nwidth_px = 64\nheight_px = 48\n[x]\nstripe_px = 8\n[cameras]\n"
    return parse_description(text, folder, "set", "set.toml")


def saved(folder: Path, count: int, picture: NDArray[np.uint8] = PICTURE[..., 0]) -> None:
    """Pictures 0.png, 1.png …, each brighter by one than the one before."""
    for k in range(count):
        cv2.imwrite(str(folder / f"{k}.png"), picture + k)


@pytest.mark.parametrize(
    ("sides", "left", "right"),
    [("left beside right", np.s_[:, :3], np.s_[:, 3:]), ("right above left", np.s_[2:], np.s_[:2])],
)
def test_a_picture_of_both_cameras_is_cut(tmp_path: Path, sides: str, left: Any, right: Any) -> None:
    saved(tmp_path, 3)
    description = described(tmp_path, f'both = "*.png"\nsides = "{sides}"\norder = "gray-x*3"')
    for side, part in (("left", left), ("right", right)):
        found = read_side(description, side)
        assert all(np.array_equal(found.images[k], (PICTURE[..., 0] + k)[part]) for k in range(3))
        assert found.shape == PICTURE[..., 0][part].shape


def test_a_colour_picture_is_three_images(tmp_path: Path) -> None:
    saved(tmp_path, 2, PICTURE)
    found = read_side(described(tmp_path, 'left = "*.png"\nchannel = "each"\norder = "gray-x*6"'), "left")
    # OpenCV writes blue first.
    wanted = [PICTURE[..., colour] + k for k in range(2) for colour in (2, 1, 0)]
    assert all(np.array_equal(found.images[k], one) for k, one in enumerate(wanted))
    assert len(found.images) == 6


def packed_tiff(values: NDArray[np.uint16]) -> bytes:
    """A TIFF of 12 bits, two values in three bytes (TIFF 6.0)."""
    first, second = values[:, ::2].ravel(), values[:, 1::2].ravel()
    packed = np.stack([first >> 4, (first & 15) << 4 | second >> 8, second & 255], 1).astype(np.uint8).tobytes()
    height, width = values.shape
    entries = [(256, 4, width), (257, 4, height), (258, 3, 12), (259, 3, 1), (262, 3, 1), (273, 4, 8), (277, 3, 1), (278, 4, height), (279, 4, len(packed))]  # fmt: skip
    directory = struct.pack("<H", len(entries)) + b"".join(
        struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in entries
    )
    return b"II*\0" + struct.pack("<I", 8 + len(packed)) + packed + directory + bytes(4)


def test_twelve_bits_are_read_packed_or_at_either_end_of_sixteen(tmp_path: Path) -> None:
    values = np.linspace(0, 4095, 8 * 6).astype(np.uint16).reshape(6, 8)
    (tmp_path / "0.tif").write_bytes(packed_tiff(values))
    cv2.imwrite(str(tmp_path / "1.tif"), values)
    cv2.imwrite(str(tmp_path / "2.tif"), values << 4)
    whites, ramps = [], []
    for k in range(3):
        found = read_side(described(tmp_path, f'left = "{k}.tif"\norder = "gray-x"'), "left")
        whites.append(found.white)
        ramps.append(found.images[0] / found.white)
        assert bool((found.images[0] >= found.white).any())
    assert np.allclose(ramps[0], values / 4095, atol=1e-6)
    assert np.allclose(ramps[1:], ramps[0], atol=3e-4)


def test_headers_tell_which_image_is_unlike_the_others(tmp_path: Path) -> None:
    """Nothing is decoded for it: behind its header the file is damaged."""
    grey = PICTURE[..., 0]
    pictures: list[NDArray[Any]] = [grey, grey, grey[:2], grey.astype(np.uint16)]
    for k, image in enumerate(pictures):
        done, data = cv2.imencode(".png", image)
        assert done
        (tmp_path / f"{k}.png").write_bytes(data.tobytes()[:40])
    for last, said in (
        ("[0-2]", "2.png: 6 x 2 px uint8, and 0.png has 6 x 4 px uint8"),
        ("[013]", "3.png: 6 x 4 px uint16"),
    ):
        with pytest.raises(ForeignError, match=said.replace("[", r"\[")):
            first_of_side(described(tmp_path, f'left = "{last}.png"\norder = "gray-x*3"'), "left")


def test_headers_alone_tell_that_one_camera_has_more_images(tmp_path: Path) -> None:
    saved(tmp_path, 3)
    for right, wanted in (
        ("[12]", "left and right have different kinds of images"),
        ("[0-2]", r"\[cameras.left\] is missing"),
    ):
        said = described(tmp_path, f'left.gray-x = "*.png"\nright.gray-x = "{right}.png"')
        with pytest.raises(ForeignError, match=wanted):
            check_images(Path("set.toml"), said, {side: first_of_side(said, side) for side in said.files})


@pytest.mark.parametrize(
    ("images", "wanted", "last"),
    [
        ('both = "*.png"\nsides = "right*2 left*2"\norder = "gray-x*2"', ["2.png", "3.png"], 4),
        ('both = "*.png"\nsides = "right left"\nchannel = "each"\norder = "gray-x*6"',
         [f"{k}.png {channel}" for k in (1, 3) for channel in ("red", "green", "blue")], 3),
        ('[images.left]\ngray-x = ["3.png", "0.png"]\nbright = "1.png"\n-="2.png"', ["3.png", "0.png", "1.png"], 2),
    ],
)  # fmt: skip
def test_files_of_one_camera_are_told_by_turns_or_by_kind(
    tmp_path: Path, images: str, wanted: list[str], last: int
) -> None:
    saved(tmp_path, 4, PICTURE)
    found = read_side(described(tmp_path, images), "left")
    assert [frame.name for frame in found.files] == wanted
    assert found.images[len(wanted) - 1][0, 0] == last


def test_what_does_not_fit_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    saved(tmp_path, 4)
    monkeypatch.setattr(images_module, "KEPT_BYTES", 2 * PICTURE[..., 0].size)
    found = read_side(described(tmp_path, 'left = "*.png"\norder = "gray-x*4"'), "left")
    assert all(np.array_equal(found.images[k], PICTURE[..., 0] + k) for k in range(4))
    saved(tmp_path, 4, PICTURE[..., 0] + np.uint8(100))
    # The last picture alone is at hand besides what fits.
    assert [int(found.images[k][0, 0]) for k in (0, 1, 2, 3)] == [0, 1, 102, 103]
