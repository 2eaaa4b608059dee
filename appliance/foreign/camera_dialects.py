"""Owns what names in camera files mean: OpenCV's and those of other programs, each bound to the file in which it stands.

Two cameras are ``1`` and ``2``, left and right, or counted from 0; a projector takes the right one's place, or is a third. Where they stand is
said by R and T between them (x_right = R x_left + T), by R and T of the world into each, by projection matrices P = K (R | t), or by the rectification
that brings both to one plane. Two places that say the same thing differently are refused.
Sources of ``DIALECTS``: Kalibr's wiki, "Yaml formats"; MathWorks, ``stereoParametersToOpenCV``; J.-Y. Bouguet, Camera Calibration Toolbox for
Matlab; SLStudio's CalibrationData; SLMaster's caliInfo; Middlebury Stereo 2014, calib.txt.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.foreign.problem import ForeignError, Table

Array = NDArray[np.float64]
NumbersOf = Mapping[str, Array]
"""The numbers of a file by name; those in tables as TABLE.NAME."""

WANTED = ("left_matrix", "right_matrix", "left_distortion", "right_distortion", "rotation", "translation")
MOST = 1e9
"""Numbers of cameras are smaller than this."""
LEAST_LISTED = 3
"""Fewer numbers under a name are not worth a mention: neither matrix nor vector."""
SAME = 2e-3
"""Largest relative difference of two places that say the same."""
SAME_DEG = 1.0
"""Largest angle between two ways to say how cameras stand, which are computed from each other."""

# ------------------------------------------------------------------------------------------------ the tables

KINDS: Mapping[str, tuple[tuple[int, ...], str]] = {
    "matrix": ((9,), "m k kk cameramatrix camera cameraint intrinsic intrinsics intrinsicmatrix mtx matrix int intr cam kmatrix"),
    "distortion": ((3, 4, 5, 6, 8, 12, 14), "d distcoeffs distcoeff distcoef distortion distorsion distortioncoefficients distortioncoeffs dist kc distortions"),
    "rotation": ((9, 3), "r rotation rotationmatrix rot rmatrix rvec rotate om"),
    "translation": ((3,), "t translation translationvector trans tvec tvector translate"),
    "projection": ((12,), "p projection projectionmatrix projmatrix"),
    "rectification": ((9,), "rectificationmatrix rectification rrect"),
    "size": ((2,), "imagesize imgsize size s resolution imageresolution framesize"),
    "width": ((1,), "imagewidth width framewidth imgwidth nx"),
    "height": ((1,), "imageheight height frameheight imgheight ny"),
}  # fmt: skip
"""Kinds of what a camera file says: how many numbers each may have, and its names, in small letters without anything between."""
BETWEEN = {name: kind for kind, names in (("rotation", "rlr stereor rstereo r12"), ("translation", "tlr stereot tstereo t12")) for name in names.split()}  # fmt: skip
WHOSE = ("matrix", "projection")
"""Kinds by which a camera is told."""
PROJECTOR = ("proj", "projector", "prj")


def _known(first: int) -> dict[tuple[str, str], str]:
    """Return the side by name and kind, for every known name where cameras are counted from ``first``; empty where a name has none."""
    sides = {"left": ("l", "left"), "right": ("r", "right"), "projector": PROJECTOR}
    for n, side in ((first, "left"), (first + 1, "right")):
        sides[side] += (f"{n}", f"cam{n}", f"camera{n}")
    found = dict.fromkeys(BETWEEN.items(), "both")
    for kind, (_, names) in KINDS.items():
        for name in names.split():
            found |= {
                (both, kind): side
                for side, words in sides.items()
                for word in words
                for both in (name + word, word + name)
            }
            found[name, kind] = ""
    return found


KNOWN = (_known(0), _known(1))
ZEROS = {name for name, _ in KNOWN[0]} - {name for name, _ in KNOWN[1]}
"""Names of cameras that are counted from 0."""


def _four(*parts: Any) -> Array:
    """Return the matrix of f, c or of fu, fv, cu, cv; a third part is a skew in units of the focal length."""
    f_px, c_px = (
        (np.ravel(parts[0])[:2], np.ravel(parts[0])[2:])
        if len(parts) == 1
        else (np.ravel(parts[0]), np.ravel(parts[1]))
    )
    skew = 0.0 if len(parts) < 3 or parts[2] is None else float(np.ravel(parts[2])[0] * f_px[0])
    return np.array([[f_px[0], skew, c_px[0]], [0.0, f_px[1], c_px[1]], [0.0, 0.0, 1.0]])


def _from_one(matrix: Array) -> Array:
    """Return a matrix of MATLAB's, which counts pixels from 1 and may multiply from the right."""
    found = matrix.reshape(3, 3)
    found = (found.T if abs(found[2, 0]) > abs(found[0, 2]) else found).copy()
    found[:2, 2] -= 1.0
    return found


def _brown(radial: Array, across: Array | None) -> Array:
    k = np.append(np.ravel(radial), [0.0, 0.0])[:3]
    return np.array([k[0], k[1], *(np.zeros(2) if across is None else np.ravel(across)[:2]), k[2]])


Change = Callable[..., Array]


@dataclass(frozen=True, slots=True)
class Dialect:
    """A program's way to say what OpenCV says otherwise."""

    program: str
    asks: tuple[str, ...]
    """Names that a file has, each behind the same tables, if any."""
    yields: tuple[tuple[str, str, str, Change | None], ...]
    """Side, kind, names in the file (``?``: may be missing), and what makes ours of their numbers; ``None``: nothing."""


DIALECTS = (
    Dialect("SLStudio", ("Kc", "kc", "Kp", "kp"), (
        ("left", "matrix", "Kc", None), ("left", "distortion", "kc", None), ("projector", "matrix", "Kp", None),
        ("projector", "distortion", "kp", None), ("projector", "rotation", "Rp", None), ("projector", "translation", "Tp", None),
        ("projector", "size", "screenResX screenResY", np.append),
    )),
    Dialect("SLMaster", ("M4", "Rlp"), (
        ("projector", "matrix", "M4", None), ("projector", "distortion", "D4", None), ("projector", "rotation", "Rlp", None),
        ("projector", "translation", "Tlp", None),
    )),
    Dialect("Middlebury", ("cam0", "cam1", "baseline"), (
        ("left", "matrix", "cam0", None), ("right", "matrix", "cam1", None), ("both", "rotation", "baseline", lambda _: np.eye(3)),
        ("both", "translation", "baseline", lambda base: np.array([-base.ravel()[0], 0.0, 0.0])),
    )),
    *(Dialect("Kalibr", (f"cam{n}.intrinsics",), (
        (side, "matrix", f"cam{n}.intrinsics", _four), (side, "distortion", f"cam{n}.distortion_coeffs", None),
        (side, "size", f"cam{n}.resolution", None),
        # A point of the camera before into this one.
        ("both", "rotation", f"cam{n}.T_cn_cnm1", lambda pose: pose.reshape(4, 4)[:3, :3]),
        ("both", "translation", f"cam{n}.T_cn_cnm1", lambda pose: pose.reshape(4, 4)[:3, 3]),
    )) for n, side in enumerate(("left", "right"))),
    # Rows are multiplied by MATLAB's matrices.
    *(Dialect("MATLAB", (f"CameraParameters{n}.{name}",), (
        (side, "matrix", f"CameraParameters{n}.{name}", _from_one),
        (side, "distortion", f"CameraParameters{n}.RadialDistortion CameraParameters{n}.TangentialDistortion?", _brown),
        (side, "size", f"CameraParameters{n}.ImageSize", lambda size: np.ravel(size)[::-1]),
        ("both", "rotation", "RotationOfCamera2", lambda turn: turn.reshape(3, 3).T), ("both", "translation", "TranslationOfCamera2", None),
    )) for n, side in enumerate(("left", "right"), 1) for name in ("IntrinsicMatrix", "K")),
    *(Dialect("Bouguet", (f"fc{behind}", f"cc{behind}"), ((side, "matrix", f"fc{behind} cc{behind} alpha_c{behind}?", _four),))
      for behind, side in (("_left", "left"), ("_right", "right"), ("", ""))),
)  # fmt: skip

LENSES = {
    "camera_model": ("pinhole",),
    "distortion_model": ("radtan", "plumb_bob", "plumb-bob", "rational_polynomial", "none", "brown", "opencv"),
}
"""Models that OpenCV's numbers describe, by the name under which files say them."""


def refuse_other_lenses(source: str, words: Mapping[str, str]) -> None:
    """Raise ForeignError for a model of lenses that is no pinhole with OpenCV's distortion; ``words`` are a file's texts by name."""
    for name, word in words.items():
        allowed = LENSES.get(name.rpartition(".")[2].lower())
        if allowed is not None and word and word.lower() not in allowed:
            raise ForeignError(
                f"{source}: {name} is {word!r:.40}; allowed: {', '.join(allowed)}; fisheye and other lenses are not read: calibrate with "
                "OpenCV's model, or undistort the images and give the matrices of these"
            )


# ----------------------------------------------------------------------------------------------- what is said


@dataclass(frozen=True, slots=True)
class CameraNumbers:
    """All that camera files say of two cameras."""

    found: Mapping[str, Array]
    """``WANTED``; those of distortion may be empty."""
    stated_px: Mapping[str, tuple[int, int]]
    """Sizes by side as far as they are stated; the right one is a projector's where it takes that place."""
    stated_in: Mapping[str, str]
    """The file of each of these, and its name there."""
    has_projector: bool
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Fact:
    """Numbers of one kind, and of whom: ``left``, ``right``, ``projector``, ``both``: between them; empty: whoever's file it is."""

    side: str
    kind: str
    numbers: Array
    file: str
    name: str

    @property
    def where(self) -> str:
        return f"{self.file}: {self.name}"


Facts = dict[tuple[str, str], Fact]


def understood(files: Mapping[str, NumbersOf], names: Table, of_projector: bool) -> CameraNumbers:
    """Return what ``files`` say of two cameras, or of one and a projector. ``names`` are the description's own for single numbers: NAME,
    FILE:NAME or the FILE of a single matrix. Raises ForeignError."""
    names.only(*WANTED)
    said = {wanted: _named(files, names, wanted) for wanted in names.content}
    facts: Facts = {}
    for fact in facts_of(files, of_projector):
        if (fact.file, fact.name) not in said.values():
            _put(facts, fact)
    cameras = {side for side, kind in facts if kind in WHOSE} | ({"right"} if "right_matrix" in said else set())
    other = "projector" if of_projector and "projector" in cameras else "right"
    if not of_projector and "projector" in cameras and "right" not in cameras:
        where = next(fact.where for (side, kind), fact in facts.items() if side == "projector" and kind in WHOSE)
        raise ForeignError(
            f"cameras.files: {where} is a projector's, and the images are of two cameras; give the file of both "
            "cameras, or leave images.right out"
        )
    found: dict[str, Array] = {}
    notes: list[str] = []
    for ours, theirs in (("left", "left"), ("right", other)):
        found |= {
            f"{ours}_{kind}": facts[theirs, kind].numbers
            for kind in ("matrix", "distortion")
            if (theirs, kind) in facts
        }
    if not {"rotation", "translation"} <= said.keys():
        found |= _pose(facts, other, found, notes)
    found |= {wanted: files[file][name] for wanted, (file, name) in said.items()}
    missing = [name for name in WANTED if name not in found and not name.endswith("distortion")]
    if missing:
        there = "; ".join(
            f"{file}: {', '.join([name for name, numbers in values.items() if numbers.size >= LEAST_LISTED][:20])[:400] or 'no matrices'}"
            for file, values in files.items()
        )
        raise ForeignError(
            f"cameras.files have no {', '.join(missing)} under a name that is known ({there}); say which is which under [cameras.names], "
            f'for example {missing[0]} = "NAME" or "FILE:NAME"'
        )
    sizes = {
        ours: facts[theirs, "size"]
        for ours, theirs in (("left", "left"), ("right", other))
        if (theirs, "size") in facts
    }
    return CameraNumbers(
        {name: found.get(name, np.empty(0)) for name in WANTED},
        {side: (int(fact.numbers[0]), int(fact.numbers[1])) for side, fact in sizes.items()},
        {side: fact.where for side, fact in sizes.items()}, "projector" in cameras, tuple(notes),
    )  # fmt: skip


def _named(files: Mapping[str, NumbersOf], names: Table, wanted: str) -> tuple[str, str]:
    """Return the file and the name in it that [cameras.names] says."""
    text = names.text(wanted)
    hits = [
        (file, name) for file, values in files.items() for name in values
        if text in (name, f"{file}:{name}") or (text == file and len(values) == 1)
    ]  # fmt: skip
    if not hits:
        raise names.wrong(wanted, "a name in one of cameras.files, as NAME or FILE:NAME", "correct it")
    if any(not np.array_equal(files[file][name], files[hits[0][0]][hits[0][1]]) for file, name in hits):
        raise names.wrong(wanted, " or ".join(f'"{file}:{name}"' for file, name in hits), "say which")
    return hits[0]


def facts_of(files: Mapping[str, NumbersOf], of_projector: bool = False) -> list[Fact]:
    """Return all that is known in ``files`` with the side of each: by its name, else by its file's, else by the order of files."""
    # Folders and names that all have in common tell nothing, whatever words are in them.
    shared = set.intersection(*(set(Path(file).parts) for file in files)) if files else set()
    paths = {file: [part for part in Path(file).parts if part not in shared] for file in files}
    # Counted from 0 where something is called so.
    zero = any(re.search(r"cam(era)?[_-]?0(?!\d)", "/".join(parts), re.IGNORECASE) for parts in paths.values())
    first = (
        0 if zero or any(ZEROS.intersection(_spellings(name)) for values in files.values() for name in values) else 1
    )
    by_file = {file: list(_in_file(file, values, KNOWN[first])) for file, values in files.items()}
    sides = {file: {fact.side for fact in facts if fact.kind in WHOSE} - {""} for file, facts in by_file.items()}
    taken = set().union(*sides.values(), *(_sides_of(parts, first) for parts in paths.values()))
    found: list[Fact] = []
    for file, facts in by_file.items():
        ordered: list[str] = []
        for fact in facts:
            parts = paths[file][:-1] if Path(file).stem == fact.name else paths[file]
            mine = [fact.side] if fact.side else [] if sides[file] else _sides_of(parts, first)
            if not mine and not sides[file]:
                if "projector" in taken and "cam" in f"{'/'.join(paths[file])} {fact.name}".lower():
                    mine = ["left"]
                elif any(one.kind in WHOSE for one in facts):
                    ordered = ordered or ["right" if "left" in taken else "left"]
                    mine = ordered
            taken.update(mine if fact.kind in WHOSE else [])
            if not mine and fact.kind in ("rotation", "translation"):
                mine = ["both"]
            elif not mine and fact.kind == "size":
                mine = ["left"] if of_projector or (sides[file] and "right" not in sides[file]) else ["left", "right"]
            elif not mine and "left" not in sides[file]:
                mine = ["left"]
            found += [replace(fact, side=side) for side in mine]
    return found


def _sides_of(parts: Sequence[str], first: int) -> list[str]:
    """Return whose a file is by its folders and its name, if they say so."""
    text = "/".join(parts)
    if re.search("|".join(PROJECTOR), text, re.IGNORECASE):
        return ["projector"]
    words = {
        side: rf"{side}|(?<![a-z]){side[0]}(?![a-z])|cam(era)?[_-]?{n}(?!\d)"
        for n, side in ((first, "left"), (first + 1, "right"))
    }
    sides = [side for side, word in words.items() if re.search(word, text, re.IGNORECASE)]
    return sides if len(sides) == 1 else []


def _spellings(name: str) -> Iterator[str]:
    """Yield how a name may be known: with the tables in which it stands, or the last one of them, and without a word for camera."""
    parts = name.lower().split(".")
    for k in range(max(1, len(parts) - 1)):
        plain = re.sub(r"[^a-z0-9]", "", "".join(parts[k:]))
        yield from (plain, re.sub("^cam(era)?|cam(era)?$", "", plain))


def _in_file(file: str, values: NumbersOf, known: Mapping[tuple[str, str], str]) -> Iterator[Fact]:
    """Yield what is known in a file, by its names alone."""
    used: set[str] = set()
    for dialect in DIALECTS:
        first = dialect.asks[0]
        before = next((name.removesuffix(first) for name in values if f".{name}".endswith(f".{first}")), None)
        if before is None or not all(before + one in values for one in dialect.asks):
            continue
        for side, kind, names, change in dialect.yields:
            theirs = [before + one.rstrip("?") for one in names.split()]
            if theirs[0] not in values:
                continue
            try:
                numbers = np.asarray(
                    change(*map(values.get, theirs)) if change else values[theirs[0]], np.float64
                ).ravel()
            except (TypeError, ValueError, IndexError):
                continue
            if numbers.size not in KINDS[kind][0]:
                continue
            used.update(theirs)
            yield Fact(side, kind, numbers, file, theirs[0])
    # One table about everything says nothing: MATLAB's files often have one variable.
    while len({name.partition(".")[0] for name in values}) == 1 and all("." in name for name in values):
        used = {name.partition(".")[2] for name in used}
        values = {name.partition(".")[2]: numbers for name, numbers in values.items()}
    widths: dict[str, Fact] = {}
    for name, numbers in values.items():
        for plain in () if name in used else _spellings(name):
            kinds = [kind for kind, (sizes, _) in KINDS.items() if (plain, kind) in known and numbers.size in sizes]
            if kinds:
                fact = Fact(known[plain, kinds[0]], kinds[0], numbers.ravel(), file, name)
                if fact.kind == "width":
                    widths[fact.side] = fact
                elif fact.kind != "height":
                    yield fact
                elif fact.side in widths:
                    both = np.append(widths[fact.side].numbers, fact.numbers)
                    yield Fact(fact.side, "size", both, file, f"{widths[fact.side].name}, {name}")
                break


def _put(facts: Facts, fact: Fact) -> None:
    """Add a fact. Raises ForeignError where another place says it differently."""
    if not np.all(np.abs(fact.numbers) < MOST):
        raise ForeignError(
            f"cameras.files: {fact.where} is {fact.numbers.tolist()!r:.80}; allowed are finite numbers below {MOST:g}; correct it"
        )
    # Programs write the same number with few digits in one place and with many in another.
    before = facts.setdefault((fact.side, fact.kind), fact)
    one, other = _comparable(before), _comparable(fact)
    if not np.allclose(one, other, rtol=SAME, atol=SAME * np.abs(one).max()):
        raise ForeignError(
            f"cameras.files: {before.where} and {fact.where} say the {fact.kind} of {fact.side} differently "
            f"({before.numbers.round(4).tolist()!r:.60} and {fact.numbers.round(4).tolist()!r:.60}); leave one out, or say which holds under [cameras.names]"
        )


def _comparable(fact: Fact) -> Array:
    if fact.kind == "rotation":
        return rotation_of(fact.numbers).ravel()
    return np.append(fact.numbers, np.zeros(14 - fact.numbers.size)) if fact.kind == "distortion" else fact.numbers


def rotation_of(numbers: Array) -> Array:
    """Return the matrix (3, 3) of nine numbers, or of a vector of three: axis times angle."""
    return (
        np.asarray(cv2.Rodrigues(numbers.reshape(3, 1))[0], np.float64) if numbers.size == 3 else numbers.reshape(3, 3)
    )


# -------------------------------------------------------------------------------------------- how they stand

Pose = tuple[str, Array, Array]
"""The place where it is said, R and T: x = R X + T."""


def _pose(facts: Facts, other: str, found: dict[str, Array], notes: list[str]) -> dict[str, Array]:
    """Return rotation and translation from left to right by whatever says them. Raises ForeignError where two ways say them differently.

    ``found`` gets the camera matrices that only projection matrices say.
    """
    first, second = _of_world(facts, "left", "left", found), _of_world(facts, other, "right", found)
    told: list[Fact | None] = []
    for kind in ("rotation", "translation"):
        # Of two cameras and a projector, what is between both is the cameras'. A pose that one alone has in the left camera's frame is that, too.
        both = None if other == "projector" and ("right", "matrix") in facts else facts.get(("both", kind))
        told.append(both or (None if ("left", kind) in facts else facts.get((other, kind))))
    ways = [(told[0].where, rotation_of(told[0].numbers), told[1].numbers)] if told[0] and told[1] else []
    for where, R1, T1, R2, T2 in [
        (f"{first[way][0]} with {second[way][0]}", *first[way][1:], *second[way][1:]) for way in first if way in second
    ]:
        ways.append((where, R2 @ R1.T, T2 - R2 @ R1.T @ T1))
    if not ways and "own" in first:
        ways.append(first["own"])
        notes.append(
            f"cameras: rotation and translation: {first['own'][0]} stands in the left camera's file alone; taken as from left to right"
        )
    if not ways:
        return {}
    said, R, T = ways[0]
    for where, turn, way in ways[1:]:
        apart_deg = float(np.degrees(np.arccos(np.clip(0.5 * (np.trace(R @ turn.T) - 1.0), -1.0, 1.0))))
        if apart_deg > SAME_DEG or np.linalg.norm(T - way) > np.radians(SAME_DEG) * np.linalg.norm(T):
            raise ForeignError(
                f"cameras.files: {said} and {where} say differently how the two stand to each other: turned by {apart_deg:.2g}°, translations "
                f"{T.round(3).tolist()} and {way.round(3).tolist()}; leave one out, or say which holds under [cameras.names]"
            )
    return {"rotation": R, "translation": T}


def _of_world(facts: Facts, side: str, ours: str, found: dict[str, Array]) -> dict[str, Pose]:
    """Return how the world stands to a camera, by each way in which files say it."""
    R, T, P, turn = (facts.get((side, kind)) for kind in ("rotation", "translation", "projection", "rectification"))
    ways: dict[str, Pose] = {}
    if R is not None and T is not None:
        ways["own"] = R.where, rotation_of(R.numbers), T.numbers
    # OpenCV calls what rectifies a camera R1 or R2, and has no T1 and T2.
    turn = R if turn is None and T is None else turn
    if P is None or abs(np.linalg.det(P.numbers.reshape(3, 4)[:, :3])) < 1e-9:
        return ways
    projection = P.numbers.reshape(3, 4)
    if turn is not None:
        # What brings both to one plane, as ROS and OpenCV's stereoRectify write: x' = R1 x, and P = K' (I | t) of each.
        back = rotation_of(turn.numbers).T
        ways["rectified"] = turn.where, back, back @ np.linalg.solve(projection[:, :3], projection[:, 3])
    elif (side, "matrix") not in facts:
        # Any multiple of it is the same camera; with a negative one the focal lengths would be so.
        matrix, rotation, centre = cv2.decomposeProjectionMatrix(
            projection * np.sign(np.linalg.det(projection[:, :3]))
        )[:3]
        found[f"{ours}_matrix"] = np.asarray(matrix / matrix[2, 2], np.float64)
        ways["projected"] = P.where, np.asarray(rotation), np.ravel(-rotation @ (centre[:3] / centre[3]))
    return ways
