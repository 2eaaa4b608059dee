"""A read-only system is opened for as long as versions change, and not a moment longer."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SYSTEMD = Path(__file__).parents[2] / "systemd"
SCRIPT = """
import os, subprocess, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from kingfisher_setup.writable import writable
root = Path(sys.argv[2])
subprocess.run(["mount", "-t", "tmpfs", "tmpfs", root], check=True)
subprocess.run(["mount", "-o", "remount,ro", root], check=True)
def read_only():
    try:
        (root / "probe").write_text("x")
        return False
    except OSError:
        return True
assert read_only()
try:
    with writable([root / "opt" / "kingfisher", root / "etc", Path("/proc")]):
        assert not read_only()
        raise KeyError
except KeyError:
    pass
assert read_only()
with writable([Path(sys.argv[1])]):
    pass
print("as it should be")
"""


@pytest.mark.skipif(os.geteuid() != 0 or shutil.which("unshare") is None, reason="mounting needs root")
def test_it_is_writable_inside_and_read_only_after_whatever_happens(tmp_path: Path) -> None:
    done = subprocess.run(
        ["unshare", "--mount", "--propagation", "private", sys.executable, "-c", SCRIPT, str(SYSTEMD), str(tmp_path)],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    if "unshare failed" in done.stderr:
        pytest.skip("no mount namespaces here")
    assert done.stdout.strip() == "as it should be", done.stderr
