"""Owns the import of a folder of images that nobody has described: guess, description, contact sheet, points and a
picture of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from appliance.base import Progress
from appliance.desk.foreign.guess import TriedSequence, guess_sequence
from appliance.desk.foreign.problem import ForeignError
from appliance.desk.foreign.sheet import contact_sheet
from appliance.desk.foreign.writing import description_text, joined
from appliance.desk.foreign_import import import_cloud
from appliance.store import LocalFileSystem


def beside_cloud(out: Path) -> tuple[Path, Path, Path]:
    """Return where the description, the contact sheet and the picture of the cloud ``out`` go."""
    return out.with_suffix(".toml"), out.with_name(f"{out.stem}.roles.png"), out.with_name(f"{out.stem}.cloud.png")


def import_folder(folder: Path, out: Path, progress: Progress, reasons: Path | None = None) -> dict[str, Any]:
    """Guess what the images below ``folder`` show, and write the cloud ``out`` with all that belongs to it.

    Raises ForeignError where nothing stands out, or the cameras are not known: descriptions and contact sheet are there
    then; besides as ``import_cloud``.
    """
    candidates = guess_sequence(folder, progress)
    described, roles, picture = beside_cloud(out)
    files = LocalFileSystem()
    best = candidates[0]
    files.replace_file(roles, contact_sheet(list(best.images), best.words, best.by_image))
    if len(candidates) > 1:
        raise ForeignError(_question(folder, out, candidates))
    _write(best, described)
    if not best.description.cameras.content:
        raise ForeignError(
            f"{folder}: its images are {joined(best.words)} ({best.program}), and no file says anything of the "
            "cameras: put their calibration "
            f"into the folder, or say it under [cameras] in {described.name}, which is written"
        )
    report = import_cloud(described, out, progress, reasons=reasons, picture=picture)
    return {
        **report,
        "program": best.program,
        "order": joined(best.words),
        "explained_percent": 100.0 * best.explained,
        "description": str(described),
        "roles": str(roles),
        "picture": str(picture),
    }


def guessed_text(candidate: TriedSequence, beside: Path) -> str:
    """Return the description of a candidate, as the text of a file in the folder ``beside``."""
    notes = (
        f"{candidate.program}: {100 * candidate.explained:.0f} % of the images' variation is explained.",
        *candidate.notes,
    )
    return description_text(candidate.description, candidate.tested, beside, notes)


def _write(candidate: TriedSequence, path: Path) -> None:
    LocalFileSystem().replace_file(path, guessed_text(candidate, path.parent).encode())


def _question(folder: Path, out: Path, candidates: Sequence[TriedSequence]) -> str:
    """Write both descriptions, and return the question that tells them apart."""
    said = []
    for number, one in enumerate(candidates, 1):
        path = out.with_name(f"{out.stem}.{number}.toml")
        _write(one, path)
        said.append(f"{joined(one.words)} ({one.program}, explains {100 * one.explained:.0f} %: {path.name})")
    other = [
        k for k, words in enumerate(zip(*(one.words for one in candidates), strict=False), 1) if len(set(words)) > 1
    ]
    asked = f"what do images {other[0]} to {other[-1]} show? See {beside_cloud(out)[1].name}, and " if other else ""
    return f"{folder}: two readings of the images are as good: {said[0]}, or {said[1]}; {asked}import the description that is right"
