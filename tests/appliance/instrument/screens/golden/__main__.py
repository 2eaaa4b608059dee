"""Draws every golden picture and the dive cards again. Look at what changed before you keep it."""

from __future__ import annotations

from appliance.instrument.machine.words import Language
from drivers.output.gl import open_gl
from tests.appliance.instrument.screens.golden import card
from tests.appliance.instrument.screens.golden.pictures import EVERY, FOLDER, Golden, studio, write


def main() -> None:
    with open_gl() as gl, studio(gl) as made:
        for golden in EVERY:
            write(golden.path, made.draw(golden))
        for language in Language:
            aim = made.draw(Golden("aim", language, alert=False))
            write(card.path(language), card.draw_card(gl, aim, language))
    for path in set(FOLDER.glob("*.png")) - {golden.path for golden in EVERY}:
        path.unlink()


if __name__ == "__main__":
    main()
