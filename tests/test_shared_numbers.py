"""The simulated world states no number of the product's: what is equal on both sides is named here, with the reason.

A pair counts if the number has three digits or more, if the names of both sides share a word, or if both are constants or defaults of
the same unit; round numbers (one digit, powers of two) only if the names share a word. Names are those of constants, fields,
parameters, keywords and keys. Compared are the rooms of the simulator's physics with what the product computes; devices and drivers
both follow published standards and ``docs/protocols``.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SIMULATOR = tuple(
    f"hw_sim/{room}" for room in ("objects", "optics", "water", "light", "rendering", "timing", "scene.py", "truth.py",
    "workshop.py", "heat.py", "clocks.py", "in_dive.py", "mount_shift.py", "options.py", "outside.py", "ranges.py", "drawings.py",
    "world.py", "faults.py", "punctuality.py")
)  # fmt: skip
PRODUCT = (
    *("appliance/measure", "appliance/store", "appliance/calibrate", "appliance/workshop"),
    *(f"appliance/instrument/{room}" for room in ("capture", "ranging", "worker", "service", "machine")),
    *(f"appliance/desk/{room}" for room in ("foreign", "registration", "surface", "anew")),
    *(f"appliance/desk/{file.name}" for file in sorted((ROOT / "appliance" / "desk").glob("*.py"))),
)
_UNITS = "px mm um nm deg rad hz ms us ns s c k dn e db per_m psu"
_SMALL = (
    "percent ppm bytes least most max min first last count number default limit limits size width height index kind name "
    "list table none true false and the with per far near half full top low high from"
)
UNITS = frozenset(_UNITS.split())
SMALL_WORDS = UNITS | frozenset(_SMALL.split())
"""Words that two names may share by chance."""


@dataclass(frozen=True)
class Stated:
    """A number and where it stands."""

    value: float
    where: str
    name: str
    """The constant, field or parameter it is the value of; empty for a literal within an expression."""
    alone: bool
    """It is all of that value, not a part of a table or of an expression."""

    @cached_property
    def words(self) -> frozenset[str]:
        return frozenset(w for w in re.split(r"[^a-z]+", self.name.lower()) if len(w) > 2 and w not in SMALL_WORDS)

    @cached_property
    def unit(self) -> str:
        last = self.name.lower().rpartition("_")[2]
        return last if last in UNITS else ""


@cache
def digits(value: float) -> int:
    """Return how many significant decimal digits a number has."""
    return len(f"{abs(value):.12e}".partition("e")[0].replace(".", "").rstrip("0"))


@cache
def is_round(value: float) -> bool:
    """Return whether a number says nothing by itself: one digit, a power of two, or one less than that."""
    whole = int(abs(value)) if float(value).is_integer() else -1
    return digits(value) <= 1 or (whole >= 0 and (whole & (whole - 1) == 0 or whole & (whole + 1) == 0))


def stated_in(source: str, where: str) -> Iterator[Stated]:
    """Yield every numeric literal of a module: with the name that it is the value or the default of, as far as it has one."""
    tree = ast.parse(source)
    named: dict[int, str] = {}
    alone: set[int] = set()

    def name_all(name: str, value: ast.AST) -> None:
        """Note the name of each number in ``value``: that of its key or keyword where it has one."""
        if isinstance(value, ast.Dict):
            for key, part in zip(value.keys, value.values, strict=True):
                known = isinstance(key, ast.Constant) and isinstance(key.value, str)
                name_all(str(key.value) if known and isinstance(key, ast.Constant) else name, part)
        elif isinstance(value, ast.Call):
            for part in value.args:
                name_all(name, part)
            for keyword in value.keywords:
                name_all(keyword.arg or name, keyword.value)
        elif isinstance(value, ast.Constant):
            named.setdefault(id(value), name)
        else:
            for child in ast.iter_child_nodes(value):
                name_all(name, child)

    def name_target(target: ast.AST, value: ast.AST) -> None:
        alone.add(id(value))
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            for one, part in zip(target.elts, value.elts, strict=True):
                name_target(one, part)
        else:
            name_all(ast.unparse(target), value)

    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef):
            for line in node.body:
                if isinstance(line, ast.AnnAssign) and line.value is not None:
                    name_target(line.target, line.value)
                elif isinstance(line, ast.Assign):
                    name_target(line.targets[0], line.value)
        elif isinstance(node, ast.FunctionDef):
            plain = node.args.posonlyargs + node.args.args
            tail = plain[len(plain) - len(node.args.defaults) :]
            for argument, value in zip(tail, node.args.defaults, strict=True):
                name_target(ast.Name(argument.arg), value)
            for argument, given in zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True):
                if given is not None:
                    name_target(ast.Name(argument.arg), given)
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
            yield Stated(float(node.value), where, named.get(id(node), ""), id(node) in alone)


def counts(one: Stated, other: Stated) -> bool:
    """Return whether the same number on both sides needs a reason."""
    if digits(one.value) >= 3 and not is_round(one.value):
        return True
    if not one.name or not other.name:
        return False
    same_unit = bool(one.unit) and one.unit == other.unit and one.alone and other.alone
    return bool(one.words & other.words) or (same_unit and not is_round(one.value))


def shared(simulator: list[Stated], product: list[Stated]) -> dict[str, str]:
    """Return the pairs that state the same number, as ``value name = name``, and where they stand: see the module's docstring."""
    by_value: dict[float, list[Stated]] = defaultdict(list)
    for one in product:
        if one.value not in (0.0, 1.0, 2.0):
            by_value[one.value].append(one)
    found: dict[str, str] = {}
    for one in simulator:
        for other in by_value.get(one.value, ()):
            if counts(one, other):
                pair = f"{one.value:.8g} {one.name or '-'} = {other.name or '-'}"
                found.setdefault(pair, f"{pair} ({one.where}, {other.where})")
    return found


def of(packages: tuple[str, ...]) -> list[Stated]:
    return [
        one
        for package in packages
        for path in sorted((ROOT / package).rglob("*.py") if (ROOT / package).is_dir() else [ROOT / package])
        for one in stated_in(path.read_text(encoding="utf-8"), path.relative_to(ROOT).as_posix())
    ]


MAY_BE_EQUAL: Mapping[str, frozenset[str]] = {
    "published formula: Quan and Fry 1995, equation 3": frozenset(
        f"{value} - = -"
        for value in (
            *("1.31405", "2.02e-06", "0.0001779", "1.05e-06"),
            *("15.868", "0.01155", "0.00423", "4382", "1145500"),
        )
    ),
    "nominal drawing of the instrument and of the board, which both sides were built from": frozenset(
        {
            "15 ACROSS = across",
            "12 DOWN = down",
            "18 SQUARE_MM = square_mm",
            "13.5 MARKER_MM = marker_mm",
            "1.77 n_g = _DESIGN",
            "1.77 - = _DESIGN",
            "11.5 APERTURE_MM = _DESIGN",
            "768 - = height_px",
            "11.5 focal_mm = _DESIGN",
            "12.41 toe_in_deg = _DESIGN",
            "768 projector_px = height_px",
            "60 refresh_hz = refresh_hz",
            "60 FRAME_S = frame_s",
            "60 frame_s = frame_s",
            "100 PLANE_HALF_Y_MM = PLANE_HALF_MM",
        }
    ),
    "sizes of the micromirror chips that are sold, of which the instrument has one": frozenset(
        {
            "768 - = GUESSED_PX",
            "768 - = PROJECTORS_PX",
            "768 projector_px = GUESSED_PX",
            "768 projector_px = PROJECTORS_PX",
            "1280 projector_px = PROJECTORS_PX",
            "1920 camera_px = PROJECTORS_PX",
        }
    ),
    "published modes of displays: VESA DMT, CTA-861": frozenset(
        {"768 - = -", "768 projector_px = -", "1280 projector_px = -"}
    ),
    "the ordinary world's alone; outside draws it (families cameras and surfaces, workshop of the rig)": frozenset(
        {
            "13000 FULL_WELL_E = full_well_e",
            "20 READ_NOISE_E = read_noise_e",
            "0.6 MEAN_ALBEDO = ALBEDO",
            "0.6 BACKSCATTER_ALBEDO = ALBEDO",
            "0.0001 refocus = refocus",
            "1e-05 board_scale = SCALE_STEP",
            "1e-05 board_scale = scale",
        }
    ),
    "by chance: different things of the same number": frozenset(
        {
            "150 BALL_DISTANCE_MM = _BEGIN_MM",
            "150 FRUSTUM_BASE_MM = _BEGIN_MM",
            "3 BOARD_SCALE = _BOARD_STEPS",
            "3 EDGE_MM = EDGE_MM",
            "3 _NUMBERS = MIN_LISTED_NUMBERS",
            "8 BLOCK_PX = BLOCK_COLUMNS",
            "10 UNDISTORT_STEPS = STEPS_MS",
            "12 PROJECT_STEPS = STEPS_MS",
            "12 PROJECT_STEPS = NEWTON_STEPS",
            "12 PROJECT_STEPS = STEPS_AT_MOST",
            "4 SPOT_LIGHT = LIGHT_SIGMA",
            "1.25 - = -",
            "5 caustics_scale_mm = START_SCALE_DN",
            "4 FOOT_SIGMA_MM = MANY_SIGMA",
            "4 FOOT_SIGMA_MM = LIGHT_SIGMA",
            "0.25 HIDDEN = HIDDEN",
            "1.05 - = -",
            "1.05 index = -",
            "1.25 gloss_index = -",
            "5 HOST_TIMEOUT_S = JOIN_TIMEOUT_S",
            "0.25 LONGEST_WAIT_S = READ_TIMEOUT_S",
            "3 centre_px = CENTRE_TIMES",
            "0.15 hold_s = LIVE_TIMEOUT_S",
            "0.999 - = -",
            "1.01 - = -",
            "12 _AROUND = AROUND_MM",
            "160 NEAR_GLARE_PX = COARSE_PX",
            "1.25 - = SCALES",
            "1.25 gloss_index = SCALES",
            "1280 projector_px = USUAL_WIDTH_PX",
            "24 MOST_STEPS = _STEPS",
            "8 LIT_DN = LEAST_LIT_DN",
            "9 ROTATION = rotation",
            "0.25 LONGEST_WAIT_S = POLL_S",
            "4 SPOT_LIGHT = LEAST_LIGHT_DN",
            "4 cycles = CYCLES",
            "5 camera_jitter_us = MOST_JITTER_US",
        }
    ),
}
"""The pairs that may be equal, by reason."""


@pytest.mark.parametrize(
    ("simulator", "product", "pairs"),
    [
        ("READ_NOISE_E = 20.0", "class C:\n    read_noise_e: float = 20.0", ["20 READ_NOISE_E = read_noise_e"]),
        ("A, BOW_MM = 1, 0.35", "def f(step_mm: float = 0.35) -> None: ...", ["0.35 BOW_MM = step_mm"]),
        ("x = {'scale': 1e-5}", "SCALE = 1e-5", ["1e-05 scale = SCALE"]),
        ("y = f(refocus=1e-4)", "def g(*, refocus=1e-4): ...", ["0.0001 refocus = refocus"]),
        ("def f(): return 1.31405 * t", "def g(): return 1.31405 + s", ["1.31405 - = -"]),
        ("A_MM = 0.5", "B_MM = 0.5", []),
        ("A_MM = 64", "B_MM = 64", []),
        ("A_MM = 35", "B_DEG = 35", []),
        ("A_MM = (35, 36)", "B_MM = 35", []),
        ("READ_NOISE_E = 20.0", "read_noise_e = 21.0", []),
    ],
)
def test_a_number_on_both_sides_is_noticed_and_a_round_one_only_by_its_name(
    simulator: str, product: str, pairs: list[str]
) -> None:
    assert list(shared(list(stated_in(simulator, "a")), list(stated_in(product, "b")))) == pairs


def test_no_number_is_stated_on_both_sides_without_a_reason() -> None:
    """If this is red: state the number independently (draw it, or cite its own source), or name the pair and its reason above."""
    found, allowed = shared(of(SIMULATOR), of(PRODUCT)), frozenset[str]().union(*MAY_BE_EQUAL.values())
    assert not [found[pair] for pair in sorted(found.keys() - allowed)]
    assert not allowed - found.keys(), "what is not shared any more needs no reason"


def test_every_file_of_the_simulator_that_states_what_the_world_is_like_is_compared() -> None:
    """Rooms that state nothing physical are named here."""
    follow_the_wire = {"devices", "wires", "window", "people", "rigs"}
    bookkeeping = {"__init__.py", "py.typed", "latest.py", "registry.py"}
    compared = {Path(room).name for room in SIMULATOR}
    there = {path.name for path in (ROOT / "hw_sim").iterdir()} - {"__pycache__"}
    assert there == compared | follow_the_wire | bookkeeping
