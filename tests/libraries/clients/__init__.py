"""Programs for the far side of the device nodes: the shipped drivers on their own libraries, telling what they meet.

Each runs under umockdev's preload library (``tests.libraries.client``), says what happened as JSON lines on standard
output, and waits for a line on standard input where the test has something to look at.
"""

from __future__ import annotations

import json
import sys
from typing import Any


def say(**what: Any) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def wait() -> None:
    sys.stdin.readline()
