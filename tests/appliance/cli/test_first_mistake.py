"""What can be known from words and heads of files is said before anything that computes is loaded or a frame is read, in every verb."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass, fields
from pathlib import Path

import pytest

from appliance.cli.output import Exit
from appliance.cli.verbs import VERBS, VerbEntry
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
MISTAKES = {
    "run": NO_RIG,
    "sim": NO_RIG,
    "check": NO_RIG,
    "scans list": Mistake(NO_ROOT, Exit.USAGE, "no such folder"),
    "scans show": NO_SCAN,
    "scans verify": NO_SCAN,
    "scans label": Mistake("99 --name pier --root ROOT", Exit.FAILED, "no scan '99'"),
    "scans trash": NO_SCAN,
    "scans restore": NO_SCAN,
    "cloud": NO_SCAN,
    "import": Mistake("GONE.toml", Exit.FAILED, "GONE.toml"),
    "object add": Mistake("hull 1 99 --root ROOT", Exit.FAILED, "no scan '99'"),
    "object show": NO_OBJECT,
    "object solve": NO_OBJECT,
    "compare": Mistake("99 TEXT.stl --root ROOT", Exit.FAILED, "no scan '99'"),
    "report": NO_SCAN,
    "evaluate": Mistake("LIST.toml --root ROOT", Exit.FAILED, "no scan '99'"),
    "calibration show": Mistake("GONE.json --root ROOT", Exit.FAILED, "GONE.json"),
    "calibration air": Mistake("GONE --root ROOT", Exit.USAGE, "no such folder"),
    "calibration water": Mistake("LIST.toml --root ROOT", Exit.FAILED, "no scan '99'"),
    "calibration use": Mistake("0007-2026-01-01.json --root ROOT", Exit.USAGE, "no calibration 0007"),
    "calibration measure": Mistake("noise 99 --root ROOT", Exit.FAILED, "no scan '99'"),
    "calibration accept": Mistake("GONE.json --root ROOT", Exit.FAILED, "current.json"),
    "archive pull": Mistake("ROOT/GONE --out NEW", Exit.USAGE, "no scans there"),
    "archive pack": Mistake("GONE --out NEW", Exit.USAGE, "GONE"),
    "archive unpack": Mistake("ROOT 99 --out NEW", Exit.FAILED, "99"),
    "archive reprocess": Mistake("ROOT LIST.toml --out NEW", Exit.USAGE, "scan 99"),
    "setup guide": Mistake("--rig GONE.toml --out NEW", Exit.USAGE, "GONE.toml"),
    "setup measure": Mistake("trigger --rig GONE.toml", Exit.USAGE, "GONE.toml"),
    "setup firmware": Mistake("board --rig GONE.toml", Exit.USAGE, "GONE.toml"),
    "setup compile": Mistake("--out TEXT.stl", Exit.USAGE, "is a file"),
}

MORE = {
    "setup measure projector": NO_RIG,
    "cloud incomplete:99": Mistake("--root ROOT", Exit.FAILED, "no incomplete recording '99'"),
    "cloud 1+99": Mistake("--root ROOT", Exit.FAILED, "no scan '99'"),
    "cloud object:GONE": Mistake("--root ROOT", Exit.FAILED, "object 'GONE': there is none"),
    "cloud object:hull": Mistake("--root ROOT --out x.step", Exit.USAGE, "an object is written as"),
    "cloud 1": Mistake("--root ROOT --out x.step", Exit.USAGE, "a scan is written as"),
    "cloud 1 --out x.npz": Mistake("--root ROOT --calibration GONE.json", Exit.FAILED, "GONE.json"),
    "compare 1": Mistake("GONE.stl --root ROOT", Exit.FAILED, "GONE.stl"),
    "compare 1 object:GONE": Mistake("--root ROOT", Exit.FAILED, "object 'GONE': there is none"),
    "compare object:GONE": Mistake("TEXT.stl --root ROOT", Exit.FAILED, "there is none"),
    "report GONE.csv": Mistake("", Exit.FAILED, "GONE.csv"),
    "report object:GONE": Mistake("--root ROOT", Exit.FAILED, "object 'GONE': there is none"),
    "scans verify 1": NO_SCAN,
    "scans show 1 left bright": Mistake("--root ROOT --out GONE/x.png", Exit.USAGE, "no folder GONE"),
    "calibration show nominal": Mistake("--root ROOT --out GONE/x.json", Exit.USAGE, "no folder GONE"),
    "calibration use GONE/x.json": Mistake("--root ROOT", Exit.FAILED, "GONE/x.json"),
    "calibration air GONE --pair theirs": Mistake("--board 15", Exit.USAGE, "no such folder"),
    "calibration measure exposures 1": NO_SCAN,
    "import TEXT.stl": Mistake("", Exit.FAILED, "TEXT.stl"),
    "import ROOT": Mistake("--out TEXT.stl", Exit.USAGE, "TEXT.stl"),
}
"""Mistakes of a verb's other ways, and second ones, where another one than the scan's number is usual; by the words that come first."""
ALL = MISTAKES | MORE

WITHOUT_KERNELS = {
    "scans list", "scans show", "scans verify", "scans label", "scans trash", "scans restore", "object show", "calibration use",
    "calibration accept", "archive pull", "archive pack", "archive unpack", "setup firmware", "setup compile",
}  # fmt: skip
"""Verbs that import nothing with kernels, however long they work; `setup compile` says itself where they go."""
MOST_VERBS, MOST_WORDS, MOST_OPTIONS = 31, 14, 45

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


def test_every_verb_has_a_first_mistake_and_their_words_stay_few() -> None:
    assert set(MISTAKES) == {" ".join(words) for words, _ in EVERY}
    options = {one.metadata["typed"].flag for _, verb in EVERY for one in fields(verb.load())} - {None}
    assert (len(EVERY) <= MOST_VERBS, len(VERBS) <= MOST_WORDS, len(options) <= MOST_OPTIONS) == (True, True, True)


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
    words: tuple[str, ...], listed: VerbEntry, told: dict[str, dict[str, object]]
) -> None:
    """Where it was set after the first import, all was compiled twice, and the second time into ``__pycache__``."""
    found = told.get(" ".join(words))
    verb = listed.load()
    assert verb.kernels is (" ".join(words) not in WITHOUT_KERNELS)
    assert found is None or (found["kernels"] is not None) is verb.kernels
