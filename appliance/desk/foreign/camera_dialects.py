"""Owns what names in camera files mean: OpenCV's and those of other programs, each bound to the file in which it
stands.

Two cameras are ``1`` and ``2``, left and right, or counted from 0; a projector takes the right one's place, or is a
third. Where they stand is said by R and T between them (x_right = R x_left + T), by R and T of the world into each, by
projection matrices P = K (R | t), or by the rectification that brings both to one plane. Two places that say the same
thing differently are refused. Sources of ``DIALECTS``: Kalibr's wiki, "Yaml formats"; MathWorks,
``stereoParametersToOpenCV``; J.-Y. Bouguet, Camera Calibration Toolbox for Matlab; SLStudio's CalibrationData;
SLMaster's caliInfo; Middlebury Stereo 2014, calib.txt.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.desk.foreign.problem import ForeignError, Table

Array = NDArray[np.float64]
NumbersOf = Mapping[str, Array]
"""The numbers of a file by name; those in tables as TABLE.NAME."""

WANTED = {
    "left_matrix": ("left", "matrix"),
    "right_matrix": ("right", "matrix"),
    "left_distortion": ("left", "distortion"),
    "right_distortion": ("right", "distortion"),
    "rotation": ("both", "rotation"),
    "translation": ("both", "translation"),
}
"""Side and kind of all that is wanted, by its name in a description."""
MOST = 1e9
"""Numbers of cameras are smaller than this."""
LEAST_LISTED = 3
"""Fewer numbers under a name are not worth a mention: neither matrix nor vector."""
SAME = 2e-3
"""Largest relative difference of two places that say the same."""
SAME_DEG = 1.0
"""Largest angle between two ways to say how cameras stand, which are computed from each other."""

# ------------------------------------------------------------------------------------------------ the tables

KINDS: Mapping[str, tuple[Sequence[int], str]] = {
    "matrix": (
        (9,),
        "m k kk cameramatrix camera cameraint intrinsic intrinsics intrinsicmatrix mtx matrix int intr cam kmatrix",
    ),
    "distortion": (
        range(2, 15),
        "d distcoeffs distcoeff distcoef distortion distorsion distortioncoefficients distortioncoeffs dist kc distortions",
    ),
    "rotation": ((9, 3), "r rotation rotationmatrix rot rmatrix rvec om"),
    "translation": ((3,), "t translation translationvector trans tvec"),
    "projection": ((12,), "p projection projectionmatrix projmatrix"),
    "rectification": ((9,), "rectificationmatrix rectification rrect"),
    "size": ((2,), "imagesize imgsize size s resolution imageresolution framesize"),
    "width": ((1,), "imagewidth width framewidth imgwidth nx resx"),
    "height": ((1,), "imageheight height frameheight imgheight ny resy"),
}
"""Kinds of what a camera file says: how many numbers each may have, and its names, in small letters without anything
between."""
WHOSE = ("matrix", "projection")
"""Kinds by which a camera is told."""
PROJECTOR = ("proj", "projector", "prj")


def _known(first: int) -> dict[tuple[str, str], str]:
    """Return the side by name and kind, for every known name where cameras are counted from ``first``; empty where a
    name has none."""
    sides = {"both": ("lr", "stereo", "12"), "projector": (*PROJECTOR, "screen")}
    for n, side in ((first, "left"), (first + 1, "right")):
        sides[side] = (side, side[0], f"{n}", f"cam{n}", f"camera{n}")
    found: dict[tuple[str, str], str] = {}
    for kind, (_, names) in KINDS.items():
        for name in names.split():
            for side, words in sides.items():
                found |= {(both, kind): side for word in words for both in (name + word, word + name)}
            found[name, kind] = ""
    return found


KNOWN = (_known(0), _known(1))
ZEROS = {name for name, _ in KNOWN[0]} - {name for name, _ in KNOWN[1]}
"""Names of cameras that are counted from 0."""


def _four(f_and_c: Array, c_px: Array | None = None, skew: Array | None = None) -> Array:
    """Return the matrix of fu, fv, cu, cv, or of f and c; a skew is in units of the focal length."""
    fu, fv, cu, cv = np.ravel(f_and_c if c_px is None else [f_and_c, c_px])
    return np.array([[fu, 0.0 if skew is None else float(np.ravel(skew)[0]) * fu, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]])


def _from_one(matrix: Array) -> Array:
    """Return a matrix of MATLAB's, which counts pixels from 1 and may multiply from the right."""
    found = matrix.reshape(3, 3)
    found = (found.T if abs(found[2, 0]) > abs(found[0, 2]) else found).copy()
    found[:2, 2] -= 1.0
    return found


def _brown(radial: Array, across: Array | None) -> Array:
    k = np.append(radial, [0.0, 0.0])[:3]
    return np.array([*k[:2], *(np.zeros(2) if across is None else np.ravel(across)[:2]), k[2]])


def rotation_of(numbers: Array) -> Array:
    """Return the matrix (3, 3) of nine numbers, or of a vector of three: axis times angle."""
    return np.asarray(cv2.Rodrigues(numbers)[0] if numbers.size == 3 else numbers.reshape(3, 3), np.float64)


Says = tuple[str, str, str, Callable[..., Any]]
"""Side, kind, names in the file (``?``: may be missing), and what makes ours of their numbers."""

DIALECTS: tuple[tuple[Says, ...], ...] = (
    # SLStudio
    (("left", "matrix", "Kc", np.ravel), ("left", "distortion", "kc", np.ravel), ("projector", "matrix", "Kp", np.ravel),
     ("projector", "distortion", "kp", np.ravel), ("projector", "rotation", "Rp", np.ravel), ("projector", "translation", "Tp", np.ravel)),
    # SLMaster
    (("projector", "rotation", "Rlp", np.ravel), ("projector", "translation", "Tlp", np.ravel), ("projector", "matrix", "M4", np.ravel),
     ("projector", "distortion", "D4", np.ravel)),
    # Middlebury
    (("both", "translation", "baseline cam0 cam1", lambda base, *_: [-base.ravel()[0], 0.0, 0.0]), ("left", "matrix", "cam0", np.ravel),
     ("right", "matrix", "cam1", np.ravel), ("both", "rotation", "baseline", lambda _: np.eye(3))),
    # Renderings by Blender: of each device its place in the world, and the turn of the world into it
    (("", "translation", "rotate translate", lambda turn, place: -rotation_of(turn) @ place.ravel()), ("", "rotation", "rotate", np.ravel)),
    # Kalibr: T_cn_cnm1 is the pose of the camera before in this one
    *(((side, "matrix", f"cam{n}.intrinsics", _four), (side, "distortion", f"cam{n}.distortion_coeffs", np.ravel),
       (side, "size", f"cam{n}.resolution", np.ravel), ("both", "rotation", f"cam{n}.T_cn_cnm1", lambda pose: pose.reshape(4, 4)[:3, :3]),
       ("both", "translation", f"cam{n}.T_cn_cnm1", lambda pose: pose.reshape(4, 4)[:3, 3])) for n, side in enumerate(("left", "right"))),
    # MATLAB: rows are multiplied by its matrices
    *(((side, "matrix", f"CameraParameters{n}.{name}", _from_one),
       (side, "distortion", f"CameraParameters{n}.RadialDistortion CameraParameters{n}.TangentialDistortion?", _brown),
       (side, "size", f"CameraParameters{n}.ImageSize", lambda size: np.ravel(size)[::-1]),
       ("both", "rotation", "RotationOfCamera2", lambda turn: turn.reshape(3, 3).T), ("both", "translation", "TranslationOfCamera2", np.ravel))
      for n, side in enumerate(("left", "right"), 1) for name in ("IntrinsicMatrix", "K")),
    # Bouguet
    *(((side, "matrix", f"fc{behind} cc{behind} alpha_c{behind}?", _four),) for behind, side in (("_left", "left"), ("_right", "right"), ("", ""))),
)  # fmt: skip
"""Rows by program of what it says in its own way; a file is of such a program where it has the names of the first row,
behind the same tables if any."""

LENSES = {
    "camera_model": ("pinhole",),
    "distortion_model": ("radtan", "plumb_bob", "plumb-bob", "rational_polynomial", "none", "brown", "opencv"),
}
"""Models that OpenCV's numbers describe, by the name under which files say them."""


def refuse_other_lenses(source: str, content: Mapping[str, Any]) -> None:
    """Raise ForeignError for a model of lenses that is no pinhole with OpenCV's distortion."""
    for name, word in content.items():
        allowed = LENSES.get(name.rpartition(".")[2].lower())
        if allowed and isinstance(word, str) and word and word.lower() not in allowed:
            raise ForeignError(
                f"{source}: {name} is {word!r:.40}; allowed: {', '.join(allowed)}; fisheye and other lenses are not read: calibrate with "
                "OpenCV's model, or undistort the images and give the matrices of these"
            )


# ----------------------------------------------------------------------------------------------- what is said


@dataclass(frozen=True, slots=True)
class Fact:
    """Numbers of one kind, and of whom: ``left``, ``right``, ``projector``, ``both``: between them; empty: whoever's
    file it is."""

    side: str
    kind: str
    numbers: Array
    file: str
    name: str

    @property
    def where(self) -> str:
        return f"{self.file}: {self.name}"


Facts = dict[tuple[str, str], Fact]


@dataclass(frozen=True, slots=True)
class CameraNumbers:
    """All that camera files say of two cameras."""

    found: Mapping[str, Array]
    """``WANTED``; those of distortion may be empty."""
    sizes: Mapping[str, Fact]
    """Sizes by side as far as they are stated; the right one is a projector's where it takes that place, else that is a
    third."""
    has_projector: bool
    notes: tuple[str, ...]

    @property
    def stated_px(self) -> dict[str, tuple[int, int]]:
        """Width and height by side."""
        return {side: (int(fact.numbers[0]), int(fact.numbers[1])) for side, fact in self.sizes.items()}


def understood(files: Mapping[str, NumbersOf], names: Table, of_projector: bool) -> CameraNumbers:
    """Return what ``files`` say of two cameras, or of one and a projector.

    ``names`` are the description's own for single numbers: NAME, FILE:NAME or the FILE of a single matrix. Raises
    ForeignError.
    """
    names.only(*WANTED)
    facts: Facts = {}
    for wanted in names.content:
        _put(facts, _named(files, names, wanted))
    fixed, named = set(facts), {(fact.file, fact.name) for fact in facts.values()}
    said = [fact for fact in facts_of(files, of_projector) if (fact.file, fact.name) not in named]
    cameras = {fact.side: fact for fact in said if fact.kind in WHOSE}
    projector = cameras.get("projector")
    if of_projector:
        # It takes the right camera's place; beside a second camera, what is between two is the cameras'.
        beside = () if projector is None else ("right", "both") if "right" in cameras else ("right",)
        said = [replace(fact, side=fact.side.replace("projector", "right")) for fact in said if fact.side not in beside]
    elif projector and "right" not in cameras and ("right", "matrix") not in fixed:
        raise ForeignError(
            f"cameras.files: {projector.where} is a projector's, and the images are of two cameras; give the file of both "
            "cameras, or leave images.right out"
        )
    for fact in said:
        if (fact.side, fact.kind) not in fixed:
            _put(facts, fact)
    notes: list[str] = []
    pose = {} if {WANTED["rotation"], WANTED["translation"]} <= fixed else _pose(facts, notes)
    found = pose | {
        wanted: facts[key].numbers for wanted, key in WANTED.items() if key in (fixed if wanted in pose else facts)
    }
    missing = [wanted for wanted in WANTED if wanted not in found and not wanted.endswith("distortion")]
    if missing:
        there = "; ".join(
            f"{file}: {', '.join([name for name, numbers in values.items() if numbers.size >= LEAST_LISTED][:20])[:400] or 'no matrices'}"
            for file, values in files.items()
        )
        raise ForeignError(
            f"cameras have no {', '.join(missing)} under a name that is known ({there}); say which is which under [cameras.names], "
            f'for example {missing[0]} = "NAME" or "FILE:NAME"'
        )
    sizes = {side: fact for (side, kind), fact in facts.items() if kind == "size"}
    return CameraNumbers(
        {wanted: found.get(wanted, np.empty(0)) for wanted in WANTED}, sizes, projector is not None, tuple(notes)
    )


def _named(files: Mapping[str, NumbersOf], names: Table, wanted: str) -> Fact:
    """Return the numbers that [cameras.names] says."""
    text, (side, kind) = names.text(wanted), WANTED[wanted]
    counts = KINDS[kind][0]
    hits = [
        Fact(side, kind, numbers.ravel(), file, name)
        for file, values in files.items()
        for name, numbers in values.items()
        if (text in (name, f"{file}:{name}") or (text == file and len(values) == 1)) and numbers.size in counts
    ]
    if not hits:
        allowed = f"a name of {' or '.join(map(str, counts))} numbers in one of cameras.files, as NAME or FILE:NAME"
        raise names.wrong(wanted, allowed, "correct it")
    if any(not np.array_equal(one.numbers, hits[0].numbers) for one in hits):
        raise names.wrong(wanted, " or ".join(f'"{one.file}:{one.name}"' for one in hits), "say which")
    return hits[0]


def facts_of(files: Mapping[str, NumbersOf], of_projector: bool = False) -> list[Fact]:
    """Return all that is known in ``files`` with the side of each: by its name, else by its file's, else by the order
    of files."""
    # Folders and names that all have in common tell nothing, whatever words are in them.
    shared = set.intersection(*(set(Path(file).parts) for file in files)) if files else set()
    paths = {file: [part for part in Path(file).parts if part not in shared] for file in files}
    # Counted from 0 where something is called so.
    zero = any(re.search(r"cam(era)?[_-]?0(?!\d)", "/".join(parts), re.IGNORECASE) for parts in paths.values())
    zero = zero or any(ZEROS.intersection(_spellings(name)) for values in files.values() for name in values)
    first = 0 if zero else 1
    by_file = {file: list(_in_file(file, values, KNOWN[first])) for file, values in files.items()}
    sides = {
        file: {fact.side for fact in facts if fact.kind in WHOSE} - {"", "both"} for file, facts in by_file.items()
    }
    taken = set().union(*sides.values(), (_side_of(parts, first) for parts in paths.values()))
    found: list[Fact] = []
    for file, facts in by_file.items():
        in_order = ""
        for fact in facts:
            parts = paths[file][:-1] if Path(file).stem == fact.name else paths[file]
            side = fact.side
            if not side and not sides[file]:
                side = _side_of(parts, first)
                if not side and "projector" in taken and "cam" in f"{'/'.join(paths[file])} {fact.name}".lower():
                    side = "left"
                elif not side and any(one.kind in WHOSE for one in facts):
                    side = in_order = in_order or ("right" if "left" in taken else "left")
            if fact.kind in WHOSE:
                taken.add(side)
            mine = [side]
            if not side and fact.kind in ("rotation", "translation"):
                mine = ["both"]
            elif not side and fact.kind == "size":
                mine = ["left"] if of_projector or (sides[file] and "right" not in sides[file]) else ["left", "right"]
            elif not side:
                mine = [] if "left" in sides[file] else ["left"]
            found += [replace(fact, side=one) for one in mine]
    return found


def _side_of(parts: Sequence[str], first: int) -> str:
    """Return whose a file is by its folders and its name; empty where they do not say so."""
    text = "/".join(parts)
    if re.search("|".join(PROJECTOR), text, re.IGNORECASE):
        return "projector"
    words = {
        side: rf"{side}|(?<![a-z]){side[0]}(?![a-z])|cam(era)?[_-]?{n}(?!\d)"
        for n, side in ((first, "left"), (first + 1, "right"))
    }
    sides = [side for side, word in words.items() if re.search(word, text, re.IGNORECASE)]
    return sides[0] if len(sides) == 1 else ""


def _spellings(name: str) -> Iterator[str]:
    """Yield how a name may be known: with the tables in which it stands, or the last one of them, and without a word
    for camera."""
    parts = name.lower().split(".")
    for k in range(max(1, len(parts) - 1)):
        plain = re.sub(r"[^a-z0-9]", "", "".join(parts[k:]))
        yield from (plain, re.sub("^cam(era)?|cam(era)?$", "", plain))


def _in_file(file: str, values: NumbersOf, known: Mapping[tuple[str, str], str]) -> Iterator[Fact]:
    """Yield what is known in a file, by its names alone."""
    facts: list[Fact] = []
    used: set[str] = set()
    for says in DIALECTS:
        asks = [name for name in says[0][2].split() if not name.endswith("?")]
        before = next((name.removesuffix(asks[0]) for name in values if f".{name}".endswith(f".{asks[0]}")), None)
        if before is None or not all(before + name in values for name in asks):
            continue
        for side, kind, names, change in says:
            theirs = [before + name.rstrip("?") for name in names.split()]
            with suppress(KeyError, TypeError, ValueError, IndexError):
                numbers = np.asarray(change(values[theirs[0]], *map(values.get, theirs[1:])), np.float64).ravel()
                if numbers.size in KINDS[kind][0]:
                    used.update(theirs)
                    facts.append(Fact(side, kind, numbers, file, theirs[0]))
    # One table about everything says nothing: MATLAB's files often have one variable.
    while len({name.partition(".")[0] for name in values}) == 1 and all("." in name for name in values):
        used = {name.partition(".")[2] for name in used}
        values = {name.partition(".")[2]: numbers for name, numbers in values.items()}
    for name, numbers in values.items():
        for plain in () if name in used else _spellings(name):
            kinds = [kind for kind, (counts, _) in KINDS.items() if (plain, kind) in known and numbers.size in counts]
            if kinds:
                facts.append(Fact(known[plain, kinds[0]], kinds[0], numbers.ravel(), file, name))
                break
    for fact in facts:
        if fact.kind == "width":
            for other in facts:
                if (other.kind, other.side) == ("height", fact.side):
                    both = np.append(fact.numbers, other.numbers)
                    yield Fact(fact.side, "size", both, file, f"{fact.name}, {other.name}")
        elif fact.kind != "height":
            yield fact


def _put(facts: Facts, fact: Fact) -> None:
    """Add a fact. Raises ForeignError where another place says it differently."""
    if not np.all(np.abs(fact.numbers) < MOST):
        raise ForeignError(
            f"{fact.where} is {fact.numbers.tolist()!r:.80}; allowed are finite numbers below {MOST:g}; correct it"
        )
    # Programs write the same number with few digits in one place and with many in another.
    before = facts.setdefault((fact.side, fact.kind), fact)
    one, other = _comparable(before), _comparable(fact)
    if not np.allclose(one, other, rtol=SAME, atol=SAME * np.abs(one).max()):
        raise ForeignError(
            f"{before.where} and {fact.where} say the {fact.kind} of {fact.side} differently "
            f"({before.numbers.round(4).tolist()!r:.60} and {fact.numbers.round(4).tolist()!r:.60}); leave one out, or say which holds under [cameras.names]"
        )


def _comparable(fact: Fact) -> Array:
    if fact.kind == "rotation":
        return rotation_of(fact.numbers).ravel()
    return np.append(fact.numbers, np.zeros(14 - fact.numbers.size)) if fact.kind == "distortion" else fact.numbers


# -------------------------------------------------------------------------------------------- how they stand

Pose = tuple[str, Array, Array]
"""The place where it is said, R and T: x = R X + T."""


def _pose(facts: Facts, notes: list[str]) -> dict[str, Array]:
    """Return rotation and translation from left to right by whatever says them. Raises ForeignError where two ways say
    them differently.

    ``facts`` get the camera matrices that only projection matrices say.
    """
    first, second = _of_world(facts, "left"), _of_world(facts, "right")
    # What the right one alone says is in the left camera's frame.
    R, T = (
        facts.get(("both", kind), None if ("left", kind) in facts else facts.get(("right", kind)))
        for kind in ("rotation", "translation")
    )
    ways = [(R.where, rotation_of(R.numbers), T.numbers)] if R and T else []
    for (where, R1, T1), (other, R2, T2) in ((first[way], second[way]) for way in first if way in second):
        ways.append((f"{where} with {other}", R2 @ R1.T, T2 - R2 @ R1.T @ T1))
    if not ways and "own" in first:
        ways.append(first["own"])
        notes.append(
            f"cameras: rotation and translation: {first['own'][0]} stands in the left camera's file alone; taken as from left to right"
        )
    for where, turn, way in ways[1:]:
        said, rotation, translation = ways[0]
        apart_deg = float(np.degrees(np.arccos(np.clip(0.5 * (np.trace(rotation @ turn.T) - 1.0), -1.0, 1.0))))
        if apart_deg > SAME_DEG or np.linalg.norm(translation - way) > np.radians(SAME_DEG) * np.linalg.norm(
            translation
        ):
            raise ForeignError(
                f"{said} and {where} say differently how the two stand to each other: turned by {apart_deg:.2g}°, translations "
                f"{translation.round(3).tolist()} and {way.round(3).tolist()}; leave one out, or say which holds under [cameras.names]"
            )
    return {"rotation": ways[0][1], "translation": ways[0][2]} if ways else {}


def _of_world(facts: Facts, side: str) -> dict[str, Pose]:
    """Return how the world stands to a camera, by each way in which files say it."""
    R, T, P, turn = (facts.get((side, kind)) for kind in ("rotation", "translation", "projection", "rectification"))
    ways: dict[str, Pose] = {}
    if R and T:
        ways["own"] = R.where, rotation_of(R.numbers), T.numbers
    # OpenCV calls what rectifies a camera R1 or R2, and has no T1 and T2.
    turn = R if turn is None and T is None else turn
    if P is None or abs(np.linalg.det(P.numbers.reshape(3, 4)[:, :3])) < 1e-9:
        return ways
    projection = P.numbers.reshape(3, 4)
    if turn:
        # What brings both to one plane, as ROS and OpenCV's stereoRectify write: x' = R1 x, and P = K' (I | t) of each.
        back = rotation_of(turn.numbers).T
        ways["rectified"] = turn.where, back, back @ np.linalg.solve(projection[:, :3], projection[:, 3])
    elif (side, "matrix") not in facts:
        # Any multiple of it is the same camera; with a negative one the focal lengths would be so.
        signed = projection * np.sign(np.linalg.det(projection[:, :3]))
        matrix, rotation, centre = cv2.decomposeProjectionMatrix(signed)[:3]
        facts[side, "matrix"] = replace(P, kind="matrix", numbers=np.ravel(matrix / matrix[2, 2]))
        ways["projected"] = P.where, np.asarray(rotation), np.ravel(-rotation @ (centre[:3] / centre[3]))
    return ways
