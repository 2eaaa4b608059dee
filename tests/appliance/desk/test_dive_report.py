"""One page about a dive: what was judged of each scan, its figures and its picture; and a damaged one is on it."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.cli.main import main
from appliance.desk.dive_report import report_of_dive
from appliance.desk.report.content import ReportVerdict
from appliance.desk.report.page import page
from appliance.measure.verdict import Verdict
from appliance.store.library import Library
from tests.support.planes import small_rig, store_plane


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scans of a plane, the second with damaged frames."""
    rig = small_rig(tmp_path_factory.mktemp("dive"))
    store_plane(rig)
    damaged, _ = store_plane(rig)
    path = damaged / "cloud.ply"
    path.chmod(0o644)
    path.write_bytes(path.read_bytes()[:-100])
    return rig.storage.root


def test_the_page_shows_every_scan_with_verdict_figures_and_picture(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "dive.html"
    assert main(["report", "--root", str(root), "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert [one["verdict"] for one in said["scans"]] == ["good", "refused"]
    assert "1 of 2 scans without usable points: 000002" in said["warnings"]
    text = out.read_text()
    assert "default-src 'none'" in text, "it asks for nothing from outside"
    assert not re.search(r"(src|href)=.https?:", text)
    (picture,) = re.findall(r'<img alt="scan 000001: [^"]+" src="data:image/png;base64,([^"]+)"', text)
    image = cv2.imdecode(np.frombuffer(base64.b64decode(picture), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    drawn = np.any(image != 255, axis=2)
    assert 0.4 < drawn.mean() < 0.95, "the plane, with a margin"
    # It is tilted about the rows: the depth changes from above to below, and the colour with it.
    above, below = image[60:100, 200:280].mean(axis=(0, 1)), image[260:300, 200:280].mean(axis=(0, 1))
    assert np.abs(above - below).max() > 40
    row = next(line for line in text.split("<tr>") if "<b>000001</b>" in line)
    cells = [re.sub(r"<[^>]*>", "", cell) for cell in row.split("<td>")]
    assert int(cells[3].replace("\u202f", "")) > 50_000
    assert 400 < float(cells[4].removesuffix(" mm")) < 600


@pytest.mark.parametrize("word", ["good", "usable", "bad", None])
def test_the_page_has_the_grade_that_the_screen_showed_and_what_is_held_against_a_scan(
    root: Path, word: str | None
) -> None:
    entry = Library(root).entry("000001")
    assert entry.manifest is not None
    told = Verdict("motion", False, {}, "7 px"), Verdict("water", True), Verdict("sight", None)
    seen = Verdict("causes", False, {"too_bright_percent": 7.0}, "TOO_BRIGHT 7 %"), Verdict("compensation", True)
    verdicts = told if word is None else (*told, *seen, Verdict("grade", True, {}, word))
    record = replace(entry.manifest.record, verdicts=verdicts, object=3)
    judged = replace(entry, manifest=replace(entry.manifest, record=record))
    report = report_of_dive(root, [judged, entry], lambda *_: None)
    text, (scan, plain) = page(report), report.scans
    assert scan.warnings == ("motion: 7 px",), "the causes say the same once more"
    assert "motion: 7 px" in text
    assert "object 3" in text
    assert plain.ray_gap_mm is not None
    if word is None:
        assert scan.verdict is ReportVerdict.DOUBTFUL
        return
    assert (scan.word, scan.reason, scan.ray_gap_mm) == (word, "object 3; motion corrected", None)
    assert f" {word}</span>" in text
    assert any("000001" in line for line in report.warnings) == (word != "good")


def test_a_page_of_no_scans_or_by_a_wrong_name_is_refused(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words, code, said in (
        (("--root", tmp_path), 2, "no scans"), (("--root", root, "--out", tmp_path / "dive.pdf"), 2, ".html"), (("000009", "--root", root), 1, "9"),
    ):  # fmt: skip
        assert main(["report", *map(str, words)]) == code
        assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    for folder, title in (("dive", "Dive"), ("dive-7", "Dive-7"), ("wreck", "Dive wreck")):
        assert report_of_dive(Path("/somewhere") / folder, [], lambda *_: None).title == title
