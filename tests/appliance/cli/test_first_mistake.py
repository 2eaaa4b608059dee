"""What can be known from words and heads of files is said before anything that computes is loaded or a frame is read, in every verb."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from appliance.cli.output import Exit
from appliance.cli.verbs import Listed
from appliance.store.library import Library
from tests.appliance.cli.test_loaded import EVERY
from tests.appliance.store.scenes import ORIGIN, PREVIEW, cloud, frames, record

HEAVY = (
    "numba", "scipy", "cv2", "distributed", "dask", "trimesh", "skimage", "laspy", "pye57", "plotly", "imagecodecs", "moderngl", "usb",
)  # fmt: skip
"""Each of them costs a tenth of a second and more."""
FRAMES = "frames_"


@dataclass(frozen=True, slots=True)
class Mistake:
    """Words after a verb that cannot be carried out, and what it says then."""

    words: str
    code: Exit
    says: str


NO_RIG = Mistake("--rig GONE.toml", Exit.USAGE, "GONE.toml")
NO_SCAN = Mistake("99 --root ROOT", Exit.FAILED, "no scan '99'")
NO_OBJECT = Mistake("GONE --root ROOT", Exit.FAILED, "object 'GONE': there is none")
NO_ROOT = "--root ROOT/GONE"
MISTAKES: dict[str, Mistake | None] = {
    "run": NO_RIG,
    "sim": NO_RIG,
    "check": NO_RIG,
    "bringup guide": Mistake("--rig GONE.toml --out NEW", Exit.USAGE, "GONE.toml"),
    "bringup trigger": NO_RIG,
    "bringup projector": NO_RIG,
    "firmware board": NO_RIG,
    "firmware keys": NO_RIG,
    "reconstruct": NO_SCAN,
    "rescue": Mistake("99 --root ROOT", Exit.FAILED, "no incomplete recording '99'"),
    "export": NO_SCAN,
    "compare": Mistake("99 TEXT.stl --root ROOT", Exit.FAILED, "no scan '99'"),
    "import": Mistake("GONE.toml", Exit.FAILED, "GONE.toml"),
    "evaluate": Mistake("LIST.toml --root ROOT", Exit.FAILED, "no scan '99'"),
    "scans list": Mistake(NO_ROOT, Exit.USAGE, "no such folder"),
    "scans show": NO_SCAN,
    "scans verify": NO_SCAN,
    "scans name": Mistake("99 pier --root ROOT", Exit.FAILED, "no scan '99'"),
    "scans note": Mistake("99 north --root ROOT", Exit.FAILED, "no scan '99'"),
    "scans trash": NO_SCAN,
    "scans restore": NO_SCAN,
    "scans merge": Mistake("1 99 --root ROOT", Exit.FAILED, "no scan '99'"),
    "object new": Mistake("hull 1 99 --root ROOT", Exit.FAILED, "no scan '99'"),
    "object add": Mistake("GONE 1 --root ROOT", Exit.FAILED, "there is none"),
    "object show": NO_OBJECT,
    "object solve": NO_OBJECT,
    "object export": NO_OBJECT,
    "object compare": Mistake("GONE TEXT.stl --root ROOT", Exit.FAILED, "there is none"),
    "report": NO_SCAN,
    "pull": Mistake("ROOT/GONE NEW", Exit.USAGE, "no scans there"),
    "archive pack": Mistake("GONE --out NEW", Exit.USAGE, "GONE"),
    "archive verify": Mistake("ROOT 99", Exit.FAILED, "99"),
    "archive unpack": Mistake("ROOT 99 --out NEW", Exit.FAILED, "99"),
    "archive frame": Mistake("ROOT/scans/000099 left bright", Exit.USAGE, "no such folder"),
    "reprocess": Mistake("ROOT --out NEW --list LIST.toml", Exit.USAGE, "scan 99"),
    "season": Mistake("GONE.csv", Exit.FAILED, "GONE.csv"),
    "calibration show": Mistake("GONE.json --root ROOT", Exit.FAILED, "GONE.json"),
    "calibration nominal": Mistake("--root ROOT --out GONE/x.json", Exit.USAGE, "no folder GONE"),
    "measure response": NO_SCAN,
    "measure exposures": NO_SCAN,
    "measure noise": NO_SCAN,
    "health show": Mistake("--root ROOT", Exit.FAILED, "current.json"),
    "health accept": Mistake("GONE.json --root ROOT", Exit.FAILED, "current.json"),
    "calibrate air": Mistake("GONE --root ROOT", Exit.USAGE, "no such folder"),
    "calibrate pair": Mistake("GONE --square-mm 15", Exit.USAGE, "no such folder"),
    "calibrate water": Mistake("LIST.toml --root ROOT", Exit.FAILED, "no scan '99'"),
    "calibrate restore": Mistake("0007-2026-01-01.json --root ROOT", Exit.USAGE, "no calibration 0007"),
    "warm": Mistake("--out TEXT.stl", Exit.USAGE, "is a file"),
    "version": None,
}

MORE = {
    "export 1": Mistake("--root ROOT --out x.step", Exit.USAGE, "a scan is written as"),
    "reconstruct 1": Mistake("--root ROOT --calibration GONE.json", Exit.FAILED, "GONE.json"),
    "compare 1": Mistake("GONE --root ROOT", Exit.FAILED, "object 'GONE': there is none"),
    "object solve hull": Mistake("1 --root ROOT --out x.step", Exit.USAGE, "an object is written as"),
    "measure exposures 1": NO_SCAN,
    "scans verify 1": NO_SCAN,
    "import TEXT.stl": Mistake("", Exit.FAILED, "TEXT.stl"),
    "import ROOT": Mistake("--out TEXT.stl", Exit.USAGE, "TEXT.stl"),
}
"""Second mistakes, where another one than the scan's number is usual; by the words that come first."""
ALL = {words: one for words, one in (MISTAKES | MORE).items() if one is not None}

WITHOUT_KERNELS = {
    "firmware board", "firmware keys", "scans list", "scans show", "scans verify", "scans name", "scans note", "scans trash",
    "scans restore", "pull", "archive pack", "archive verify", "archive unpack", "archive frame", "season", "health show",
    "health accept", "calibrate restore", "object show", "warm", "version",
}  # fmt: skip
"""Verbs that import nothing with kernels, however long they work; `warm` says itself where they go."""

CODE = """
import contextlib, io, json, os, sys, time
opened = []
sys.addaudithook(lambda event, given: opened.append(str(given[0])) if event == "open" else None)
from appliance.cli import main
for words, typed in json.load(sys.stdin).items():
    opened.clear()
    os.environ.pop("NUMBA_CACHE_DIR", None)
    before, begun_s, told = set(sys.modules), time.process_time(), io.StringIO()
    with contextlib.redirect_stderr(told):
        try:
            code = main(typed)
        except SystemExit as end:
            code = end.code
    print(json.dumps({
        "words": words, "code": code, "kernels": os.environ.get("NUMBA_CACHE_DIR"), "told": told.getvalue(), "loaded": sorted(set(sys.modules) - before),
        "opened": [name for name in opened if os.path.basename(name).startswith(sys.argv[1])], "cpu_s": time.process_time() - begun_s,
    }))
"""


def place(root: Path) -> None:
    """Make what the mistakes are made with below ``root``: a storage root with one scan, a list of another, a file of text."""
    library = Library(root / "ROOT")
    library.prepare()
    library.begin(frames(1), record(), ORIGIN).publish(record(), cloud(), PREVIEW)
    (root / "LIST.toml").write_text('[[scan]]\nscan = "99"\nartefact = "plane"\n', encoding="utf-8")
    (root / "TEXT.stl").write_text("solid\n", encoding="utf-8")


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, object]]:
    """What came of each mistake; all in one process, so that what one loads is counted once, for the verb that loaded it first."""
    folder = tmp_path_factory.mktemp("mistakes")
    place(folder)
    typed = {words: [*words.split(), *one.words.split()] for words, one in ALL.items()}
    ran = subprocess.run(
        [sys.executable, "-c", CODE, FRAMES], input=json.dumps(typed), cwd=folder, capture_output=True, text=True, timeout=120, check=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    )  # fmt: skip
    return {row["words"]: row for row in map(json.loads, ran.stdout.splitlines())}


def test_every_verb_has_a_first_mistake() -> None:
    assert set(MISTAKES) == {" ".join(words) for words, _ in EVERY}


@pytest.mark.parametrize("words", ALL)
def test_the_first_mistake_is_told_in_one_line_before_anything_that_computes_is_loaded(
    words: str, told: dict[str, dict[str, object]]
) -> None:
    wanted, found = ALL[words], told[words]
    # The instrument's own verbs say where they found kernels, which is no mistake.
    lines = [line for line in str(found["told"]).splitlines() if not line.startswith("kingfisher: kernels:")]
    assert (found["code"], len(lines)) == (wanted.code, 1), found["told"]
    assert wanted.says in lines[0]
    loaded = found["loaded"]
    assert isinstance(loaded, list)
    assert not {name.partition(".")[0] for name in loaded} & set(HEAVY)
    assert found["opened"] == []


@pytest.mark.parametrize(("words", "listed"), EVERY, ids=lambda one: " ".join(one) if isinstance(one, tuple) else "")
def test_the_kernels_folder_is_set_before_any_verb_that_may_import_some(
    words: tuple[str, ...], listed: Listed, told: dict[str, dict[str, object]]
) -> None:
    """Where it was set after the first import, all was compiled twice, and the second time into ``__pycache__``."""
    found = told.get(" ".join(words))
    verb = listed.load()
    assert verb.kernels is (" ".join(words) not in WITHOUT_KERNELS)
    assert found is None or (found["kernels"] is not None) is verb.kernels
