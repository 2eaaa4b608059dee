"""Owns the environment in which other people's decoders run, and how they are asked.

They need packages that must not be in ours (another OpenCV, another NumPy), so they get a virtual environment of their
own, made when it is first wanted and the package index can be reached.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ENVIRONMENT = Path(".cache/peers")
PACKAGES = ("opencv-contrib-python-headless", "fringes==2.1.0")
INSTALL_TIMEOUT_S, RUN_TIMEOUT_S = 300.0, 400.0


@dataclass(frozen=True, slots=True)
class Foreign:
    """What a peer took, or why it was not asked."""

    cpu_ms: float | None
    why: str | None
    version: str | None


def prepare() -> str | None:
    """Make the environment; ``None`` when it is there, else why it is not."""
    python = ENVIRONMENT / "bin" / "python"
    done = ENVIRONMENT / "complete"
    if done.exists() and python.exists():
        return None
    try:
        subprocess.run([sys.executable, "-m", "venv", str(ENVIRONMENT)], check=True, timeout=INSTALL_TIMEOUT_S)
        subprocess.run(
            [str(python), "-m", "pip", "install", "--quiet", *PACKAGES],
            check=True, timeout=INSTALL_TIMEOUT_S, capture_output=True, text=True,
        )  # fmt: skip
    except subprocess.CalledProcessError as error:
        said = (error.stderr or "").strip().splitlines()
        return f"its packages could not be installed: {said[-1] if said else error}"
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"its environment could not be made: {error}"
    done.touch()
    return None


def ask(program: str, frames: Path) -> Foreign:
    """Run ``bench/peers/<program>.py`` on the frames (.npz)."""
    missing = prepare()
    if missing is not None:
        return Foreign(None, missing, None)
    script = Path(__file__).parent / "peers" / f"{program}.py"
    try:
        ran = subprocess.run(
            [str(ENVIRONMENT / "bin" / "python"), str(script), str(frames)],
            capture_output=True, text=True, timeout=RUN_TIMEOUT_S, check=True,
        )  # fmt: skip
        answer = json.loads(ran.stdout.strip().splitlines()[-1])
        return Foreign(float(answer["cpu_ms"]), None, str(answer["version"]))
    except subprocess.CalledProcessError as error:
        said = error.stderr.strip().splitlines()
        return Foreign(None, f"it failed: {said[-1] if said else error}", None)
    except (subprocess.TimeoutExpired, ValueError, KeyError, IndexError) as error:
        return Foreign(None, f"it gave no answer: {error}", None)
