"""The mutation runner notices a weak test, keeps its limit, and never touches the working tree."""

from __future__ import annotations

import re
import subprocess
import time
from pathlib import Path

import pytest

from tests.mutate import argued
from tests.mutate.campaign import Campaign, Result, share, table
from tests.mutate.choice import Choice, candidates_of, wider
from tests.mutate.mutants import Mutant, draw, mutants_of
from tests.mutate.names import Names
from tests.mutate.tree import HEAVY, Tree

ROOT = Path(__file__).parents[2]


def changes(text: str) -> set[str]:
    return {one.applied(text).strip() for one in mutants_of("appliance/example.py", text)}


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("def f(a, b):\n    return a < b", {"a <= b", "a >= b", "True", "False"}),
        ("def f(a, b):\n    return a + b", {"a - b", "None"}),
        ("def f(a):\n    return (a  # + here\n    + 1)", {"(a  # + here\n    - 1)", "(a  # + here\n    + 2)"}),
        ("def f(a, b):\n    return a and not b", {"a or not b", "a and (b)", "True", "False"}),
        ("def f(a):\n    return a is None", {"a is not None"}),
        ("def f(a):\n    return a not in (1, 2)", {"a in (1, 2)"}),
        ("def f(a):\n    return -abs(a)", {"(abs(a))", "-(a)"}),
        ("def f(a, b):\n    return g(a, b)", {"g(b, a)", "None"}),
        ("def f(a):\n    return a[1:-2]", {"a[(1) + 1:-2]", "a[1:(-2) - 1]", "a[2:-2]"}),
        ("def f(a):\n    return max(a, 0.5)", {"min(a, 0.5)", "max(a, 1.0)", "max(a, 0.25)"}),
        ("def f(a):\n    return [x for x in a if x]", {"[x for x in a if True]"}),
        ("def f(ß):\n    return ß + 'ä' + g(ß)", {"ß - 'ä' + g(ß)"}),
    ],
)
def test_each_operator_changes_what_it_names(text: str, wanted: set[str]) -> None:
    found = {one.partition("return ")[2] for one in changes(text)}
    assert wanted <= found, found


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("def f():\n    g()\n    h()", "def f():\n    pass\n    h()"),
        ("def f(s):\n    s.a = 1", "def f(s):\n    pass"),
        ("def f():\n    raise ValueError('no')", "def f():\n    pass"),
        ("def f(a):\n    if a:\n        g()", "def f(a):\n    if False:\n        g()"),
        ("def f(a):\n    if a:\n        g()", "def f(a):\n    if not (a):\n        g()"),
        ("def f(a):\n    for x in a:\n        break", "def f(a):\n    for x in a:\n        pass"),
        ("LIMIT = 20.0", "LIMIT = 40.0"),
        ("class A:\n    tries: int = 3", "class A:\n    tries: int = 4"),
        ("def f(tries=3):\n    return", "def f(tries=3):\n    return"),
    ],
)
def test_each_kind_of_statement_has_its_mutants(text: str, wanted: str) -> None:
    assert wanted in changes(text) | {text}


def test_what_is_written_for_people_and_type_checkers_is_left_alone() -> None:
    text = '''"""A file about 3 things."""
from __future__ import annotations
Kind = "a+b"
def f(a: Literal[3], s: Self) -> tuple[int, ...]:
    """Return 3 + 4."""
    assert a is not None
    s.log.info("%d lines", 3)
'''
    assert changes(text) == set()


def test_every_mutant_of_this_project_parses_and_says_what_it_changes() -> None:
    text = (ROOT / "appliance/optics/port.py").read_text()
    mutants = mutants_of("appliance/optics/port.py", text)
    assert len(mutants) > 50
    for one in mutants:
        compile(one.applied(text), one.path, "exec")
        assert one.before != one.after
        assert one.before in " ".join(text.split())
    assert {one.within for one in mutants} >= {"", "water_rays", "refract"}


def test_a_seed_draws_the_same_mutants_again_and_no_line_twice_before_every_line_once() -> None:
    mutants = mutants_of("appliance/optics/port.py", (ROOT / "appliance/optics/port.py").read_text())
    lines = len({one.line for one in mutants})
    first = draw(mutants, lines, 5)
    assert first == draw(mutants, lines, 5) != draw(mutants, lines, 6)
    assert len({one.line for one in first}) == lines
    assert len(draw(mutants, 10**6, 5)) == len(mutants)


OVER = "def is_over(value, top):\n    return value > top\n"


def boundary(text: str) -> Mutant:
    return next(one for one in mutants_of("appliance/limits.py", text) if one.operator == "> to >=")


def test_a_mutant_keeps_its_key_and_its_argument_where_its_line_moves_to() -> None:
    here, there = boundary(OVER), boundary("import math\n\n\n" + OVER)
    assert here.key == there.key
    assert (here.line, there.line) == (2, 5)
    text = "# why\n\nappliance/limits.py · is_over\n- return value > top\n+ return value >= top\n  Nobody is equal.\n"
    arguments = argued.read(text)
    assert argued.why(arguments, there) == "Nobody is equal."
    assert argued.why(arguments, boundary(OVER.replace("is_over", "exceeds"))) is None


@pytest.mark.parametrize(
    "text",
    [
        "appliance/limits.py · f\n- a\n+ b\n",
        "appliance/limits.py · f\n+ b\n- a\n  why\n",
        "appliance/limits.py · f\n- a\n+ b\nwhy\n",
        "appliance/limits.py · f\n- a\n+ b\n  why\n- a\n+ c\n  why\n",
        "appliance/limits.py · f\n- a\n+ b\nappliance/limits.py · g\n- a\n+ b\n  why\n",
        "appliance/limits.py · f()\n  - a\n",
        "appliance/limits.py f\n- a\n+ b\n  why · f\n",
    ],
    ids=["no reason", "order", "not indented", "two in one", "no reason before another", "too short", "no dot"],
)
def test_an_argument_of_another_form_is_refused_with_its_name(text: str) -> None:
    with pytest.raises(argued.Unreadable, match=r"appliance/limits\.py ·? ?f"):
        argued.read(text)


def test_an_entry_begins_where_a_file_and_a_function_are_named_with_or_without_a_blank_line_before() -> None:
    """A merge that lost one blank line made the whole file unreadable."""
    one = "appliance/limits.py · is_over\n- a\n+ b\n  why\n  it is · so\n"
    two = "appliance/limits.py ·\n- TOP = 1\n+ TOP = 2\n  Nothing is so high.\n"
    apart, together = argued.read(f"# head\n\n{one}\n{two}"), argued.read(f"# head\n{one}{two}")
    assert together == apart
    assert [(found.path, found.within, found.why) for found in together] == [
        ("appliance/limits.py", "is_over", "why it is · so"),
        ("appliance/limits.py", "", "Nothing is so high."),
    ]


def test_every_argument_speaks_of_a_change_that_can_still_be_made() -> None:
    arguments = argued.read(argued.FILE.read_text(encoding="utf-8"))
    for one in arguments:
        text = (ROOT / one.path).read_text(encoding="utf-8")
        assert one.before in " ".join(text.split()), f"{one.path} · {one.within}: {one.before}"
        assert all(re.search(rf"(def|class) {name}\b", text) for name in one.within.split(".") if name), one.within


KERNELS = {
    "appliance/a.py": "from numba import njit\nHALF = 0.5\n@njit\ndef inner(x):\n    return x * HALF\n",
    "appliance/b.py": "from numba import njit\nfrom appliance.a import inner\n@njit\ndef outer(x):\n    return inner(x)\n"
    "@njit\ndef other(x):\n    return x\n",
    "appliance/c.py": "from appliance import b\ndef plain(x):\n    return b.outer(x)\n",
    "drivers/d.py": "",
    "hw_sim/e.py": "",
}


def test_callers_in_other_files_are_stale_when_what_they_inlined_changes(tmp_path: Path) -> None:
    write(tmp_path, KERNELS)
    names = Names(tmp_path)
    half = names.at("appliance/a.py", 2)
    assert half is not None
    assert names.stale_kernels(half) == {("appliance/a.py", "inner"), ("appliance/b.py", "outer")}
    assert [one.name for one in names.workers(half)] == ["plain"]
    alone = names.at("appliance/b.py", 7)
    assert alone is not None
    assert names.stale_kernels(alone) == {("appliance/b.py", "other")}


PROJECT = {
    "pyproject.toml": '[tool.pytest.ini_options]\naddopts = "--import-mode=importlib"\npythonpath = ["."]\n',
    ".gitignore": "/.cache/\n__pycache__/\n",
    "appliance/__init__.py": "",
    "appliance/limits.py": OVER + "\n\ndef count(n):\n    i = 0\n    while i < n:\n        i += 1\n    return i\n",
    "drivers/__init__.py": "",
    "hw_sim/__init__.py": "",
    "tests/__init__.py": "",
    "tests/appliance/test_limits.py": "from appliance.limits import count, is_over\n\n"
    "def test_over():\n    assert is_over(5, 3)\n    assert not is_over(2, 3)\n\n"
    "def test_count():\n    assert count(3) == 3\n",
    "tests/integration/test_far.py": "from tests.support import limit\n\ndef test_far():\n    assert limit() == 3\n",
    "tests/support.py": "import appliance.limits\n\ndef limit():\n    return 3\n",
}


def write(root: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def contents(root: Path) -> dict[str, tuple[str, int]]:
    return {
        path.relative_to(root).as_posix(): (path.read_text(), path.stat().st_mtime_ns)
        for path in root.rglob("*")
        if path.is_file() and ".git" not in path.parts and ".cache" not in path.parts
    }


WANTED = {"> to >=", "> to <=", "statement removed"}


def run(root: Path, said: list[str], wanted: set[str] = WANTED) -> list[Result]:
    home = root / ".cache" / "mutate"
    file = "appliance/limits.py"
    with Tree.taken(root, home, heavy=HEAVY[:4]) as tree:
        names = Names(tree.path)
        campaign = Campaign(tree, names, Choice(tree, names, home), [], home, limit_s=1.0, budget_s=60.0)
        mutants = [one for one in mutants_of(file, tree.text(file)) if one.operator in wanted]
        return campaign.run(mutants, fresh=False, confirm=False, say=said.append)


def test_a_weak_test_is_noticed_a_mutant_that_hangs_is_ended_and_the_working_tree_is_never_touched(
    tmp_path: Path,
) -> None:
    write(tmp_path, PROJECT)
    subprocess.run(["git", "init", "-q", "."], cwd=tmp_path, check=True, timeout=30)
    before = contents(tmp_path)
    began = time.monotonic()
    said: list[str] = []
    found = {one.mutant.operator: one for one in run(tmp_path, said)}
    assert {name: one.status for name, one in found.items()} == {
        "> to >=": "survived",
        "> to <=": "killed",
        "statement removed": "timed out",
    }
    assert found["> to <="].by == "tests/appliance/test_limits.py::test_over"
    assert found["> to >="].tests == 1, "only one of the tests executes the line"
    assert time.monotonic() - began < 120.0
    assert contents(tmp_path) == before
    assert share(list(found.values())) == pytest.approx(200 / 3)
    assert "66.7 %" in table([("appliance", list(found.values()))])

    again: list[str] = []
    run(tmp_path, again)
    assert all("known" in line for line in again), again
    stronger = PROJECT["tests/appliance/test_limits.py"].replace("is_over(2, 3)", "is_over(3, 3)")
    write(tmp_path, {"tests/appliance/test_limits.py": stronger})
    assert {one.status for one in run(tmp_path, [])} == {"killed", "timed out"}


def test_a_line_that_runs_in_a_process_of_a_test_is_reached(tmp_path: Path) -> None:
    apart = (
        "import subprocess, sys\n\ndef test_apart():\n    said = 'from appliance.limits import count; print(count(2))'\n"
        "    assert subprocess.run([sys.executable, '-c', said], capture_output=True).stdout == b'2\\n'\n"
    )
    child = "tests/mutate/child/sitecustomize.py"
    write(tmp_path, PROJECT | {"tests/appliance/test_limits.py": apart, child: (ROOT / child).read_text()})
    subprocess.run(["git", "init", "-q", "."], cwd=tmp_path, check=True, timeout=30)
    found = {one.mutant.operator: one.status for one in run(tmp_path, [], {"> to >=", "returned None"})}
    assert found == {"> to >=": "not reached", "returned None": "killed"}


def test_the_tests_of_a_file_are_those_of_its_folder_first_and_then_all_that_import_it(tmp_path: Path) -> None:
    write(tmp_path, PROJECT)
    near = candidates_of(tmp_path, "appliance/limits.py")
    assert near == ["tests/appliance/test_limits.py"]
    assert wider(tmp_path, "appliance/limits.py", tuple(near)) == ["tests/integration/test_far.py"]


def test_a_test_that_calls_a_compiled_kernel_itself_judges_it(tmp_path: Path) -> None:
    direct = "from appliance.b import outer\n\ndef test_outer():\n    assert outer(4.0) == 2.0\n"
    write(tmp_path, PROJECT | KERNELS | {"tests/appliance/test_limits.py": direct})
    subprocess.run(["git", "init", "-q", "."], cwd=tmp_path, check=True, timeout=30)
    home = tmp_path / ".cache" / "mutate"
    with Tree.taken(tmp_path, home, heavy=HEAVY[:4]) as tree:
        choice = Choice(tree, Names(tree.path), home)
        inner, other = (
            next(one for one in mutants_of(path, tree.text(path)) if one.within == name)
            for path, name in (("appliance/a.py", "inner"), ("appliance/b.py", "other"))
        )
        assert choice.for_mutant(inner, 60.0).tests == ("tests/appliance/test_limits.py::test_outer",)
        assert choice.for_mutant(other, 60.0).tests == ()


SUM = """from numba import njit


@njit
def total(values):
    found = 0.0
    for k in range(len(values)):
        found += values[k]
    return found
"""
INTERPRETED = """import time
import numba
import numpy as np
from appliance.total import total

def test_it_is_compiled():
    assert not numba.config.DISABLE_JIT

def test_nothing_goes_over_the_edge():
    total(np.ones(3))[0]

def test_it_takes_its_time():
    end = time.process_time() + (60.0 if numba.config.DISABLE_JIT else 0.0)
    while time.process_time() < end:
        pass

def test_total():
    assert total(np.array([1.0, 2.0])) == 3.0
"""


def test_with_kernels_as_plain_python_only_a_broken_assertion_counts_and_no_test_takes_long(tmp_path: Path) -> None:
    """An index beyond an array raises there; compiled, the kernel goes on with some number."""
    file = "tests/appliance/test_total.py"
    write(tmp_path, PROJECT | {"appliance/total.py": SUM, file: INTERPRETED})
    subprocess.run(["git", "init", "-q", "."], cwd=tmp_path, check=True, timeout=30)
    with Tree.taken(tmp_path, tmp_path / ".cache" / "mutate", heavy=HEAVY[:4]) as tree:
        run = tree.run([file], 30.0, interpreted=True, most_s=0.5)
        outcomes = {name.partition("::test_")[2]: outcome for name, (outcome, _) in run.tests.items()}
        assert outcomes == {
            "it_is_compiled": "failed",
            "nothing_goes_over_the_edge": "raised",
            "it_takes_its_time": "raised",
            "total": "passed",
        }
        names = Names(tree.path)
        home = tmp_path / ".cache" / "mutate"
        choice = Choice(tree, names, home)
        minus = next(one for one in mutants_of("appliance/total.py", SUM) if one.after == "found -= values[k]")
        assert choice.interpreted(minus, 60.0).tests == (f"{file}::test_total",)


def test_a_mutant_of_a_kernel_is_judged_as_plain_python_first_and_compiled_if_nothing_breaks(tmp_path: Path) -> None:
    weak = "import numpy as np\nfrom appliance.total import total\n\ndef test_total():\n"
    weak += "    assert total(np.array([1.0, 2.0])) > 0.0\n"
    write(tmp_path, PROJECT | {"appliance/total.py": SUM, "tests/appliance/test_limits.py": weak})
    subprocess.run(["git", "init", "-q", "."], cwd=tmp_path, check=True, timeout=30)
    home = tmp_path / ".cache" / "mutate"
    wanted = {"found -= values[k]", "found = 1.0"}
    found: dict[bool, dict[str, tuple[str, str]]] = {}
    for interpret in (True, False):
        with Tree.taken(tmp_path, home, heavy=HEAVY[:4]) as tree:
            names = Names(tree.path)
            choice = Choice(tree, names, home)
            campaign = Campaign(tree, names, choice, [], home, limit_s=30.0, budget_s=60.0, interpret=interpret)
            mutants = [one for one in mutants_of("appliance/total.py", SUM) if one.after in wanted]
            results = campaign.run(mutants, fresh=False, confirm=False, say=lambda line: None)
            found[interpret] = {one.mutant.after: (one.status, one.by) for one in results}
    test = "tests/appliance/test_limits.py::test_total"
    assert found[True] == {"found -= values[k]": ("killed", f"{test} (interpreted)"), "found = 1.0": ("survived", "")}
    assert found[False] == {"found -= values[k]": ("killed", test), "found = 1.0": ("survived", "")}
