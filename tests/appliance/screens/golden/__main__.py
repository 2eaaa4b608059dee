"""Draws every golden picture again, and the page that shows them. Look at what changed before you keep it."""

from __future__ import annotations

from drivers.output.gl import open_gl
from tests.appliance.screens.golden import palette
from tests.appliance.screens.golden.draw import EVERY, FOLDER, studio
from tests.appliance.screens.golden.page import PAGE, page


def main() -> None:
    with open_gl() as gl, studio(gl) as made:
        for golden in EVERY:
            palette.write(golden.path, made.draw(golden))
    for path in set(FOLDER.glob("*.png")) - {golden.path for golden in EVERY}:
        path.unlink()
    PAGE.write_text(page(), encoding="utf-8")
    size_kb = sum(path.stat().st_size for path in FOLDER.glob("*.png")) / 1e3
    print(f"{len(EVERY)} pictures, {size_kb:.0f} kB, in {FOLDER}")


if __name__ == "__main__":
    main()
