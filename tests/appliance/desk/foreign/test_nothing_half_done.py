"""What ``import`` does before a minute of compiling, and what it leaves behind where it was cut short."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from appliance.base import kernel_cache
from appliance.cli.output import Exit
from appliance.desk.export.formats import ExportError
from appliance.desk.foreign.first_look import check_import
from appliance.desk.foreign.problem import ForeignError
from tests.support.commands import ROOT, Shell
from tests.support.foreign_sets import ForeignSet
from tests.support.system_calls import seen_by_python

Sets = Callable[[str], ForeignSet]


@contextmanager
def no_file_larger_than(most_bytes: int) -> Iterator[None]:
    """As a full disk refuses, for this process."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_description_that_cannot_be_followed_costs_no_minute_of_compiling(foreign_set: Sets, tmp_path: Path) -> None:
    """With no kernel compiled yet: the cameras' file lacks a matrix, and that is all that is said and done."""
    described = foreign_set("three-steps").described(('files = ["stereo.yml"]', 'files = ["half.yml"]'))
    (described.parent / "half.yml").write_text("M1: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n")
    compiled = tmp_path / "compiled"
    bare = {name: value for name, value in os.environ.items() if name != kernel_cache.VARIABLE}
    done = subprocess.run(
        [sys.executable, "-m", "appliance.cli", "import", described, "--out", tmp_path / "cloud.ply"],
        cwd=ROOT, capture_output=True, text=True, timeout=240, check=False, env={**bare, "CACHE_DIRECTORY": str(compiled)},
    )  # fmt: skip
    assert done.returncode == Exit.FAILED
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert "have no right_matrix, rotation, translation under a known name" in done.stderr
    assert [path for path in compiled.rglob("*") if path.suffix in (".nbi", ".nbc")] == []


@pytest.mark.parametrize(
    ("changes", "out", "said"),
    [
        ((("three-steps", "nothing"),), "c.ply", "No such file or directory; give the image set description"),
        ((("[images]", "[images"),), "c.ply", "correct that line"),
        ((('left = "*_left.png"', 'left = "*_port.png"'),), "c.ply", "no file is called '*_port.png'"),
        ((("sine-x*3", "sine-x*4"),), "c.ply", "10 images (00_left.png to 09_left.png), and images.order names 11 images"),
        ((), "c.xyz", "a cloud is written as .ply, .e57, .las, .npz"),
        ((), "000001", "no scan folder can be made: it has fringes of one direction only, x"),
        ((), "none/000001", "there is no folder"),
    ],
)  # fmt: skip
def test_what_takes_no_time_is_looked_at_first(
    foreign_set: Sets, tmp_path: Path, changes: tuple[tuple[str, str], ...], out: str, said: str
) -> None:
    made = foreign_set("three-steps")
    missing = changes and changes[0][1] == "nothing"
    described = tmp_path / "nothing.toml" if missing else made.described(*changes)
    with pytest.raises((ForeignError, ExportError)) as error:
        check_import(described, tmp_path / out)
    assert said in str(error.value)


@pytest.mark.dive
def test_a_full_disk_leaves_no_half_scan_and_the_name_free(shell: Shell, foreign_set: Sets, tmp_path: Path) -> None:
    made, out = foreign_set("two-directions"), tmp_path / "scans"
    out.mkdir()
    # Kernels are compiled by now, and only the scan's own files are too large.
    assert shell("import", made.description, "--out", tmp_path / "before").code == Exit.OK
    with no_file_larger_than(300_000):
        refused = shell("import", made.description, "--out", out / "000001")
    assert refused.code == Exit.FAILED
    assert "cannot write" in refused.err
    assert list(out.iterdir()) == []
    # A process that was killed leaves what it had: it is in nobody's way.
    draft = out / ".000001.draft"
    draft.mkdir()
    (draft / "frames_left.npy").write_bytes(b"half of it")
    said = shell("import", made.description, "--out", out / "000001")
    assert said.code == Exit.OK, said.err
    assert [path.name for path in out.iterdir()] == ["000001"]
    assert shell("scans", "verify", "--root", tmp_path).code == Exit.OK


def test_a_guess_is_there_whole_or_not_at_all(shell: Shell, foreign_set: Sets, tmp_path: Path) -> None:
    described = tmp_path / "cloud.toml"

    def work() -> None:
        folder = foreign_set("two-directions").description.parent
        assert shell("import", folder, "--out", tmp_path / "cloud.ply").code == 0

    calls = [call for call in seen_by_python(work) if tmp_path in call.path.parents]
    assert [call.name for call in calls][:2] == ["fsync", "rename"]
    assert described in {call.target for call in calls if call.name == "rename"}
