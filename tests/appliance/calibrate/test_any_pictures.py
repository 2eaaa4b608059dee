"""Names of others tell left from right; pictures of any kind become grey values, and those that cannot are named."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.calibrate.pictures import PicturesError, common_size, named_pictures, read_grey

GREY = np.tile(np.linspace(10, 200, 100, dtype=np.uint8), (80, 1))


def folder_of(tmp_path: Path, *names: str) -> Path:
    for name in names:
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        assert cv2.imwrite(str(path), GREY)
    return tmp_path


def listed(folder: Path, patterns: tuple[str, str] | None = None) -> dict[str, tuple[str | None, str | None]]:
    def below(path: Path | None) -> str | None:
        return None if path is None else path.relative_to(folder).as_posix()

    return {pair.name: (below(pair.left), below(pair.right)) for pair in named_pictures(folder, patterns).pairs}


@pytest.mark.parametrize(
    ("left", "right", "name"),
    [
        ("v{}_left.png", "v{}_right.png", "v{}"), ("left0{}.jpg", "right0{}.jpg", "0{}"), ("0{}L.bmp", "0{}R.bmp", "0{}"),
        ("L_{}.tif", "R_{}.tif", "{}"), ("left/{}.png", "right/{}.png", "{}"), ("{}/Left.png", "{}/Right.png", "{}"),
        ("cam0/{}.png", "cam1/{}.png", "{}"), ("shot{}_cam1.png", "shot{}_cam2.png", "shot{}"), ("label{}_l.png", "label{}_r.png", "label{}"),
        ("image_0/00000{}.png", "image_1/00000{}.png", "00000{}"),
    ],
)  # fmt: skip
def test_usual_ways_to_name_pairs_are_understood(left: str, right: str, name: str, tmp_path: Path) -> None:
    folder = folder_of(tmp_path, *(text.format(k) for k in (2, 7) for text in (left, right)))
    assert listed(folder) == {name.format(k): (left.format(k), right.format(k)) for k in (2, 7)}


def test_any_other_names_are_told_by_patterns(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, *(f"{name}.png" for k in (1, 2) for name in (f"2041_{k}_x", f"2077_{k}_y")))
    with pytest.raises(PicturesError, match=r"2041_1_x.png, .*--sides LEFT,RIGHT"):
        named_pictures(folder, None)
    pairs = {k: (f"2041_{k}_x.png", f"2077_{k}_y.png") for k in ("1", "2")}
    assert listed(folder, ("2041_*_x.png", "2077_*_y.png")) == pairs
    with pytest.raises(PicturesError, match="--sides 2041"):
        named_pictures(folder, ("2041", "2077_*_y.png"))


def test_what_one_camera_has_alone_and_what_nothing_tells_are_kept_apart_and_one_twice_is_named(tmp_path: Path) -> None:
    for folder, said in ((tmp_path, r"\.png"), (tmp_path / "nowhere", "no such folder")):
        with pytest.raises(PicturesError, match=said):
            named_pictures(folder, None)
    folder = folder_of(tmp_path, "v2_left.png", "v2_right.png", "v10_left.png", "v9_right.png", "notes.png")
    assert named_pictures(folder, None).unnamed == ("notes.png",)
    pairs = {"v2": ("v2_left.png", "v2_right.png"), "v9": (None, "v9_right.png"), "v10": ("v10_left.png", None)}
    assert list(listed(folder).items()) == list(pairs.items()), "by their numbers"
    folder_of(tmp_path, "v2_left.tif")
    with pytest.raises(PicturesError, match="v2_left"):
        named_pictures(folder, None)


def test_sixteen_bits_and_colours_become_the_same_grey(tmp_path: Path) -> None:
    for depth in (np.repeat(GREY[..., None], 3, 2), np.dstack([GREY, GREY, GREY, np.full_like(GREY, 255)])):
        cv2.imwrite(str(tmp_path / "colour.png"), depth)
        assert np.array_equal(read_grey(tmp_path / "colour.png"), GREY)
    cv2.imwrite(str(tmp_path / "deep.png"), GREY.astype(np.uint16) * 16)
    found = read_grey(tmp_path / "deep.png")
    assert found.dtype == np.uint8
    # Twelve bits in sixteen: whatever part of the range is used, the brightest becomes white.
    assert np.abs(found - GREY * (255.0 / 200.0)).max() < 1.0


def test_a_picture_of_another_size_and_a_damaged_one_are_named(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "1_left.png", "1_right.png", "2_left.png")
    other, damaged, cut = (folder / name for name in ("2_right.png", "3_left.png", "4_left.png"))
    cv2.imwrite(str(other), GREY[:, :90])
    damaged.write_bytes(b"\x89PNG nothing")
    cut.write_bytes((folder / "1_left.png").read_bytes()[:-30])
    size, wrong = common_size(sorted(folder.iterdir()))
    assert (size, set(wrong)) == ((100, 80), {other, damaged, cut})
    for path, said in ((other, "90x80 px"), (damaged, "is no image"), (cut, "cannot be decoded")):
        assert said in wrong[path]
    with pytest.raises(PicturesError, match="is no image"):
        common_size([damaged])
