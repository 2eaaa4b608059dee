"""Writes the plans into docs/pictures: ``./dev run python -m bench.wiring``."""

from __future__ import annotations

from bench.wiring.plans import FOLDER, PLANS

if __name__ == "__main__":
    for name, draw in PLANS.items():
        (FOLDER / name).write_text(draw().svg(), encoding="utf-8")
        print(FOLDER / name)
