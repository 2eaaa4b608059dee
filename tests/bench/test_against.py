"""Two revisions are compared in turns, and what cannot be compared is said with what to do."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from bench.document import AGAINST, AGAINST_BEGIN, AGAINST_END, write_figures
from bench.whole_scan import parts
from bench.whole_scan.against import NoComparison, Side, Tree, compared, other_tree, ratios, table

OURS = {parts.RECORDING: 30.0, parts.LAST_PAIR: 6.0, "motion": 10.0, "sides": 2.0, "fringes": 0.1, parts.FULL: 20.0}
THEIRS = {parts.RECORDING: 10.0, parts.LAST_PAIR: 6.0, "motion": 20.0, "fringes": 0.2, parts.FULL: 40.0}


def test_a_ratio_is_taken_within_each_round() -> None:
    """The machine is ten times slower in one round of three: neither side's sum would say what the rounds say."""
    slowed = ({part: 10.0 * ms for part, ms in OURS.items()}, {part: 10.0 * ms for part, ms in THEIRS.items()})
    said = {one.key: one.value for one in ratios("disc", "abc", [(OURS, THEIRS), slowed, (OURS, THEIRS)])}
    assert said["against_motion"] == pytest.approx(0.5)
    assert said["against_recording"] == pytest.approx(3.0)
    # A judge that only one side has counts where it is waited for.
    assert said["against_verdict"] == pytest.approx(18.1 / 26.2)
    assert said["against_complete_scan"] == pytest.approx(68.1 / 76.2)
    assert "against_sides" not in said
    assert "against_fringes" not in said, "next to nothing has no ratio worth telling"


def test_the_table_has_a_column_for_each_scene_and_gets_into_the_document(tmp_path: Path) -> None:
    measured = [*ratios("disc", "abc", [(OURS, THEIRS)]), *ratios("moving", "abc", [(THEIRS, THEIRS)])]
    (tmp_path / AGAINST).write_text(table("0123456789ab", 1, measured))
    (tmp_path / "latest.json").write_text("{}")
    document = tmp_path / "performance.md"
    document.write_text(
        f"{AGAINST_BEGIN}\n{AGAINST_END}\n<!-- figures: ./dev bench --write-docs -->\n<!-- end of figures -->\n"
    )
    write_figures(tmp_path / "latest.json", document)
    text = document.read_text()
    assert "revision 01234567:" in text
    assert "| motion | 0.50 | — | — | 1.00 |" in text
    assert "light" not in text, "nobody has measured it"


def test_a_revision_that_is_none_or_too_old_is_named(tmp_path: Path) -> None:
    with pytest.raises(NoComparison, match="no-such-thing: git knows no such revision"):
        other_tree("no-such-thing", tmp_path)
    root = subprocess.run(("git", "rev-list", "--max-parents=0", "HEAD"), capture_output=True, text=True, check=True)
    with pytest.raises(NoComparison, match="give a later one"):
        other_tree(root.stdout.split()[0], tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_side_that_ends_says_why() -> None:
    ours = Tree(Path.cwd(), "", dict(os.environ, PYTHONPATH=str(Path.cwd())))
    with pytest.raises(NoComparison, match="no_such_scene"), Side(ours, ("no_such_scene", "64", ".")):
        pass


@pytest.mark.dive
def test_this_tree_against_itself_takes_about_as_long_and_finds_the_same(tmp_path: Path) -> None:
    same = Tree(Path.cwd(), "itself", dict(os.environ, PYTHONPATH=str(Path.cwd())))
    said = {one.key: one.value for one in compared(same, 5, ["disc"], 400, tmp_path)}
    assert 0.7 < said["against_complete_scan"] < 1.4
    assert (said["against_same_points"], said["against_same_judgements"]) == (1.0, 1.0)
