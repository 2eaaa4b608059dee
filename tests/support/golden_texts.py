"""Keeps what the program says to people in one file, ``tests/golden_texts.txt``, and compares it there; elsewhere tests ask for facts, not for sentences.

``KINGFISHER_FREEZE_TEXTS=1 ./dev test -n 0 FILE`` writes the texts of a file's tests anew; the file's change is then read as any other.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

PATH = Path(__file__).parents[1] / "golden_texts.txt"
_KEY = re.compile(r"^# (tests/.+)$", re.MULTILINE)
FREEZE = "KINGFISHER_FREEZE_TEXTS"


def golden_texts() -> dict[str, str]:
    """Return all texts by the test that compares them and their number in it."""
    _, *pieces = _KEY.split(PATH.read_text(encoding="utf-8"))
    return {key: text.strip("\n") for key, text in zip(pieces[::2], pieces[1::2], strict=True)}


class Says:
    """Compares the texts of one test in their order, without its temporary folder."""

    def __init__(self, request: pytest.FixtureRequest) -> None:
        self._test, self._number = request.node.nodeid, 0
        self._folder = str(request.getfixturevalue("tmp_path")) if "tmp_path" in request.fixturenames else None

    def __call__(self, *said: object) -> None:
        """Compare ``str`` of each with the golden text, or write it there."""
        for one in said:
            self._number += 1
            key = f"{self._test} {self._number}"
            text = str(one) if self._folder is None else str(one).replace(self._folder, "TMP")
            if os.environ.get(FREEZE):
                _write({**golden_texts(), key: text.strip("\n")})
            assert text.strip("\n") == golden_texts().get(key), f"{key}: if it may say so, run it with {FREEZE}=1"


def _write(texts: dict[str, str]) -> None:
    PATH.write_text("\n".join(f"# {key}\n{text}\n" for key, text in sorted(texts.items())), encoding="utf-8")
