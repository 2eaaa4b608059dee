"""Owns the safe screen's pictures as they should be; ``PYTHONPATH=.:systemd python -m tests.systemd.safe_pages`` draws them again."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from kingfisher_safe.cause import Cause, notice, question
from kingfisher_safe.page import Picture, draw

FOLDER = Path(__file__).parent / "golden"
SIZE_PX = (800, 480)
CONFIG = Cause(
    "config",
    "CONFIG: camera.left.exposure_ms 25 > 16.6; allowed: 0.05..16.6 ms; correct it in /etc/kingfisher/rig.toml",
)
HANG = Cause("hang", 'in "appliance/instrument/service/status.py", line 118 in update')
PAGES = {
    "safe-config.en": notice(CONFIG, "en", None),
    "safe-config.de": notice(CONFIG, "de", None),
    "safe-hang.en": notice(HANG, "en", 30),
    "safe-hang.de": notice(HANG, "de", 30),
    "safe-off.en": question("en", off_selected=False),
    "safe-off.de": question("de", off_selected=True),
}


def as_array(picture: Picture) -> NDArray[np.uint8]:
    """(height, width, 3) uint8: blue, green, red."""
    return np.frombuffer(b"".join(picture.rows), np.uint8).reshape(picture.height_px, picture.width_px, 4)[:, :, :3]


def main() -> None:
    for name, words in PAGES.items():
        cv2.imwrite(str(FOLDER / f"{name}.png"), as_array(draw(words, *SIZE_PX)))


if __name__ == "__main__":
    main()
