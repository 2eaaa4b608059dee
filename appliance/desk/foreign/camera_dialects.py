"""Meaning of the names in camera files, OpenCV's and those of other programs.

Two cameras are ``1`` and ``2``, left and right, or counted from 0; a projector takes the place of the right one, or is a
third. Their poses are given by R and T between them (x_right = R x_left + T), by R and T of the world into each, by
projection matrices P = K (R | t), or by the rectification that brings both to one plane. Two places that give one
quantity differently are rejected. Sources of ``DIALECTS``: Kalibr's wiki, "Yaml formats"; MathWorks,
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
"""Numbers of a file by name; those in tables as TABLE.NAME."""

REQUIRED = {
    "left_matrix": ("left", "matrix"),
    "right_matrix": ("right", "matrix"),
    "left_distortion": ("left", "distortion"),
    "right_distortion": ("right", "distortion"),
    "rotation": ("both", "rotation"),
    "translation": ("both", "translation"),
}
"""Side and kind of all numbers that are read, by their name in a description."""
MAX_NUMBER = 1e9
"""Numbers of cameras are smaller than this."""
MIN_LISTED_NUMBERS = 3
"""Least count of numbers under a name that an error lists: fewer are neither matrix nor vector."""
MAX_RELATIVE_DIFFERENCE = 2e-3
"""Largest relative difference of two places that agree."""
MAX_ANGLE_DEG = 1.0
"""Largest angle between two rotations that agree, as one of them is computed from other numbers."""

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
"""Kinds of entries in a camera file: allowed counts of numbers, and names in small letters without separators."""
CAMERA_KINDS = ("matrix", "projection")
"""Kinds that show that a side has a camera."""
PROJECTOR = ("proj", "projector", "prj")


def _sides_by_name(first: int) -> dict[tuple[str, str], str]:
    """Return the side by name and kind, for all names where cameras are counted from ``first``.

    The side is empty where a name has none.
    """
    sides = {"both": ("lr", "stereo", "12"), "projector": (*PROJECTOR, "screen")}
    for n, side in ((first, "left"), (first + 1, "right")):
        sides[side] = (side, side[0], f"{n}", f"cam{n}", f"camera{n}")
    side_by_name: dict[tuple[str, str], str] = {}
    for kind, (_, names) in KINDS.items():
        for name in names.split():
            for side, affixes in sides.items():
                side_by_name |= {
                    (full_name, kind): side for word in affixes for full_name in (name + word, word + name)
                }
            side_by_name[name, kind] = ""
    return side_by_name


SIDES_BY_NAME = (_sides_by_name(0), _sides_by_name(1))
ZERO_BASED_NAMES = {name for name, _ in SIDES_BY_NAME[0]} - {name for name, _ in SIDES_BY_NAME[1]}
"""Names of cameras that are counted from 0."""


def _four(f_and_c: Array, c_px: Array | None = None, skew: Array | None = None) -> Array:
    """Return the camera matrix of fu, fv, cu, cv, or of f and c.

    A skew is in units of the focal length.
    """
    fu, fv, cu, cv = np.ravel(f_and_c if c_px is None else [f_and_c, c_px])
    return np.array([[fu, 0.0 if skew is None else float(np.ravel(skew)[0]) * fu, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]])


def _from_one(matrix: Array) -> Array:
    """Return a camera matrix from MATLAB's, which counts pixels from 1 and may multiply from the right."""
    camera_matrix = matrix.reshape(3, 3)
    camera_matrix = (camera_matrix.T if abs(camera_matrix[2, 0]) > abs(camera_matrix[0, 2]) else camera_matrix).copy()
    camera_matrix[:2, 2] -= 1.0
    return camera_matrix


def _brown(radial: Array, across: Array | None) -> Array:
    k = np.append(radial, [0.0, 0.0])[:3]
    return np.array([*k[:2], *(np.zeros(2) if across is None else np.ravel(across)[:2]), k[2]])


def rotation_of(numbers: Array) -> Array:
    """Return the rotation matrix (3, 3) of nine numbers, or of a rotation vector."""
    return np.asarray(cv2.Rodrigues(numbers)[0] if numbers.size == 3 else numbers.reshape(3, 3), np.float64)


DialectRow = tuple[str, str, str, Callable[..., Any]]
"""Side, kind, names in the file (``?``: may be missing), and a function from their numbers to ours."""

DIALECTS: tuple[tuple[DialectRow, ...], ...] = (
    # SLStudio
    (("left", "matrix", "Kc", np.ravel), ("left", "distortion", "kc", np.ravel), ("projector", "matrix", "Kp", np.ravel),
     ("projector", "distortion", "kp", np.ravel), ("projector", "rotation", "Rp", np.ravel), ("projector", "translation", "Tp", np.ravel)),
    # SLMaster
    (("projector", "rotation", "Rlp", np.ravel), ("projector", "translation", "Tlp", np.ravel), ("projector", "matrix", "M4", np.ravel),
     ("projector", "distortion", "D4", np.ravel)),
    # Middlebury
    (("both", "translation", "baseline cam0 cam1", lambda base, *_: [-base.ravel()[0], 0.0, 0.0]), ("left", "matrix", "cam0", np.ravel),
     ("right", "matrix", "cam1", np.ravel), ("both", "rotation", "baseline", lambda _: np.eye(3))),
    # Renderings by Blender: the place of each device in the world, and the rotation of the world into it
    (("", "translation", "rotate translate", lambda rotation, place: -rotation_of(rotation) @ place.ravel()), ("", "rotation", "rotate", np.ravel)),
    # Kalibr: T_cn_cnm1 is the pose of the previous camera in this one
    *(((side, "matrix", f"cam{n}.intrinsics", _four), (side, "distortion", f"cam{n}.distortion_coeffs", np.ravel),
       (side, "size", f"cam{n}.resolution", np.ravel), ("both", "rotation", f"cam{n}.T_cn_cnm1", lambda pose: pose.reshape(4, 4)[:3, :3]),
       ("both", "translation", f"cam{n}.T_cn_cnm1", lambda pose: pose.reshape(4, 4)[:3, 3])) for n, side in enumerate(("left", "right"))),
    # MATLAB: rows are multiplied by its matrices
    *(((side, "matrix", f"CameraParameters{n}.{name}", _from_one),
       (side, "distortion", f"CameraParameters{n}.RadialDistortion CameraParameters{n}.TangentialDistortion?", _brown),
       (side, "size", f"CameraParameters{n}.ImageSize", lambda size: np.ravel(size)[::-1]),
       ("both", "rotation", "RotationOfCamera2", lambda rotation: rotation.reshape(3, 3).T), ("both", "translation", "TranslationOfCamera2", np.ravel))
      for n, side in enumerate(("left", "right"), 1) for name in ("IntrinsicMatrix", "K")),
    # Bouguet
    *(((side, "matrix", f"fc{behind} cc{behind} alpha_c{behind}?", _four),) for behind, side in (("_left", "left"), ("_right", "right"), ("", ""))),
)  # fmt: skip
"""Rows of each program with names or numbers of its own; a file is of a program if it has the names of the first row,
below the same tables if any."""

LENSES = {
    "camera_model": ("pinhole",),
    "distortion_model": ("radtan", "plumb_bob", "plumb-bob", "rational_polynomial", "none", "brown", "opencv"),
}
"""Lens models that OpenCV's numbers describe, by the key under which files name them."""


def refuse_other_lenses(source: str, content: Mapping[str, Any]) -> None:
    """Raise ForeignError for a lens model other than a pinhole with OpenCV's distortion."""
    for name, word in content.items():
        allowed = LENSES.get(name.rpartition(".")[2].lower())
        if allowed and isinstance(word, str) and word and word.lower() not in allowed:
            raise ForeignError(
                f"{source}: {name} is {word!r:.40}; allowed: {', '.join(allowed)}; fisheye and other lens models "
                "are not "
                "supported; calibrate with OpenCV's model, or undistort the images and give their matrices"
            )


# --------------------------------------------------------------------------------------------------- numbers


@dataclass(frozen=True, slots=True)
class Fact:
    """Numbers of one kind, with their side and source.

    ``side`` is ``left``, ``right``, ``projector``, or ``both`` for a pose between two; empty if the file does not say it.
    """

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
    """Numbers that camera files give of two cameras."""

    numbers: Mapping[str, Array]
    """The numbers by the keys of ``REQUIRED``; those of distortion may be empty."""
    sizes: Mapping[str, Fact]
    """Image sizes by side, as far as they are stated; a projector in the right camera's place is ``right``, else a third
    side."""
    has_projector: bool
    notes: tuple[str, ...]

    @property
    def stated_px(self) -> dict[str, tuple[int, int]]:
        """Width and height by side."""
        return {side: (int(fact.numbers[0]), int(fact.numbers[1])) for side, fact in self.sizes.items()}


def interpret_numbers(files: Mapping[str, NumbersOf], names: Table, of_projector: bool) -> CameraNumbers:
    """Return the numbers that ``files`` give of two cameras, or of one and a projector.

    ``names`` are the description's own for single numbers: NAME, FILE:NAME or the FILE of a single matrix. Raises
    ForeignError.
    """
    names.only(*REQUIRED)
    facts: Facts = {}
    for key_name in names.content:
        _add_fact(facts, _read_named(files, names, key_name))
    fixed, named = set(facts), {(fact.file, fact.name) for fact in facts.values()}
    unnamed = [fact for fact in facts_of(files, of_projector) if (fact.file, fact.name) not in named]
    cameras = {fact.side: fact for fact in unnamed if fact.kind in CAMERA_KINDS}
    projector = cameras.get("projector")
    if of_projector:
        # The projector takes the right camera's place; beside a second camera, a pose between two is that of the cameras.
        ignored = () if projector is None else ("right", "both") if "right" in cameras else ("right",)
        unnamed = [
            replace(fact, side=fact.side.replace("projector", "right")) for fact in unnamed if fact.side not in ignored
        ]
    elif projector and "right" not in cameras and ("right", "matrix") not in fixed:
        raise ForeignError(
            f"cameras.files: {projector.where} is that of a projector, but the images are of two cameras; give the "
            "file of both "
            "cameras, or leave out images.right"
        )
    for fact in unnamed:
        if (fact.side, fact.kind) not in fixed:
            _add_fact(facts, fact)
    notes: list[str] = []
    pose = {} if {REQUIRED["rotation"], REQUIRED["translation"]} <= fixed else _pose(facts, notes)
    chosen = pose | {
        key_name: facts[key].numbers
        for key_name, key in REQUIRED.items()
        if key in (fixed if key_name in pose else facts)
    }
    missing = [key_name for key_name in REQUIRED if key_name not in chosen and not key_name.endswith("distortion")]
    if missing:
        names_text = "; ".join(
            f"{file}: {', '.join([name for name, numbers in values.items() if numbers.size >= MIN_LISTED_NUMBERS][:20])[:400] or 'no matrices'}"
            for file, values in files.items()
        )
        raise ForeignError(
            f"cameras have no {', '.join(missing)} under a known name ({names_text}); give their names under "
            "[cameras.names], "
            f'for example {missing[0]} = "NAME" or "FILE:NAME"'
        )
    sizes = {side: fact for (side, kind), fact in facts.items() if kind == "size"}
    return CameraNumbers(
        {key_name: chosen.get(key_name, np.empty(0)) for key_name in REQUIRED},
        sizes,
        projector is not None,
        tuple(notes),
    )


def _read_named(files: Mapping[str, NumbersOf], names: Table, key: str) -> Fact:
    """Return the numbers that an entry of [cameras.names] names."""
    text, (side, kind) = names.text(key), REQUIRED[key]
    counts = KINDS[kind][0]
    hits = [
        Fact(side, kind, numbers.ravel(), file, name)
        for file, values in files.items()
        for name, numbers in values.items()
        if (text in (name, f"{file}:{name}") or (text == file and len(values) == 1)) and numbers.size in counts
    ]
    if not hits:
        allowed = f"a name of {' or '.join(map(str, counts))} numbers in one of cameras.files, as NAME or FILE:NAME"
        raise names.wrong(key, allowed, "correct it")
    if any(not np.array_equal(hit.numbers, hits[0].numbers) for hit in hits):
        raise names.wrong(key, " or ".join(f'"{hit.file}:{hit.name}"' for hit in hits), "say which")
    return hits[0]


def facts_of(files: Mapping[str, NumbersOf], of_projector: bool = False) -> list[Fact]:
    """Return all numbers with a known name in ``files``, each with its side.

    The side follows from the name, else from the file's name, else from the order of the files.
    """
    # Ignore words in folders and names that all files share.
    shared = set.intersection(*(set(Path(file).parts) for file in files)) if files else set()
    paths = {file: [part for part in Path(file).parts if part not in shared] for file in files}
    # Cameras are counted from 0 if any name has a 0.
    zero = any(re.search(r"cam(era)?[_-]?0(?!\d)", "/".join(parts), re.IGNORECASE) for parts in paths.values())
    zero = zero or any(ZERO_BASED_NAMES.intersection(_spellings(name)) for values in files.values() for name in values)
    first = 0 if zero else 1
    by_file = {file: list(_in_file(file, values, SIDES_BY_NAME[first])) for file, values in files.items()}
    sides = {
        file: {fact.side for fact in facts if fact.kind in CAMERA_KINDS} - {"", "both"}
        for file, facts in by_file.items()
    }
    known_sides = set().union(*sides.values(), (_side_of(parts, first) for parts in paths.values()))
    results: list[Fact] = []
    for file, facts in by_file.items():
        in_order = ""
        for fact in facts:
            parts = paths[file][:-1] if Path(file).stem == fact.name else paths[file]
            side = fact.side
            if not side and not sides[file]:
                side = _side_of(parts, first)
                if not side and "projector" in known_sides and "cam" in f"{'/'.join(paths[file])} {fact.name}".lower():
                    side = "left"
                elif not side and any(sibling.kind in CAMERA_KINDS for sibling in facts):
                    side = in_order = in_order or ("right" if "left" in known_sides else "left")
            if fact.kind in CAMERA_KINDS:
                known_sides.add(side)
            own_sides = [side]
            if not side and fact.kind in ("rotation", "translation"):
                own_sides = ["both"]
            elif not side and fact.kind == "size":
                own_sides = (
                    ["left"] if of_projector or (sides[file] and "right" not in sides[file]) else ["left", "right"]
                )
            elif not side:
                own_sides = [] if "left" in sides[file] else ["left"]
            results += [replace(fact, side=own_side) for own_side in own_sides]
    return results


def _side_of(parts: Sequence[str], first: int) -> str:
    """Return the side that the folders and the name of a file tell; empty if they do not."""
    text = "/".join(parts)
    if re.search("|".join(PROJECTOR), text, re.IGNORECASE):
        return "projector"
    patterns = {
        side: rf"{side}|(?<![a-z]){side[0]}(?![a-z])|cam(era)?[_-]?{n}(?!\d)"
        for n, side in ((first, "left"), (first + 1, "right"))
    }
    sides = [side for side, word in patterns.items() if re.search(word, text, re.IGNORECASE)]
    return sides[0] if len(sides) == 1 else ""


def _spellings(name: str) -> Iterator[str]:
    """Yield the spellings of a name: with its tables or the last of them, and without a word for camera."""
    parts = name.lower().split(".")
    for k in range(max(1, len(parts) - 1)):
        plain = re.sub(r"[^a-z0-9]", "", "".join(parts[k:]))
        yield from (plain, re.sub("^cam(era)?|cam(era)?$", "", plain))


def _in_file(file: str, values: NumbersOf, side_by_name: Mapping[tuple[str, str], str]) -> Iterator[Fact]:
    """Yield the facts of a file, by its names alone."""
    facts: list[Fact] = []
    used: set[str] = set()
    for rows in DIALECTS:
        required = [name for name in rows[0][2].split() if not name.endswith("?")]
        prefix = next(
            (name.removesuffix(required[0]) for name in values if f".{name}".endswith(f".{required[0]}")), None
        )
        if prefix is None or not all(prefix + name in values for name in required):
            continue
        for side, kind, names, change in rows:
            full_names = [prefix + name.rstrip("?") for name in names.split()]
            with suppress(KeyError, TypeError, ValueError, IndexError):
                numbers = np.asarray(
                    change(values[full_names[0]], *map(values.get, full_names[1:])), np.float64
                ).ravel()
                if numbers.size in KINDS[kind][0]:
                    used.update(full_names)
                    facts.append(Fact(side, kind, numbers, file, full_names[0]))
    # Skip a table that holds the whole file: MATLAB's files often have one variable.
    while len({name.partition(".")[0] for name in values}) == 1 and all("." in name for name in values):
        used = {name.partition(".")[2] for name in used}
        values = {name.partition(".")[2]: numbers for name, numbers in values.items()}
    for name, numbers in values.items():
        for plain in () if name in used else _spellings(name):
            kinds = [
                kind for kind, (counts, _) in KINDS.items() if (plain, kind) in side_by_name and numbers.size in counts
            ]
            if kinds:
                facts.append(Fact(side_by_name[plain, kinds[0]], kinds[0], numbers.ravel(), file, name))
                break
    for fact in facts:
        if fact.kind == "width":
            for height in facts:
                if (height.kind, height.side) == ("height", fact.side):
                    size_px = np.append(fact.numbers, height.numbers)
                    yield Fact(fact.side, "size", size_px, file, f"{fact.name}, {height.name}")
        elif fact.kind != "height":
            yield fact


def _add_fact(facts: Facts, fact: Fact) -> None:
    """Add a fact. Raises ForeignError if another place gives another value."""
    if not np.all(np.abs(fact.numbers) < MAX_NUMBER):
        raise ForeignError(
            f"{fact.where} is {fact.numbers.tolist()!r:.80}; allowed are finite numbers below {MAX_NUMBER:g}; correct it"
        )
    # Programs write the same number with few digits in one place and with many in another.
    earlier = facts.setdefault((fact.side, fact.kind), fact)
    earlier_numbers, numbers = _comparable(earlier), _comparable(fact)
    if not np.allclose(
        earlier_numbers,
        numbers,
        rtol=MAX_RELATIVE_DIFFERENCE,
        atol=MAX_RELATIVE_DIFFERENCE * np.abs(earlier_numbers).max(),
    ):
        raise ForeignError(
            f"{earlier.where} and {fact.where} have different values of {fact.kind} of {fact.side} "
            f"({earlier.numbers.round(4).tolist()!r:.60} and {fact.numbers.round(4).tolist()!r:.60}); leave one "
            "out, or choose one under [cameras.names]"
        )


def _comparable(fact: Fact) -> Array:
    if fact.kind == "rotation":
        return rotation_of(fact.numbers).ravel()
    return np.append(fact.numbers, np.zeros(14 - fact.numbers.size)) if fact.kind == "distortion" else fact.numbers


# ------------------------------------------------------------------------------------------------------ poses

Pose = tuple[str, Array, Array]
"""Source, R and T: x = R X + T."""


def _pose(facts: Facts, notes: list[str]) -> dict[str, Array]:
    """Return rotation and translation from left to right, from any numbers that give them.

    ``facts`` get the camera matrices that only projection matrices give. Raises ForeignError if two sources disagree.
    """
    first, second = _of_world(facts, "left"), _of_world(facts, "right")
    # A pose of the right camera alone is in the left camera's frame.
    R, T = (
        facts.get(("both", kind), None if ("left", kind) in facts else facts.get(("right", kind)))
        for kind in ("rotation", "translation")
    )
    poses = [(R.where, rotation_of(R.numbers), T.numbers)] if R and T else []
    for (left_where, R1, T1), (right_where, R2, T2) in (
        (first[source], second[source]) for source in first if source in second
    ):
        poses.append((f"{left_where} with {right_where}", R2 @ R1.T, T2 - R2 @ R1.T @ T1))
    if not poses and "own" in first:
        poses.append(first["own"])
        notes.append(
            f"cameras: rotation and translation: {first['own'][0]} is in the left camera's file alone; it is taken "
            "as from left to right"
        )
    for where, rival_rotation, rival_translation in poses[1:]:
        first_where, rotation, translation = poses[0]
        apart_deg = float(
            np.degrees(np.arccos(np.clip(0.5 * (np.trace(rotation @ rival_rotation.T) - 1.0), -1.0, 1.0)))
        )
        if apart_deg > MAX_ANGLE_DEG or np.linalg.norm(translation - rival_translation) > np.radians(
            MAX_ANGLE_DEG
        ) * np.linalg.norm(translation):
            raise ForeignError(
                f"{first_where} and {where} have different relative poses: {apart_deg:.2g}° apart, translations "
                f"{translation.round(3).tolist()} and {rival_translation.round(3).tolist()}; leave one out, or "
                "choose one under [cameras.names]"
            )
    return {"rotation": poses[0][1], "translation": poses[0][2]} if poses else {}


def _of_world(facts: Facts, side: str) -> dict[str, Pose]:
    """Return the pose of the world in a camera's frame, by each kind of source."""
    R, T, P, rectification = (
        facts.get((side, kind)) for kind in ("rotation", "translation", "projection", "rectification")
    )
    poses: dict[str, Pose] = {}
    if R and T:
        poses["own"] = R.where, rotation_of(R.numbers), T.numbers
    # OpenCV names the rectifying rotations R1 and R2, and has no T1 and T2.
    rectification = R if rectification is None and T is None else rectification
    if P is None or abs(np.linalg.det(P.numbers.reshape(3, 4)[:, :3])) < 1e-9:
        return poses
    projection = P.numbers.reshape(3, 4)
    if rectification:
        # Rectification as ROS and OpenCV's stereoRectify write it: x' = R1 x, and P = K' (I | t) of each camera.
        inverse = rotation_of(rectification.numbers).T
        poses["rectified"] = (
            rectification.where,
            inverse,
            inverse @ np.linalg.solve(projection[:, :3], projection[:, 3]),
        )
    elif (side, "matrix") not in facts:
        # Any multiple is the same camera; a negative one would make the focal lengths negative.
        signed = projection * np.sign(np.linalg.det(projection[:, :3]))
        matrix, rotation, centre = cv2.decomposeProjectionMatrix(signed)[:3]
        facts[side, "matrix"] = replace(P, kind="matrix", numbers=np.ravel(matrix / matrix[2, 2]))
        poses["projected"] = P.where, np.asarray(rotation), np.ravel(-rotation @ (centre[:3] / centre[3]))
    return poses
