"""Traces the processes that a traced test starts: Python imports this by itself where the folder is on its path.

``KINGFISHER_MUTATE_LINES`` holds a folder and the watched files (JSON); at its end a process writes there which of their
lines it executed.
"""

import atexit
import json
import os
import sys
import threading
from pathlib import Path
from types import FrameType
from typing import Any


def trace(folder: Path, watched: dict[str, str]) -> None:
    """Note the lines of ``watched`` (absolute path: name) that are executed from now on, in all threads."""
    seen: set[tuple[str, int]] = set()

    def call(frame: FrameType, event: str, argument: object) -> Any:
        name = watched.get(frame.f_code.co_filename)
        if name is None:
            return None

        def line(frame: FrameType, event: str, argument: object) -> Any:
            seen.add((name, frame.f_lineno))
            return line

        return line(frame, event, argument)

    def write() -> None:
        sys.settrace(None)
        (folder / f"{os.getpid()}.json").write_text(json.dumps(sorted(seen)))

    atexit.register(write)
    threading.settrace(call)
    sys.settrace(call)


if "KINGFISHER_MUTATE_LINES" in os.environ:
    told = json.loads(os.environ["KINGFISHER_MUTATE_LINES"])
    trace(Path(told["folder"]), told["watched"])
