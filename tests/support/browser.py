"""Chromium without a window and without a network, which looks at our pages."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

CHROMIUM = shutil.which("chromium")
browser = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed (apt-get install chromium)")


def browse(file: Path, folder: Path, *options: str) -> tuple[str, list[str]]:
    """Open a page in Chromium, without a network; return its console, and every address that it asked for."""
    assert CHROMIUM is not None
    words = [
        CHROMIUM, "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars",
        "--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run", "--enable-logging=stderr",
        "--host-resolver-rules=MAP * ~NOTFOUND", "--virtual-time-budget=20000", "--window-size=1200,1600", f"--user-data-dir={folder / 'profile'}",
        f"--log-net-log={folder / 'net.json'}", *options, file.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(words, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    # One event a line; what the browser asks for by itself (the time, updates) has no page as its origin.
    events = (folder / "net.json").read_text(errors="replace").splitlines()
    pages = [line for line in events if '"initiator":"' in line and '"initiator":"not an origin"' not in line]
    asked = [url for line in pages for url in re.findall(r'"url":"((?:https?|wss?|ftp):[^"]*)"', line)]
    return "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line), asked
