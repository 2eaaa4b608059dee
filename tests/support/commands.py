"""The program as somebody types it: in a process of its own, or in this one, where kernels are loaded once."""

from __future__ import annotations

import contextlib
import io
import json
import resource
import subprocess
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from appliance.cli import main

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Said:
    """What a command did."""

    code: int
    out: str
    err: str

    @property
    def document(self) -> Any:
        return json.loads(self.out)

    @property
    def lines(self) -> dict[str, str]:
        """Lines of ``name value``."""
        return dict(line.split(None, 1) for line in self.out.splitlines() if len(line.split(None, 1)) == 2)

    @property
    def error(self) -> str:
        """The one line of the error."""
        lines = self.err.splitlines()
        assert len(lines) == 1, self.err
        return lines[0]


def kingfisher(*words: object, cwd: Path = ROOT, most_bytes: int | None = None, most_s: float = 240.0) -> Said:
    """What the program said, in a process of its own; it can make no file larger than ``most_bytes``, and takes ``most_s`` at most."""
    limit = None if most_bytes is None else partial(resource.setrlimit, resource.RLIMIT_FSIZE, (most_bytes,) * 2)
    done = subprocess.run(
        [sys.executable, "-m", "appliance.cli", *map(str, words)],
        cwd=cwd, capture_output=True, text=True, timeout=most_s, check=False, preexec_fn=limit,
    )  # fmt: skip
    assert "Traceback" not in done.stderr, done.stderr
    return Said(done.returncode, done.stdout, done.stderr)


def notebook_says(name: str) -> str:
    """What the cells of a notebook of the documents print, one after the other, run in this process."""
    cells = json.loads((ROOT / "docs" / "notebooks" / name).read_text(encoding="utf-8"))["cells"]
    said, names = io.StringIO(), dict[str, Any]()
    with contextlib.redirect_stdout(said):
        for k, cell in enumerate(cells):
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), f"cell {k}", "exec"), names)
    return said.getvalue()


@dataclass(frozen=True)
class Shell:
    """The program in this process; a fixture makes it of ``capsys``."""

    capsys: pytest.CaptureFixture[str]

    def __call__(self, *words: object) -> Said:
        self.capsys.readouterr()
        try:
            code = int(main([*map(str, words)]))
        except SystemExit as left:
            code = int(left.code or 0)
        said = self.capsys.readouterr()
        return Said(code, said.out, said.err)
