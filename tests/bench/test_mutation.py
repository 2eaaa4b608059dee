"""The mutation tool makes the changes that it names, draws them by a seed and finds them again."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.mutation.mutants import draw, find, mutants_of, read
from bench.mutation.names import FROZEN, Names

LIMITS = "def is_over(value, top):\n    return value > top\n"
HALF = "HALF = 0.5\n\n\ndef half(x):\n    return x * HALF\n"


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("def f(a, b):\n    return a < b", {"return a <= b", "return None"}),
        ("def f(a):\n    return (a  # + here\n    + 1)", {"- 1)", "+ 2)", "return (None)"}),
        ("def f(a, b):\n    if a is not b or c:\n        g()", {"if a is b or c:", "if not (a is not b or c):", "pass"}),
        ("def f(ß):\n    ß[0] += max(-ß, 0.5)", {"ß[0] += max(-ß, 1.0)", "ß[0] += min(-ß, 0.5)", "ß[0] += max((ß), 0.5)"}),
        ("def f(a):\n    for x in a:\n        break", {"pass"}),
        ("LIMIT = 20.0", {"LIMIT = 40.0"}),
        ('def f(s: Literal[3]):\n    """Three."""\n    s.log.info("%d", 3)\n    raise ValueError(f"{1}")', {"pass"}),
    ],
)  # fmt: skip
def test_each_operator_changes_what_it_names(text: str, wanted: set[str]) -> None:
    found = {one.listed.after for one in mutants_of("appliance/f.py", text + "\n")}
    assert wanted <= found
    assert found == wanted or wanted != {"pass"}, "text for people is left alone"


def test_a_seed_draws_every_file_once_before_one_twice_and_a_mutant_is_found_where_its_function_moves_to(
    tmp_path: Path,
) -> None:
    for name, text in (("appliance/limits", LIMITS), ("appliance/half", HALF), ("drivers/d", ""), ("hw_sim/e", "")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.py").write_text(text)
    drawn = draw(tmp_path, ["appliance/*"], 4, 5, [])
    assert drawn == draw(tmp_path, ["appliance/*"], 4, 5, [])
    assert {one.path for one in drawn[:2]} == {"appliance/limits.py", "appliance/half.py"}
    assert drawn[0] not in draw(tmp_path, ["appliance/*"], 100, 5, drawn[:1])

    (boundary,) = [one.listed for one in mutants_of("appliance/limits.py", LIMITS) if ">=" in one.listed.after]
    (tmp_path / "list.txt").write_text(str(boundary))
    assert read(tmp_path / "list.txt") == [boundary]
    (tmp_path / "appliance/limits.py").write_text("")
    assert find(tmp_path, boundary) is None
    (tmp_path / "hw_sim/e.py").write_text(f"import math\n\n\n{LIMITS}")
    moved = find(tmp_path, boundary)
    assert moved is not None
    assert moved.applied(f"import math\n\n\n{LIMITS}").count(">=") == 1


def test_a_line_is_asked_of_those_who_import_it_then_of_its_room_and_a_kernel_of_others_is_compiled_anew(
    tmp_path: Path,
) -> None:
    files = {
        "appliance/a/half.py": f"import numba\n\n{HALF}",
        "appliance/b/twice.py": "from appliance.a.half import half\n\n\n@numba.njit\ndef twice(x):\n    return 4 * half(x)\n",
        "tests/appliance/a/test_room.py": "",
        "tests/appliance/b/test_user.py": "from appliance.a import half\n",
        "tests/appliance/b/test_other.py": "from appliance.b.twice import twice\n",
        "tests/scenarios/test_dive.py": "from appliance.a.half import half\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    names = Names(tmp_path)
    assert names.tests_of("appliance/a/half.py") == [
        "tests/appliance/b/test_user.py", "tests/appliance/a/test_room.py", FROZEN,
    ]  # fmt: skip
    mutant = mutants_of("appliance/a/half.py", files["appliance/a/half.py"])[0]
    assert [one.name for one in names.stale_kernels(mutant)] == ["twice"]
