"""Folders as other programs leave them become right clouds by one command and no word; the bench ``import_sequences`` has twenty of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.imported import import_folder
from tests.support.other_programs import PROGRAMS, Program

NAMES = ("SLStudio 2x3", "16 bit TIFF, references last", "inverses as a block")


@pytest.mark.parametrize("program", [one for one in PROGRAMS if one.name in NAMES], ids=lambda one: one.name)
def test_no_word_is_needed(tmp_path: Path, program: Program) -> None:
    drawn = program.make(tmp_path / "set", 3, 240)
    found = import_folder(tmp_path / "set", tmp_path / "cloud.npz", drawn)
    assert found.outcome == "whole", found
