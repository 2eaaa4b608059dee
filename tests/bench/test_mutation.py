"""The mutation tool makes the changes that it names, finds them again, knows who reaches them and notices a weak test."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from bench.mutation.__main__ import Reached
from bench.mutation.mutants import draw, find, mutants_of, read
from bench.mutation.names import Names
from bench.mutation.tree import Tree

LIMITS = "def is_over(value, top):\n    return value > top\n\n\ndef count(n):\n    i = 0\n    while i < n:\n        i += 1\n    return i\n"
KERNEL = "from numba import njit\n\nHALF = 0.5\n\n\n@njit(cache=True)\ndef half(x):\n    return x * HALF\n"
FILES = {
    ".gitignore": "/.cache/\n__pycache__/\n",
    "pyproject.toml": '[tool.pytest.ini_options]\naddopts = "--import-mode=importlib"\npythonpath = ["."]\n',
    "appliance/limits.py": LIMITS,
    "appliance/kernel.py": KERNEL,
    "appliance/plain.py": "from appliance import kernel\n\n\ndef plain(x):\n    return kernel.half(x)\n",
    "drivers/d.py": "",
    "hw_sim/e.py": "",
    "tests/test_limits.py": "import subprocess, sys\nimport pytest\nfrom appliance.limits import count, is_over\n"
    "from appliance.plain import plain\n\n\n@pytest.fixture(scope='module')\ndef counted():\n    return count(3)\n\n\n"
    "def test_over():\n    assert is_over(5, 3)\n    assert not is_over(2, 3)\n\n\ndef test_nothing(counted):\n    pass\n\n\n"
    "def test_count(counted):\n    assert counted == 3\n\n\ndef test_half():\n    assert plain(4.0) == 2.0\n\n\n"
    "def test_apart():\n    said = 'from appliance.limits import is_over; print(is_over(2, 1))'\n"
    "    assert subprocess.run([sys.executable, '-c', said], capture_output=True).stdout == b'True\\n'\n",
}


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("def f(a, b):\n    return a < b", {"return a <= b", "return None"}),
        ("def f(a):\n    return (a  # + here\n    + 1)", {"- 1)", "+ 2)", "return (None)"}),
        (
            "def f(a, b):\n    if a is not b or c:\n        g()",
            {"if a is b or c:", "if not (a is not b or c):", "pass"},
        ),
        (
            "def f(ß):\n    ß[0] += max(-ß, 0.5)",
            {"ß[0] += max(-ß, 1.0)", "ß[0] += min(-ß, 0.5)", "ß[0] += max((ß), 0.5)"},
        ),
        ("def f(a):\n    for x in a:\n        break", {"pass"}),
        ("LIMIT = 20.0", {"LIMIT = 40.0"}),
        ('def f(s: Literal[3]):\n    """Three."""\n    s.log.info("%d", 3)\n    raise ValueError(f"{1}")', {"pass"}),
    ],
)
def test_each_operator_changes_what_it_names(text: str, wanted: set[str]) -> None:
    found = {one.listed.after for one in mutants_of("appliance/f.py", text + "\n")}
    assert wanted <= found
    assert found == wanted or wanted != {"pass"}, "text for people is left alone"


@pytest.fixture
def project(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
        (tmp_path / name).with_name("__init__.py").touch()
    (tmp_path / "__init__.py").unlink()
    subprocess.run(["git", "init", "-q", "."], cwd=tmp_path, check=True, timeout=30)
    return tmp_path


def test_a_seed_draws_the_same_again_and_every_file_once_before_one_twice(project: Path) -> None:
    drawn = draw(project, ["appliance/*", "!appliance/plain.py"], 4, 5, [])
    assert drawn == draw(project, ["appliance/*", "!appliance/plain.py"], 4, 5, [])
    assert {one.path for one in drawn[:2]} == {"appliance/limits.py", "appliance/kernel.py"}
    assert drawn[0] not in draw(project, ["appliance/*"], 100, 5, drawn[:1])


def test_a_mutant_is_found_where_its_function_moves_to(project: Path) -> None:
    (boundary,) = [one.listed for one in mutants_of("appliance/limits.py", LIMITS) if ">=" in one.listed.after]
    (project / "list.txt").write_text(str(boundary))
    assert read(project / "list.txt") == [boundary]
    (project / "appliance/limits.py").write_text("")
    assert find(project, boundary) is None
    (project / "hw_sim/e.py").write_text("import math\n\n\n" + LIMITS)
    moved = find(project, boundary)
    assert moved is not None
    assert moved.applied("import math\n\n\n" + LIMITS).count(">=") == 1


def test_a_weak_test_is_noticed_a_kernel_is_compiled_anew_and_what_hangs_is_ended(
    project: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    (project / "bench/mutation").mkdir(parents=True)
    for name in ("__init__.py", "probe.py"):
        (project / "bench/mutation" / name).write_text(
            Path(__file__).parents[2].joinpath("bench/mutation", name).read_text()
        )
    changes = {
        "return value >= top": "survived 2 tests",
        "pass": "died: the process",
        "HALF = 1.0": "died: tests/test_limits.py::test_half",
    }
    tree = Tree(project, tmp_path_factory.mktemp("trees") / "tree")
    mutants = [m for f in ("limits", "kernel") for m in mutants_of(f"appliance/{f}.py", FILES[f"appliance/{f}.py"])]
    chosen = {one.listed.after: one for one in mutants if one.listed.after in changes}
    names = Names(project)
    assert tree.pytest(["-q", "-n0"], tree.kernels, 60.0, {}) == 0, "the kernel is compiled"
    tree.put_probes({one.listed.key: one for one in chosen.values()}, names)
    assert tree.pytest(["-q", "-n0"], tree.kernels, 60.0, {}) == 0
    (project / "reached.txt").write_text("\n".join("\t".join(words) for words in tree.notes()))
    reached = Reached.read(project / "reached.txt")
    tests = {after: {one.partition("::")[2] for one in reached.chosen(m.listed.key)} for after, m in chosen.items()}
    assert tests["return value >= top"] == {"test_over", "test_apart"}
    assert tests["pass"] == {"test_over", "test_nothing", "test_count", "test_half", "test_apart"}, "by a fixture"
    assert tests["HALF = 1.0"] == {"test_half"}

    tree = Tree(project, tree.path)
    assert tree.pytest(["-q", "-n0"], tree.kernels, 60.0, {}) == 0
    for after, verdict in changes.items():
        limit_s = 5.0 if after == "pass" else 60.0
        assert tree.judge(chosen[after], names, reached.chosen(chosen[after].listed.key), limit_s).startswith(verdict)
        assert tree.path.joinpath("appliance/limits.py").read_text() == LIMITS
