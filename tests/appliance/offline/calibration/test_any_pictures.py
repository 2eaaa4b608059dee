"""Names of others tell left from right; pictures of any kind become grey values, and those that cannot are named."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.offline.calibration.air import PicturesError
from appliance.offline.calibration.any_pictures import Patterns, common_size, named_pictures, read_grey

GREY = np.tile(np.linspace(10, 200, 100, dtype=np.uint8), (80, 1))


def folder_of(tmp_path: Path, *names: str) -> Path:
    for name in names:
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        assert cv2.imwrite(str(path), GREY)
    return tmp_path


def listed(folder: Path, patterns: Patterns | None = None) -> dict[str, tuple[str | None, str | None]]:
    found = named_pictures(folder, patterns)
    return {pair.name: (below(folder, pair.left), below(folder, pair.right)) for pair in found.pairs}


def below(folder: Path, path: Path | None) -> str | None:
    return None if path is None else path.relative_to(folder).as_posix()


@pytest.mark.parametrize(
    ("left", "right", "name"),
    [
        ("v{}_left.png", "v{}_right.png", "v{}"),
        ("left0{}.jpg", "right0{}.jpg", "0{}"),
        ("0{}L.bmp", "0{}R.bmp", "0{}"),
        ("L_{}.tif", "R_{}.tif", "{}"),
        ("left/{}.png", "right/{}.png", "{}"),
        ("{}/Left.png", "{}/Right.png", "{}"),
        ("cam0/{}.png", "cam1/{}.png", "{}"),
        ("shot{}_cam1.png", "shot{}_cam2.png", "shot{}"),
        ("label{}_l.png", "label{}_r.png", "label{}"),
        ("image_0/00000{}.png", "image_1/00000{}.png", "00000{}"),
    ],
)
def test_usual_ways_to_name_pairs_are_understood(left: str, right: str, name: str, tmp_path: Path) -> None:
    folder = folder_of(tmp_path, *(text.format(k) for k in (2, 7) for text in (left, right)))
    assert listed(folder) == {name.format(k): (left.format(k), right.format(k)) for k in (2, 7)}


def test_any_other_names_are_told_by_patterns(tmp_path: Path) -> None:
    names = [f"{head}_{k}_{tail}.png" for k in (1, 2) for head, tail in (("2041", "x"), ("2077", "y"))]
    folder = folder_of(tmp_path, *names)
    with pytest.raises(PicturesError, match=r"no name of a picture \(2041_1_x.png, .* --left PATTERN --right PATTERN"):
        named_pictures(folder, None)
    assert listed(folder, Patterns("2041_*_x.png", "2077_*_y.png")) == {
        k: (f"2041_{k}_x.png", f"2077_{k}_y.png") for k in ("1", "2")
    }
    with pytest.raises(PicturesError, match="--left 2041: a pattern has one"):
        named_pictures(folder, Patterns("2041", "2077_*_y.png"))


def test_what_one_camera_has_alone_and_what_nothing_tells_are_kept_apart(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "v2_left.png", "v2_right.png", "v10_left.png", "v9_right.png", "notes.png")
    found = named_pictures(folder, None)
    assert listed(folder)["v10"] == ("v10_left.png", None)
    assert listed(folder)["v9"] == (None, "v9_right.png")
    assert found.unnamed == ("notes.png",)
    assert [pair.name for pair in found.pairs] == ["v2", "v9", "v10"], "by their numbers"


def test_one_picture_twice_is_named(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "1_left.png", "1_left.tif", "1_right.png")
    with pytest.raises(PicturesError, match="are both the left picture of"):
        named_pictures(folder, None)


def test_a_folder_without_pictures_says_what_is_read(tmp_path: Path) -> None:
    with pytest.raises(PicturesError, match=r"no pictures in it; read are \.png"):
        named_pictures(tmp_path, None)
    with pytest.raises(PicturesError, match="no such folder"):
        named_pictures(tmp_path / "nowhere", None)


def test_sixteen_bits_and_colours_become_the_same_grey(tmp_path: Path) -> None:
    deep, colour, clear = tmp_path / "deep.png", tmp_path / "colour.png", tmp_path / "clear.png"
    cv2.imwrite(str(deep), GREY.astype(np.uint16) * 16)
    cv2.imwrite(str(colour), np.repeat(GREY[..., None], 3, 2))
    cv2.imwrite(str(clear), np.dstack([GREY, GREY, GREY, np.full_like(GREY, 255)]))
    for path in (colour, clear):
        assert np.array_equal(read_grey(path), GREY), path
    found = read_grey(deep)
    assert found.dtype == np.uint8
    # Twelve bits in sixteen: whatever part of the range is used, the brightest becomes white.
    assert np.abs(found - GREY * (255.0 / 200.0)).max() < 1.0


def test_a_picture_of_another_size_and_a_damaged_one_are_named(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "1_left.png", "1_right.png", "2_left.png")
    other, damaged = folder / "2_right.png", folder / "3_left.png"
    cv2.imwrite(str(other), GREY[:, :90])
    damaged.write_bytes(b"\x89PNG nothing")
    cut = folder / "4_left.png"
    cut.write_bytes((folder / "1_left.png").read_bytes()[:-30])
    size, wrong = common_size(sorted(folder.iterdir()))
    assert size == (100, 80)
    assert wrong == {
        other: "2_right.png: 90x80 px, the other pictures have 100x80 px",
        damaged: f"{damaged}: is no picture, or damaged (PNG, TIFF, BMP, PGM or JPEG is read); bring it back from a copy",
        cut: f"{cut}: is damaged and cannot be decoded; bring it back from a copy",
    }
    with pytest.raises(PicturesError, match="is no picture"):
        common_size([damaged])
