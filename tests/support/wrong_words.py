"""Wrong words and wrong cameras' numbers for rightly described sets, and what is said of them: named, unchecked in a line about just that word, or silence.

Sets are drawn (``other_programs``), or real ones of other laboratories where ``KINGFISHER_REAL_PICTURES`` has them.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.support.imported import Said, kingfisher
from tests.support.other_programs import (
    FOUR,
    PROGRAMS,
    Program,
    code,
    opencv,
    pairs,
    references,
    sides_l_r,
    stepped,
    steps,
)
from tests.support.strangers import gray, sine, yaml

Array = NDArray[np.float64]
Numbers = Mapping[str, Array]
"""K1 D1 K2 D2 R T, OpenCV's."""
XGA = (1024, 768)


@dataclass(frozen=True)
class Described:
    """A set on the disk, described rightly; ``text`` lacks its cameras."""

    name: str
    folder: Path
    text: str
    numbers: Numbers
    size_px: tuple[int, int]
    two_cameras: bool


@dataclass(frozen=True)
class Wrong:
    """A kind of mistake: a change of words (an expression, and what stands in its place), or of numbers."""

    name: str
    about: str
    """Expression of what an error must have that names it."""
    line: str
    """Expression of what a line that says it is unchecked begins with, behind the side."""
    words: tuple[tuple[str, str], ...] = ()
    numbers: Callable[[Numbers], Numbers] | None = None
    cameras: str = ""
    """More lines of ``[cameras]``."""
    needs: Callable[[Described], bool] = lambda _: True

    def fits(self, one: Described) -> bool:
        return self.needs(one) and all(re.search(before, one.text) for before, _ in self.words)


def _turned(axis: str) -> Callable[[Numbers], Numbers]:
    """The other camera turned by 0.3° about its own rows (its x axis) or columns (its y axis)."""
    vector = np.radians(0.3) * np.array([axis == "rows", axis == "columns", False], np.float64)
    turn = np.asarray(cv2.Rodrigues(vector)[0], np.float64)
    return lambda n: {**n, "R": turn @ n["R"], "T": turn @ n["T"]}


def _other_setting(n: Numbers) -> Numbers:
    """Another day's file: the other camera stood elsewhere and looked elsewhere, its lens was another."""
    turn = np.asarray(cv2.Rodrigues(np.radians([1.5, -6.0, 1.0]))[0], np.float64)
    lens = np.diag([1.12, 1.12, 1.0])
    return {**n, "R": turn @ n["R"], "T": 1.3 * n["T"], "K1": lens @ n["K1"], "K2": lens @ n["K2"]}


CAMERAS = r"cameras|R and T|rotation|left and right|turn"
PLACES = r"cameras: (rotation and translation|which is left)"
WRONG = (
    Wrong("sign", r"\bsign\b", r"[xy]\.sign", words=((r'sign = "-"', 'sign = "+"'),)),
    Wrong("sign", r"\bsign\b", r"[xy]\.sign", words=((r"steps = (\d+)", r'steps = \1' + '\nsign = "-"'),), needs=lambda one: "sign" not in one.text),
    Wrong("period", r"period|fringes", r"[xy]\.(period_px|fringes)", words=((r"period_px = \d+", "period_px = 24"),), needs=lambda one: not one.two_cameras),
    Wrong("number of fringes", r"period|fringes", r"[xy]\.(period_px|fringes)", words=((r"fringes = \[16, 1\]", "fringes = [12, 1]"),)),
    Wrong("projector's width", r"width_px|projector", r"projector\.width_px", words=((r"width_px = \d+", "width_px = 912"),), needs=lambda one: not one.two_cameras),
    Wrong("width of stripes", r"stripe", r"[xy]\.stripe_px", words=((r"stripe_px = \d+", "stripe_px = 3"),)),
    Wrong("start", r"start|code_offset", r"[xy]\.(start_deg|code_offset_px)", words=((r"(\[x\][^\[]*steps = \d+)", r"\1" + "\nstart_deg = 90"),), needs=lambda one: "fringes" not in one.text and "start" not in one.text),
    Wrong("order of the bits", r"code_order|order", r"[xy]\.code_order", words=((r"\[x\]\n", '[x]\ncode_order = "fine-first"\n'),), needs=lambda one: "gray" in one.text),
    Wrong("binary for Gray", r"x\.code\b|binary|\bcode\b", r"[xy]\.code\b", words=((r"\[x\]\n", '[x]\ncode = "binary"\n'),), needs=lambda one: "gray" in one.text),
    Wrong("inverted code", r"code_inverted|inverse|order", r"[xy]\.code_inverted", words=((r"\[x\]\n", "[x]\ncode_inverted = true\n"),), needs=lambda one: "gray" in one.text),
    Wrong("order of the steps", r"steps", r"[xy]\.steps", words=((r"(\[x\][^\[]*)steps = 4", r"\1steps_deg = [0, 180, 90, 270]"),)),
    Wrong("bright and dark", r"order|bright|dark", r"images\.order", words=((r"bright dark", "dark bright"),)),
    Wrong("inverses first", r"order|inver", r"images\.order", words=((r"gray-x ~gray-x", "~gray-x gray-x"),)),
    Wrong("exchanged cameras", CAMERAS, PLACES, words=((r'left = "(.*)"\nright = "(.*)"', r'left = "\2"' + "\n" + r'right = "\1"'),)),
    Wrong("R transposed", CAMERAS, PLACES, numbers=lambda n: {**n, "R": n["R"].T}),
    Wrong("T negated", CAMERAS, PLACES, numbers=lambda n: {**n, "T": -n["T"]}),
    Wrong("R transposed, T negated", CAMERAS, PLACES, numbers=lambda n: {**n, "R": n["R"].T, "T": -n["T"]}),
    Wrong("metres for millimetres", r"unit|metre|apart", r"cameras\.unit", cameras='unit = "m"'),
    Wrong("half size", r"half|size|middle|principal", r"cameras: size", numbers=lambda n: {
        **n, "K1": np.diag([0.5, 0.5, 1.0]) @ n["K1"], "K2": np.diag([0.5, 0.5, 1.0]) @ n["K2"]}, needs=lambda one: one.two_cameras),
    Wrong("another setting's file", CAMERAS, PLACES, numbers=_other_setting),
    Wrong("turned about the rows", CAMERAS, PLACES + r"|cameras: a turn about the rows", numbers=_turned("rows")),
    Wrong("turned about the columns", CAMERAS, PLACES + r"|cameras: a rotation about the columns", numbers=_turned("columns")),
)  # fmt: skip


def call(one: Described, wrong: Wrong | None, out: Path) -> Said:
    """Import a set as it is described, or with a mistake."""
    text, numbers = one.text, one.numbers
    if wrong is not None:
        for before, after in wrong.words:
            text, times = re.subn(before, after, text, count=1)
            assert times == 1, before
        numbers = wrong.numbers(numbers) if wrong.numbers else numbers
    cameras = one.folder / "cameras.yml"
    other = {name[0].replace("K", "M") + name[1:]: value for name, value in numbers.items()}
    yaml(cameras, **other)
    description = one.folder / "described.toml"
    more = wrong.cameras if wrong is not None else ""
    description.write_text(f'{text}[cameras]\nfiles = ["{cameras.name}"]\n{more}\n', encoding="utf-8")
    return kingfisher("import", description, "--out", out)


def outcome(said: Said, wrong: Wrong) -> str:
    """``named``, ``refused by another word``, ``unchecked`` or ``silent``."""
    if said.code:
        return "named" if re.search(wrong.about, said.error) else "refused by another word"
    return (
        "unchecked" if any(re.match(rf"((left|right): )?({wrong.line})", line) for line in said.unchecked) else "silent"
    )


def told_words(said: Said, kind: str) -> set[str]:
    """The words of which a right report's lines of a kind speak: ``fits`` or ``unchecked``."""
    found = (
        re.match(r"(?:(?:left|right): )?(?:cameras: [^:]+|[a-z]+\.[a-z_]+)", line) for line in said.report.get(kind, [])
    )
    return {one[0] for one in found if one}


# --------------------------------------------------------------------------------------------------------------- sets


def _both_directions(size: tuple[int, int]) -> list[NDArray[np.uint8]]:
    return [one for axis in "xy" for one in (*sine(axis, size, 16.0, FOUR), *gray(axis, size, 6, 16.0))]


@dataclass(frozen=True)
class Own:
    """A set that is drawn, and its words."""

    program: Program
    text: str


def _program(name: str) -> Program:
    return next(one for one in PROGRAMS if one.name == name)


def _words(images: str, size: tuple[int, int], axes: str) -> str:
    return f"[images]\n{images}\n[projector]\nwidth_px = {size[0]}\nheight_px = {size[1]}\n{axes}"


LR = 'left = "L/*.png"\nright = "R/*.png"\norder = '
ONE = 'left = "cam_*.png"\norder = '
DRAWN = (
    Own(Program("two cameras, one direction", XGA, stepped(references, code(6, 16.0), steps(16.0, 4)), opencv, sides_l_r),
        _words(f'{LR}"bright dark gray-x*6 sine-x*4"', XGA, "[x]\nperiod_px = 16\nsteps = 4\n")),
    Own(Program("two cameras, two directions", XGA, stepped(references, _both_directions), opencv, sides_l_r),
        _words(f'{LR}"bright dark sine-x*4 gray-x*6 sine-y*4 gray-y*6"', XGA,
               "[x]\nperiod_px = 16\nsteps = 4\n[y]\nperiod_px = 16\nsteps = 4\n")),
    Own(replace(_program("rows before columns"), patterns=stepped(references, pairs(8, 8, 4.0))),
        _words(f'{ONE}"bright dark (gray-x ~gray-x)*8 (gray-y ~gray-y)*8"', XGA, "[x]\nstripe_px = 4\n[y]\nstripe_px = 4\n")),
    Own(_program("8 steps, no references"),
        _words(f'{ONE}"sine-x*8 gray-x*6"', (1280, 800), "[x]\nperiod_px = 20\nsteps = 8\n")),
)  # fmt: skip


def drawn_set(own: Own, root: Path, seed: int, width_px: int = 400) -> Described:
    folder = root / re.sub(r"\W+", "-", own.program.name)
    drawn = own.program.make(folder, seed, width_px)
    left, other = drawn.bench.left, drawn.bench.right
    numbers = {"K1": left.K, "D1": left.D, "K2": other.K, "D2": other.D, "R": drawn.bench.R, "T": drawn.bench.T}
    return Described(own.program.name, folder, own.text, numbers, (left.width_px, left.height_px), drawn.two_cameras)


@dataclass(frozen=True)
class Real:
    """A set of another laboratory: where it lies, its words, and the names of its numbers."""

    name: str
    folder: str
    calibration: str
    names: tuple[str, str, str, str, str, str]
    text: str
    two_cameras: bool = False


SLS = (1824, 1140)
SLSTUDIO = ("Kc", "kc", "Kp", "kp", "Rp", "Tp")
REAL = (
    Real("skull, 2 x 3 steps", "slstudio/skull_2x3", "slstudio/calibration/calibration.xml", SLSTUDIO,
         _words('left = "frameSeq_*.png"\norder = "sine-x*3 sine-x2*3"', SLS, '[x]\nfringes = [16, 1]\nsteps = 3\nsign = "-"\n')),
    Real("skull, Gray code", "slstudio/skull_gray", "slstudio/calibration/calibration.xml", SLSTUDIO,
         _words('left = "frameSeq_*.png"\norder = "bright dark gray-x*10"', SLS, "[x]\nstripe_px = 2\n")),
    Real("face, two cameras", "slmaster/binocular", "slmaster/binocular/caliInfo.yml", ("M1", "D1", "M2", "D2", "Rlr", "Tlr"),
         _words('left = "L/*.png"\nright = "R/*.png"\norder = "sine-x*12 gray-x*7"', (1008, 720), "[x]\nperiod_px = 16\nsteps = 12\nstart_deg = 180\nstripe_px = 8\n"),
         two_cameras=True),
)  # fmt: skip


def real_sets(root: Path) -> list[Described]:
    """Those that are there, as links to their pictures."""
    if "KINGFISHER_REAL_PICTURES" not in os.environ:
        return []
    pictures = Path(os.environ["KINGFISHER_REAL_PICTURES"])
    found = []
    for real in REAL:
        folder = root / re.sub(r"\W+", "-", real.name)
        folder.mkdir(parents=True)
        for path in (pictures / real.folder).iterdir():
            if path.is_dir() or path.suffix == ".png":
                (folder / path.name).symlink_to(path)
        storage = cv2.FileStorage(str(pictures / real.calibration), cv2.FILE_STORAGE_READ)
        values = [np.asarray(storage.getNode(name).mat(), np.float64) for name in real.names]
        numbers = dict(zip(("K1", "D1", "K2", "D2", "R", "T"), values, strict=True))
        image = cv2.imread(str(next((pictures / real.folder).rglob("*.png"))), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        found.append(
            Described(real.name, folder, real.text, numbers, (image.shape[1], image.shape[0]), real.two_cameras)
        )
    return found
