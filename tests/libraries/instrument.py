"""The product as its own process on device nodes: the shipped command line, the shipped drivers, the packaged rig file."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from appliance.measure.calibration.file import encode_calibration
from appliance.store.config import default_rig_path, load_rig
from appliance.store.names import CALIBRATION_FILE
from hw_sim.truth import TrueRig
from hw_sim.wires.umockdev.testbed import Testbed
from tests.support.truth import true_calibration


def rig_file(folder: Path, size: tuple[int, int]) -> Path:
    """The instrument's own file with another storage root, and with cameras of that size."""
    text = default_rig_path().read_text(encoding="utf-8")
    for key, value in (("width_px = 1600", f"width_px = {size[0]}"), ("height_px = 1200", f"height_px = {size[1]}")):
        text = text.replace(key, value)
    text, replaced = re.subn(r'root = ".*"', f'root = "{folder / "root"}"', text)
    assert replaced == 1
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return path


class Instrument:
    """A context manager: ``kingfisher run`` from power on to the end of the block, then SIGTERM."""

    def __init__(self, folder: Path, bed: Testbed, truth: TrueRig, size: tuple[int, int]) -> None:
        rig_path = rig_file(folder, size)
        rig = load_rig(rig_path)
        self.root = rig.storage.root
        calibration = self.root / CALIBRATION_FILE
        calibration.parent.mkdir(parents=True)
        calibration.write_bytes(encode_calibration(true_calibration(truth, rig.rig.serial)))
        self._log_path = folder / "service.log"
        with self._log_path.open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "appliance.cli", "run", "--rig", str(rig_path)],
                env={**os.environ, **bed.environment},
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.terminate()
        try:
            self._process.wait(60.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(60.0)

    @property
    def log(self) -> str:
        return self._log_path.read_text(encoding="utf-8", errors="replace")

    @property
    def status(self) -> dict[str, Any]:
        """The status file; empty before there is one."""
        path = self.root / "run" / "status.json"
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}

    def wait_state(self, *states: str, timeout_s: float) -> dict[str, Any]:
        """The first status in one of these states. Fails with what there is instead, and the end of the log."""
        end = time.monotonic() + timeout_s
        while time.monotonic() < end and self._process.poll() is None:
            status = self.status
            if status.get("state") in states:
                return status
            time.sleep(0.05)
        raise AssertionError(f"waited {timeout_s:g} s for {states}; there is {self.status}\n{self.log[-3000:]}")
