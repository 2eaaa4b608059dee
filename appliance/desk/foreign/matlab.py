"""Owns the reading of MATLAB's files, versions 4 to 7: by scipy, in a process of its own with little time and memory.

A damaged file may end the process that reads it. This module is that process's program, too, and imports nothing of ours.
"""

from __future__ import annotations

import io
import json
import resource
import subprocess
import sys
from typing import Any

import numpy as np

MOST_S, MOST_MEMORY_BYTES, MOST_TEXT_BYTES = 20, 1 << 30, 1 << 24
MOST_NUMBERS = 20_000
"""Arrays of more numbers are left out: they are no camera's."""


class MatlabError(ValueError):
    """The bytes are no MATLAB file of version 4 to 7, or are damaged."""


def matlab_tables(raw: bytes) -> dict[str, Any]:
    """Return numbers, lists of them and texts by name; structures are tables. Raises MatlabError."""
    try:
        done = subprocess.run(
            [sys.executable, "-I", __file__], input=raw, capture_output=True, timeout=MOST_S,
            env={"OPENBLAS_NUM_THREADS": "1"}, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        raise MatlabError(f"reading takes longer than {MOST_S} s") from error
    if done.returncode:
        last = done.stderr.decode("utf-8", "replace").strip().rpartition("\n")[2]
        raise MatlabError(last[-200:] or f"it ends its reader by signal {-done.returncode}")
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def _plain(value: Any) -> Any:
    """Return what JSON can hold of what scipy makes: ``None`` for objects, cells and whatever is large."""
    if isinstance(value, dict):
        return {str(name): _plain(one) for name, one in value.items() if not str(name).startswith("__")}
    if isinstance(value, list):
        return _plain(value[0]) if value else None  # of an array of structures the first
    if isinstance(value, str):
        return value
    array = np.asarray(value)
    return array.tolist() if array.dtype.kind in "fiu" and array.size <= MOST_NUMBERS else None


def _main() -> None:
    # A few bytes of a compressed array may state any size.
    resource.setrlimit(resource.RLIMIT_CPU, (MOST_S, MOST_S))
    resource.setrlimit(resource.RLIMIT_DATA, (MOST_MEMORY_BYTES, MOST_MEMORY_BYTES))
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabOpaque

    try:
        content = loadmat(io.BytesIO(sys.stdin.buffer.read()), simplify_cells=True)
    except NotImplementedError:
        sys.exit("version 7.3 is another format: save it with -v7")
    found = _plain(content)
    if not any(found.values()) and any(isinstance(one, MatlabOpaque) for one in content.values()):
        sys.exit(
            "it holds an object, which only MATLAB reads: save it as a structure, s = toStruct(stereoParams); save('stereo.mat', 's', '-v7')"
        )
    text = json.dumps(found)
    if len(text) > MOST_TEXT_BYTES:
        sys.exit("it holds more numbers than cameras have")
    sys.stdout.write(text)


if __name__ == "__main__":
    _main()
