"""Environment of other programs' decoders, and the calls to them.

They need packages that must not be in ours (another OpenCV, another NumPy), so they get a virtual environment of their
own, made when it is first wanted and the package index can be reached. A peer's process stays for the run and decodes
once each time it is told to, so that its turns lie between the product's.
"""

from __future__ import annotations

import json
import select
import subprocess
import sys
import tempfile
from pathlib import Path
from types import TracebackType
from typing import IO, Any

ENVIRONMENT = Path(".cache/peers")
PACKAGES = ("opencv-contrib-python-headless==5.0.0.93", "fringes==2.1.0")
PROGRAMS = {"cv2_structured_light": "graycode", "fringes": "fringes_package"}
"""Of ``bench/peers``, by the name under which their numbers are written."""
INSTALL_TIMEOUT_S, START_TIMEOUT_S, DECODE_TIMEOUT_S, STOP_TIMEOUT_S = 300.0, 200.0, 60.0, 5.0


class PeerFailed(Exception):
    """There is no number, and why."""


def prepare(environment: Path = ENVIRONMENT) -> Path:
    """Make the environment unless it exists; return its interpreter. Raises PeerFailed."""
    python = environment / "bin" / "python"
    done = environment / "complete"
    package_list = "\n".join(PACKAGES)
    if python.exists() and done.exists() and done.read_text(encoding="utf-8") == package_list:
        return python
    try:
        subprocess.run(
            [sys.executable, "-m", "venv", "--clear", str(environment)],
            check=True, timeout=INSTALL_TIMEOUT_S, capture_output=True, text=True,
        )  # fmt: skip
        subprocess.run(
            [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *PACKAGES],
            check=True, timeout=INSTALL_TIMEOUT_S, capture_output=True, text=True,
        )  # fmt: skip
    except subprocess.CalledProcessError as error:
        lines = (error.stderr or "").strip().splitlines()
        raise PeerFailed(f"its packages could not be installed: {lines[-1] if lines else error}") from error
    except (OSError, subprocess.TimeoutExpired) as error:
        raise PeerFailed(f"its environment could not be made: {error}") from error
    done.write_text(package_list, encoding="utf-8")
    return python


class Peer:
    """One foreign decoder with our frames loaded. A context manager."""

    def __init__(self, python: Path, script: Path, frames: Path) -> None:
        self._command = [str(python), str(script), str(frames)]
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 (closed with the process)
        self._process: subprocess.Popen[bytes] | None = None
        self.version = ""

    def __enter__(self) -> Peer:
        try:
            self._process = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, bufsize=0
            )
            self.version = str(self._answer("version", START_TIMEOUT_S))
        except OSError as error:
            self._stop()
            raise PeerFailed(f"it could not be started: {error}") from error
        except PeerFailed:
            self._stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()

    def decode(self) -> float:
        """Decode once, and return the CPU time of the process in ms. Raises PeerFailed."""
        process = self._process
        if process is None or process.stdin is None:
            raise PeerFailed("it is not running; ask it inside the context")
        try:
            process.stdin.write(b"\n")
        except OSError as error:
            raise PeerFailed(f"it ended: {self._last_words()}") from error
        return float(self._answer("cpu_ms", DECODE_TIMEOUT_S))

    def _answer(self, key: str, timeout_s: float) -> Any:
        process = self._process
        if process is None or process.stdout is None:
            raise PeerFailed("it is not running; ask it inside the context")
        if not select.select([process.stdout], [], [], timeout_s)[0]:
            raise PeerFailed(f"it gave no answer within {timeout_s:.0f} s")
        line = process.stdout.readline()
        try:
            return json.loads(line)[key]
        except (ValueError, KeyError, TypeError) as error:
            raise PeerFailed(f"it gave no {key}: {self._last_words() or line!r}") from error

    def _last_words(self) -> str:
        return last_words(self._errors)

    def _stop(self) -> None:
        process, self._process = self._process, None
        end_process(process, self._errors)


def last_words(errors: IO[bytes]) -> str:
    """Return the last line that a process wrote to ``errors``, or an empty text."""
    errors.seek(0)
    lines = errors.read().decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else ""


def end_process(process: subprocess.Popen[bytes] | None, errors: IO[bytes]) -> None:
    """Close the pipes of a process (``None``: never started), wait for its end, kill it after a timeout, close
    ``errors``."""
    if process is not None:
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()
        try:
            process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(STOP_TIMEOUT_S)
    errors.close()
