"""Makes the operator's papers again: ``docs/operator``."""

from __future__ import annotations

from pathlib import Path

from appliance.machine.words import Language
from drivers.output.gl import open_gl
from tests.appliance.screens.golden import palette
from tests.appliance.screens.golden.draw import Golden
from tests.appliance.screens.operator import card, pages

FOLDER = Path(__file__).parents[4] / "docs" / "operator"


def texts() -> dict[str, str]:
    """Each page by its name."""
    made = {"README.md": pages.index()}
    for language in Language:
        made[f"alarms.{language.value}.md"] = pages.alarms(language)
        made[f"keys.{language.value}.md"] = pages.keys(language)
    return made


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, text in texts().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
    with open_gl() as gl:
        for language in Language:
            aim = palette.read(Golden("aim", language, alert=False).path)
            palette.write(FOLDER / f"dive-card.{language.value}.png", card.draw_card(gl, aim, language))


if __name__ == "__main__":
    main()
