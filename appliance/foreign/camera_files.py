"""Owns the numbers in other people's camera files: what they are called there, and how they are read.

OpenCV's YAML, XML and JSON; YAML and JSON of other programs with plain lists; NumPy's .npz; MATLAB's .mat; one matrix a file, as .npy,
.txt or .csv, which is called as the file is; text of ``name = numbers``. Two cameras are ``1`` and ``2``, left and right, camera and projector, or counted from 0. In place of R and T each camera may have its own rotation and
translation (a point of the world into the camera: x = R X + T), or a projection matrix of 3 x 4, or the rectification that brings
both to one plane. Other programs' ways are ``camera_dialects``'s.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.bounded_file import read_bounded
from appliance.foreign.arrays import ArrayError, array_heads, load_array
from appliance.foreign.camera_dialects import in_opencvs_names
from appliance.foreign.matlab import MatlabError, matlab_arrays
from appliance.foreign.plain_yaml import YamlError, parse_yaml
from appliance.foreign.problem import ForeignError, Table

Array = NDArray[np.float64]

SUFFIXES = (".yml", ".yaml", ".xml", ".json", ".npz", ".mat", ".npy", ".txt", ".csv")
MAX_BYTES = 4_000_000
MOST_DEEP = 8
"""Most levels of tables in one another."""
MOST_NUMBERS = 20_000
"""More of them are no camera's."""
MOST = 1e9
"""Numbers of cameras are smaller than this."""
LEAST_LISTED = 3
"""Fewer numbers under a name are not worth a mention: neither matrix nor vector."""
_MATRIX = (
    "m", "k", "kk", "cameramatrix", "camera", "cameraint", "intrinsic", "intrinsics", "intrinsicmatrix", "cammatrix", "mtx", "matrix",
    "int", "cam", "kmatrix",
)  # fmt: skip
_DISTORTION = (
    "d", "distcoeffs", "distcoeff", "distcoef", "distortion", "distorsion", "distortioncoefficients", "distortioncoeffs", "dist", "kc",
    "distortions",
)  # fmt: skip
_ROTATION = ("r", "rotation", "rotationmatrix", "rot", "rmatrix", "rvec")
_TRANSLATION = ("t", "translation", "translationvector", "trans", "tvec", "tvector")
_PROJECTION = ("p", "projection", "projectionmatrix", "projmatrix")
_KINDS: Mapping[str, tuple[str, ...]] = {
    "matrix": _MATRIX, "distortion": _DISTORTION, "rotation": _ROTATION, "translation": _TRANSLATION, "projection": _PROJECTION,
}  # fmt: skip
_WAYS: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = (
    (("1", "l", "left", "cam1", "camera1"), ("2", "r", "right", "cam2", "camera2")),
    (("cam", "camera"), ("proj", "projector", "prj")),
    (("0", "cam0", "camera0"), ("1", "cam1", "camera1")),
)
"""Words for both cameras; one way holds for a whole file."""
_BETWEEN: Mapping[str, tuple[str, ...]] = {
    "rotation": (*_ROTATION, "rlr", "stereor", "rstereo", "r12", "om"),
    "translation": (*_TRANSLATION, "tlr", "stereot", "tstereo", "t12"),
}
_ONE: Mapping[str, tuple[str, ...]] = {
    "matrix": ("cameramatrix", "k", "m", "kk", "intrinsic", "intrinsics", "intrinsicmatrix", "mtx"),
    "distortion": ("distortioncoefficients", "distcoeffs", "distcoeff", "distortion", "d", "dist", "kc"),
    "rotation": _ROTATION, "translation": _TRANSLATION, "projection": _PROJECTION,
    "rectification": ("rectificationmatrix", "rectification", "rrect"),
}  # fmt: skip
"""Names in a file of one camera alone."""
_FILES_OF: Mapping[str, re.Pattern[str]] = {
    "left": re.compile(r"left|(^|[^a-z])(l|cam(era)?[_-]?0)([^a-z0-9]|$)", re.IGNORECASE),
    "right": re.compile(r"right|proj|(^|[^a-z])(r|cam(era)?[_-]?[12])([^a-z0-9]|$)", re.IGNORECASE),
}
"""Words in the name of a file of one camera, or in that of its folder."""
WANTED = ("left_matrix", "right_matrix", "left_distortion", "right_distortion", "rotation", "translation")
_NAMED_LINE = re.compile(r"(?P<name>[A-Za-z_][\w.-]*)\s*[=:]\s*(?P<numbers>.*)")
_NUMBER_BREAKS = re.compile(r"[\[\](){},;]")
_SHAPES: Mapping[str, tuple[int, ...]] = {
    "matrix": (9,), "rotation": (9, 3), "translation": (3,), "projection": (12,), "rectification": (9,),
    "distortion": (3, 4, 5, 6, 8, 12, 14),
}  # fmt: skip
"""Numbers that each of them may have; something else under its name is something else."""


def numbers_from_files(folder: Path, table: Table) -> dict[str, Any]:
    """Return what ``cameras.files``, relative to ``folder``, say, keyed as in ``WANTED``. Raises ForeignError, which lists what the files have."""
    value = table.content["files"]
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise table.wrong("files", "the name of a file, or a list of names", "correct it")
    aliases = table.table("names") or Table("cameras.names.", {})
    aliases.only(*WANTED)
    found: dict[str, Any] = {}
    seen: dict[str, list[str]] = {}
    for name in names:
        path = folder / name
        values = numbers_in(path)
        seen[name] = [key for key, numbers in values.items() if numbers.size >= LEAST_LISTED]
        for wanted in WANTED:
            if wanted in aliases.content and aliases.text(wanted) in values:
                found[wanted] = values[aliases.text(wanted)]
        plain = {re.sub(r"[^a-z0-9]", "", key.lower()): value for key, value in values.items()}
        for key, numbers in _known(plain).items():
            if key not in aliases.content:
                found.setdefault(key, numbers)
        _one_camera(name, plain, found)
    for key, numbers in found.items():
        if not np.all(np.abs(np.asarray(numbers)) < MOST):
            raise ForeignError(
                f"cameras.files: {key.replace('_', ' ')} is {np.ravel(numbers).tolist()!r:.80}; allowed are finite numbers below {MOST:g}; correct it"
            )
    _from_rectified(found)
    _from_projections(found)
    _from_poses(found)
    missing = [name for name in WANTED if name not in found and not name.endswith("distortion")]
    if missing:
        there = "; ".join(f"{name}: {', '.join(keys[:20])[:400] or 'no matrices'}" for name, keys in seen.items())
        raise ForeignError(
            f"cameras.files have no {', '.join(missing)} under a name that is known ({there}); say which is which under [cameras.names], "
            f'for example {missing[0]} = "NAME"'
        )
    for side in ("left", "right"):
        found.setdefault(f"{side}_distortion", [])
    return {name: found[name] for name in WANTED}


def _named(plain: Mapping[str, Array], names: Iterator[str] | tuple[str, ...], kind: str) -> Array | None:
    return next(
        (plain[one] for one in names if one in plain and plain[one].size in _SHAPES.get(kind, (plain[one].size,))), None
    )


def _known(plain: Mapping[str, Array]) -> dict[str, Array]:
    """Return what is found under known names, by the way of naming that knows most."""
    best: dict[str, Array] = {}
    for way in _WAYS:
        found: dict[str, Array] = {}
        for side, words in zip(("left", "right"), way, strict=True):
            for kind, kinds in _KINDS.items():
                # A word for the camera before or behind that of the quantity: cam1_intrinsics, M1, kc_left.
                names = (name for what in kinds for word in words for name in (f"{what}{word}", f"{word}{what}"))
                numbers = _named(plain, names, kind)
                if numbers is not None:
                    found[f"{side}_{kind}"] = numbers
        both = {key: numbers for key, numbers in found.items() if _other(key) in found} or (
            found if way is _WAYS[0] else {}
        )
        if len(both) > len(best):
            best = found
    for kind, names_between in _BETWEEN.items():
        numbers = _named(plain, names_between, kind)
        if numbers is not None:
            best[kind] = numbers
    return best


def _other(key: str) -> str:
    side, _, kind = key.partition("_")
    return f"{'right' if side == 'left' else 'left'}_{kind}"


def _one_camera(name: str, plain: Mapping[str, Array], found: dict[str, Any]) -> None:
    """Add what a file of one camera says; its name says which camera it is, or the order of the files does."""
    mine = {}
    for kind, names in _ONE.items():
        numbers = _named(plain, tuple(f"{before}{one}" for before in ("", "camera") for one in names), kind)
        if numbers is not None and not any(numbers is one for one in found.values()):
            mine[kind] = numbers
    if "matrix" not in mine:
        return
    sides = [side for side, words in _FILES_OF.items() if words.search(name)]
    side = sides[0] if sides else "left" if "left_matrix" not in found else "right"
    for kind, numbers in mine.items():
        found.setdefault(f"{side}_{kind}", numbers)


def _from_rectified(found: dict[str, Any]) -> None:
    """Make R and T of what brings both cameras to one plane: rotations R1 and R2, and P = K' (I | t) of each, t along the baseline.

    x' = R1 x_left, and x' + t2 − t1 = R2 x_right: R = R2ᵀ R1, T = R2ᵀ (t2 − t1). ROS writes cameras so, OpenCV's ``stereoRectify``, too.
    """
    for side in ("left", "right"):
        if "rotation" in found or f"{side}_projection" not in found:
            return
        if f"{side}_rectification" not in found and f"{side}_rotation" in found and f"{side}_translation" not in found:
            found[f"{side}_rectification"] = found.pop(f"{side}_rotation")
    if not {"left_rectification", "right_rectification"} <= set(found):
        return
    first, second = (np.asarray(found[f"{side}_rectification"], np.float64).reshape(3, 3) for side in ("left", "right"))
    shifts = []
    for side in ("left", "right"):
        projection = np.asarray(found[f"{side}_projection"], np.float64).reshape(3, 4)
        if abs(np.linalg.det(projection[:, :3])) < 1e-9:
            return
        shifts.append(np.linalg.solve(projection[:, :3], projection[:, 3]))
    found["rotation"], found["translation"] = second.T @ first, second.T @ (shifts[1] - shifts[0])


def _from_projections(found: dict[str, Any]) -> None:
    """Take projection matrices apart where there are no camera matrices: P = K (R | t)."""
    if "left_matrix" in found or "right_matrix" in found or not {"left_projection", "right_projection"} <= set(found):
        return
    for side in ("left", "right"):
        projection = np.asarray(found[f"{side}_projection"], np.float64).reshape(3, 4)
        # Any multiple of it is the same camera; with a negative one the focal lengths would be so.
        projection = projection if np.linalg.det(projection[:, :3]) > 0.0 else -projection
        matrix, rotation, centre = cv2.decomposeProjectionMatrix(projection)[:3]
        if abs(float(matrix[2, 2])) < 1e-12 or abs(float(centre[3, 0])) < 1e-12:
            return
        found[f"{side}_matrix"] = np.asarray(matrix / matrix[2, 2], np.float64)
        found[f"{side}_rotation"] = np.asarray(rotation, np.float64)
        found[f"{side}_translation"] = np.asarray(-rotation @ (centre[:3] / centre[3]), np.float64)


def _from_poses(found: dict[str, Any]) -> None:
    """Make R and T of each camera's own: R = R2 R1ᵀ, T = T2 − R T1."""
    keys = [f"{side}_{kind}" for side in ("left", "right") for kind in ("rotation", "translation")]
    if "rotation" in found or "translation" in found or not set(keys) <= set(found):
        return
    first, from_first, second, from_second = (np.asarray(found[key], np.float64) for key in keys)
    one, other = (
        np.asarray(cv2.Rodrigues(turn.reshape(3, 1))[0]) if turn.size == 3 else turn.reshape(3, 3)
        for turn in (first, second)
    )
    found["rotation"] = other @ one.T
    found["translation"] = from_second.ravel() - found["rotation"] @ from_first.ravel()


# --------------------------------------------------------------------------------------------------------- files


def numbers_in(path: Path) -> dict[str, Array]:
    """Return the matrices and vectors of a file by name; those in tables as TABLE.NAME. Raises ForeignError."""
    try:
        raw = read_bounded(path, MAX_BYTES)
    except FileNotFoundError as error:
        raise ForeignError(f"cameras.files: there is no file {path}; correct the name") from error
    except OSError as error:
        raise ForeignError(f"{path}: {error.strerror or error}; give the file of the cameras' numbers") from error
    content: Mapping[str, Any]
    match path.suffix.lower():
        case ".npz" | ".npy":
            content = _numpy(path)
        case ".mat":
            content = _mat(path, raw)
        case ".json":
            content = _json(path, raw)
        case ".txt" | ".csv":
            content = _text(path, raw)
        case _:
            content = _opencv(path, raw)
    words = {name: value for name, value in content.items() if isinstance(value, str)}
    return in_opencvs_names(str(path), _numeric(content), words)


def _numpy(path: Path) -> dict[str, Any]:
    """Return the arrays that may be a camera's by name; others are not even unpacked."""
    try:
        heads = array_heads(path)
        few = [name for name, head in heads.items() if head.size <= MOST_NUMBERS]
        return {name or path.stem: load_array(path, name, MAX_BYTES) for name in few}
    except ArrayError as error:
        raise ForeignError(f"{path}: {error}; give OpenCV's YAML") from error


def _text(path: Path, raw: bytes) -> dict[str, Any]:
    """Return ``name = numbers`` or ``name: numbers`` of each line; of numbers alone one matrix, which is called as the file is."""
    found: dict[str, Any] = {}
    rows: list[list[float]] = []
    for line in raw.decode("utf-8-sig", "replace").splitlines():
        named = _NAMED_LINE.fullmatch(line.strip())
        words = _NUMBER_BREAKS.sub(" ", named["numbers"] if named else line.partition("#")[0]).split()
        try:
            numbers = [float(word) for word in words]
        except ValueError:
            continue
        if named and numbers:
            found[named["name"]] = numbers
        elif numbers:
            rows.append(numbers)
    if rows and len({len(row) for row in rows}) == 1:
        found.setdefault(path.stem, rows)
    if not found:
        raise ForeignError(
            f"{path}: no line is NAME = NUMBERS, and it is no matrix; give OpenCV's YAML, or write the matrices under [cameras.left] and "
            "[cameras.right]"
        )
    return found


def _mat(path: Path, raw: bytes) -> dict[str, Any]:
    try:
        return dict(matlab_arrays(raw))
    except MatlabError as error:
        raise ForeignError(f"{path}: not readable as MATLAB's .mat: {error}; or give OpenCV's YAML") from error


def _json(path: Path, raw: bytes) -> dict[str, Any]:
    try:
        content = json.loads(raw.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise ForeignError(f"{path}: not readable as JSON ({str(error)[:120]}); correct it") from error
    if not isinstance(content, dict):
        raise ForeignError(f"{path}: holds no names; give an object with the matrices")
    return dict(_flat(content, "", 0))


def _flat(content: Mapping[str, Any], before: str, depth: int) -> Iterator[tuple[str, Any]]:
    for key, value in content.items():
        name = f"{before}{key}"
        if isinstance(value, Mapping):
            if _is_matrix(value):
                yield name, value["data"]
            elif depth < MOST_DEEP:
                yield from _flat(value, f"{name}.", depth + 1)
        elif not str(key).startswith("__"):
            yield name, value


def _is_matrix(keys: Collection[str]) -> bool:
    """Tell whether a table is a matrix as OpenCV and ROS write it, or one of another number of dimensions, which has sizes."""
    return "data" in keys and ({"rows", "cols"} <= set(keys) or "sizes" in keys)


def _numeric(content: Mapping[str, Any]) -> dict[str, Array]:
    found = {}
    for name, value in content.items():
        if not name:
            continue
        try:
            array = np.asarray(value)
            if array.dtype.kind in "fiu" and 1 <= array.size <= MOST_NUMBERS:
                found[name] = np.asarray(array, np.float64)
        except (TypeError, ValueError, OverflowError):
            continue
    return found


def _opencv(path: Path, raw: bytes) -> dict[str, Any]:
    plain = text = raw.decode("utf-8-sig", "replace").replace("\0", " ")
    if path.suffix.lower() in (".yml", ".yaml") and not text.lstrip().startswith("%YAML"):
        # Other programs' YAML lacks OpenCV's first line.
        text = f"%YAML:1.0\n---\n{text.lstrip().removeprefix('---')}"
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        opened = storage.isOpened()
    except (cv2.error, SystemError) as error:
        if path.suffix.lower() != ".xml":
            return _yaml(path, plain)
        raise ForeignError(
            f"{path}: not readable as OpenCV's YAML or XML ({str(error).strip()[-120:]}); correct it"
        ) from error
    if not opened:
        raise ForeignError(f"{path}: not readable as OpenCV's YAML or XML; or give the matrices in the description")
    found: dict[str, Any] = {}
    try:
        _collect(storage.root(), found, "", 0)
    except (cv2.error, SystemError) as error:
        raise ForeignError(f"{path}: a matrix in it is damaged ({str(error).strip()[-120:]}); correct it") from error
    finally:
        storage.release()
    return found


def _yaml(path: Path, text: str) -> dict[str, Any]:
    """Return what YAML holds that OpenCV does not read."""
    try:
        content = parse_yaml(text)
    except (YamlError, RecursionError) as error:
        raise ForeignError(f"{path}: not readable as OpenCV's YAML, nor as plain YAML ({error}); correct it") from error
    if not isinstance(content, dict):
        raise ForeignError(
            f"{path}: not readable as OpenCV's YAML: it holds no names; or give the matrices in the description"
        )
    return dict(_flat(content, "", 0))


def _collect(node: Any, found: dict[str, Any], before: str, depth: int) -> None:
    for key in node.keys():  # noqa: SIM118 (no dictionary)
        child = node.getNode(key)
        name = f"{before}{key}"
        if child.isMap():
            # A matrix is read as what it is written as: OpenCV's own reading of a damaged one ends the process.
            if _is_matrix(child.keys()):
                found[name] = _listed(child.getNode("data"), 0)
            elif depth < MOST_DEEP:
                _collect(child, found, f"{name}.", depth + 1)
        elif child.isSeq():
            found[name] = _listed(child, 0)
        elif child.isString():
            found[name] = child.string()
        elif child.isReal() or child.isInt():
            found[name] = child.real()


def _listed(node: Any, depth: int) -> Any:
    """Return a list of numbers, or of lists of them; ``None`` for anything else."""
    if node.isReal() or node.isInt():
        return node.real()
    if not node.isSeq() or depth > MOST_DEEP:
        return None
    return [_listed(node.at(k), depth + 1) for k in range(node.size())]
