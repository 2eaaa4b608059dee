"""Owns the reading of other people's camera files: whatever their format, numbers by name, which ``camera_dialects``
understands.

OpenCV's YAML, XML and JSON and those of others; NumPy's .npz; MATLAB's .mat; one matrix a file, as .npy, .txt or .csv,
which is called as the file is; text of ``name = numbers``, or with the numbers below it.

It also owns the reading of MATLAB's files, versions 4 to 7: by scipy, in a process of its own with little time and
memory.

A damaged file may end the process that reads it. This module is that process's program, too, and imports nothing of
ours.
"""

from __future__ import annotations

import io
import json
import re
import resource
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml
from numpy.typing import NDArray

from appliance.base import read_bounded
from appliance.desk.foreign.camera_dialects import CameraNumbers, NumbersOf, facts_of, refuse_other_lenses, understood
from appliance.desk.foreign.frames import array_heads, load_array
from appliance.desk.foreign.problem import ForeignError, Table
from appliance.measure import CalibrationError
from appliance.store import load_calibration

MOST_S, MOST_MEMORY_BYTES, MOST_TEXT_BYTES = 20, 1 << 30, 1 << 24
MOST_NUMBERS = 20_000
"""Arrays of more numbers are left out: they are no camera's."""


def matlab_tables(raw: bytes) -> dict[str, Any]:
    """Return numbers, lists of them and texts by name; structures are tables.

    Raises ValueError for bytes that are no MATLAB file of version 4 to 7, or are damaged.
    """
    try:
        done = subprocess.run(
            [sys.executable, "-I", __file__],
            input=raw,
            capture_output=True,
            timeout=MOST_S,
            env={"OPENBLAS_NUM_THREADS": "1"},
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise ValueError(f"reading takes longer than {MOST_S} s") from error
    if done.returncode:
        last = done.stderr.decode("utf-8", "replace").strip().rpartition("\n")[2]
        raise ValueError(last[-200:] or f"it ends its reader by signal {-done.returncode}")
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def _plain(value: Any) -> Any:
    """Return what JSON can hold of what scipy makes: ``None`` for objects, cells and whatever is large."""
    if isinstance(value, dict):
        return {str(name): _plain(one) for name, one in value.items() if not str(name).startswith("__")}
    if isinstance(value, list):
        return _plain(value[0]) if value else None  # of an array of structures the first
    if isinstance(value, str):
        return value
    array = np.asarray(value)
    return array.tolist() if array.dtype.kind in "fiu" and array.size <= MOST_NUMBERS else None


def _main() -> None:
    # A few bytes of a compressed array may state any size.
    resource.setrlimit(resource.RLIMIT_CPU, (MOST_S, MOST_S))
    resource.setrlimit(resource.RLIMIT_DATA, (MOST_MEMORY_BYTES, MOST_MEMORY_BYTES))
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabOpaque

    try:
        content = loadmat(io.BytesIO(sys.stdin.buffer.read()), simplify_cells=True)
    except NotImplementedError:
        sys.exit("version 7.3 is another format: save it with -v7")
    found = _plain(content)
    if not any(found.values()) and any(isinstance(one, MatlabOpaque) for one in content.values()):
        sys.exit(
            "it holds an object, which only MATLAB reads: save it as a structure, s = toStruct(stereoParams); "
            "save('stereo.mat', 's', '-v7')"
        )
    text = json.dumps(found)
    if len(text) > MOST_TEXT_BYTES:
        sys.exit("it holds more numbers than cameras have")
    sys.stdout.write(text)


if __name__ == "__main__":
    _main()


Array = NDArray[np.float64]

MAX_BYTES = 4_000_000
MOST_DEEP = 12
"""Most levels of tables and lists in one another."""
UP_TO_SCALE = 1e-3
"""Largest difference from 1 of a translation that has no scale."""
METRES_BELOW = 3.0
"""A translation shorter than this is in metres, unless it is 1: then it has no scale."""
_NAMED_LINE = re.compile(r"(?P<name>[A-Za-z_][\w .-]*?)\s*[=:]\s*(?P<numbers>.*)")
_BREAKS = re.compile(r"[\[\](){},;]")


def camera_numbers(folder: Path, table: Table, of_projector: bool) -> CameraNumbers:
    """Return what ``cameras.files``, relative to ``folder``, say of two cameras, or of one and a projector.

    Raises ForeignError.
    """
    value = table.content["files"]
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise table.wrong("files", "the name of a file, or a list of names", "correct it")
    files = {name: numbers_in(folder / name) for name in names}
    return understood(files, table.table("names") or Table("cameras.names.", {}), of_projector)


def cameras_in(folder: Path) -> dict[str, Any]:
    """Return what a folder has about cameras, as [cameras] would say it: a calibration of ours, else files of which
    something is known."""
    files: dict[str, NumbersOf] = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() in FORMATS and path.is_file():
            name = str(path.relative_to(folder))
            with suppress(CalibrationError):
                if path.suffix == ".json":
                    load_calibration(path)
                    return {"calibration": name}
            with suppress(ForeignError):
                files[name] = numbers_in(path)
    # Pictures' and clouds' files state sizes, too; where nothing is known, the message lists what has matrices.
    known = {fact.file for fact in facts_of(files) if fact.kind != "size" or fact.side == "projector"}
    listed = [
        name
        for name, values in files.items()
        if name in known or (not known and any(one.size == 9 for one in values.values()))
    ]
    if not listed:
        return {}
    unit = "mm"
    with suppress(ForeignError):
        T = camera_numbers(folder, Table("cameras.", {"files": listed}), of_projector=True).found["translation"]
        length = float(np.linalg.norm(T))
        unit = "m" if length < METRES_BELOW and not without_scale(length) else "mm"
    return {"files": listed, "unit": unit}


def without_scale(length: float) -> bool:
    """Tell whether a translation is that of a calibration without scale: of length one in whatever unit."""
    return abs(length - 1.0) < UP_TO_SCALE


def numbers_in(path: Path) -> dict[str, Array]:
    """Return the matrices and vectors of a file by name; those in tables as TABLE.NAME. Raises ForeignError."""
    try:
        raw = read_bounded(path, MAX_BYTES)
    except OSError as error:
        raise ForeignError(f"{path}: {error.strerror or error}; give the file of the cameras' numbers") from error
    format, read = FORMATS[path.suffix.lower()]
    try:
        content = dict(flat(read(path, raw)))
    except (ElementTree.ParseError, yaml.YAMLError, ValueError, RecursionError) as error:
        said = " ".join(str(error).split())[:200]
        raise ForeignError(
            f"{path}: not readable as {format} ({said}); correct it, or write the matrices under [cameras.left] and "
            "[cameras.right]"
        ) from error
    refuse_other_lenses(str(path), content)
    return numeric(content)


def flat(content: Any, before: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Yield numbers, lists and texts by name; a matrix as OpenCV and ROS write it, a table with its sizes, is its data."""
    if isinstance(content, list) and any(isinstance(one, dict) for one in content):
        content = {str(k): one for k, one in enumerate(content)}
    if not isinstance(content, dict):
        if before:
            yield before, content
    elif before and "data" in content and ({"rows", "cols"} <= content.keys() or "sizes" in content):
        yield before, content["data"]
    elif depth < MOST_DEEP:
        for name, value in content.items():
            if not str(name).startswith("__"):
                yield from flat(value, f"{before}.{name}" if before else str(name), depth + 1)


def numeric(content: Mapping[str, Any]) -> dict[str, Array]:
    """Return what is numbers, and not too many of them."""
    found = {}
    for name, value in content.items():
        with suppress(TypeError, ValueError, OverflowError):
            array = np.asarray(value)
            if array.dtype.kind in "fiu" and 1 <= array.size <= MOST_NUMBERS:
                found[name] = np.asarray(array, np.float64)
    return found


# ------------------------------------------------------------------------------------------------------- formats


def _numpy(path: Path, _: bytes) -> dict[str, Any]:
    """Return the arrays that may be a camera's by name; others are not even unpacked."""
    few = [name for name, head in array_heads(path).items() if head.size <= MOST_NUMBERS]
    return {name or path.stem: load_array(path, name, MAX_BYTES) for name in few}


def _lines(path: Path, raw: bytes) -> dict[str, Any]:
    """Return ``name = numbers`` or ``name: numbers`` of each line, and of lines below it; before any name, a matrix
    called as the file is."""
    found: dict[str, list[float]] = {}
    name = path.stem
    for line in raw.decode("utf-8-sig", "replace").splitlines():
        named = _NAMED_LINE.fullmatch(line.strip())
        name = named["name"] if named else name
        with suppress(ValueError):
            words = _BREAKS.sub(" ", named["numbers"] if named else line.partition("#")[0]).split()
            if numbers := [float(word) for word in words]:
                found.setdefault(name, []).extend(numbers)
    if not found:
        raise ValueError("no line is NAME = NUMBERS, and it is no matrix")
    return found


def _tree(path: Path, raw: bytes) -> Any:
    """Return what YAML, XML or JSON holds, whatever of them it is called."""
    # YAML allows no tabs; people's editors do not know that.
    text = raw.decode("utf-8-sig", "replace").replace("\0", " ").expandtabs(4)
    if text.lstrip().startswith("<"):
        if "<!DOCTYPE" in text:
            raise ValueError("it defines what it consists of")
        return _element(ElementTree.fromstring(text), 0)
    if path.suffix.lower() == ".json":
        content = json.loads(text, object_pairs_hook=_table)
    else:
        # OpenCV's first line, %YAML:1.0, is none of YAML.
        events = yaml.parse(re.sub(r"(?m)^%.*$", "", text), Loader=yaml.CSafeLoader)
        content = [_node(event, events, 0) for event in events if isinstance(event, _BEGINS)]
    tables = [one for one in (content if isinstance(content, list) else [content]) if isinstance(one, dict)]
    if not tables:
        raise ValueError("it holds no names")
    return _table(pair for one in tables for pair in one.items())


_BEGINS = (yaml.MappingStartEvent, yaml.SequenceStartEvent, yaml.ScalarEvent, yaml.AliasEvent)


def _node(event: Any, events: Iterator[Any], depth: int) -> Any:
    """Return what begins with an event of YAML; tags are passed over."""
    if isinstance(event, yaml.ScalarEvent):
        return _scalar(event.value) if event.implicit[0] else event.value
    if isinstance(event, yaml.AliasEvent) or depth > MOST_DEEP:
        raise ValueError(
            f"line {event.start_mark.line + 1}: {'an alias' if depth <= MOST_DEEP else f'more than {MOST_DEEP} levels'}"
        )
    items = []
    while isinstance(one := next(events), _BEGINS):
        items.append(_node(one, events, depth + 1))
    if isinstance(event, yaml.SequenceStartEvent):
        return items
    return _table(zip(items[::2], items[1::2], strict=True))


def _table(pairs: Iterable[tuple[Any, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in pairs:
        if str(name) in found and found[str(name)] != value:
            raise ValueError(f"{name} stands there twice, and differs")
        found[str(name)] = value
    return found


def _element(element: ElementTree.Element, depth: int) -> Any:
    """Return an element of XML: a list of OpenCV's ``_``, a table, numbers, or a text."""
    if depth > MOST_DEEP:
        raise ValueError(f"more than {MOST_DEEP} levels")
    inner = [(one.tag, _element(one, depth + 1)) for one in element]
    if inner:
        return [value for _, value in inner] if len({tag for tag, _ in inner}) == 1 < len(inner) else dict(inner)
    words = [_scalar(word) for word in (element.text or "").split()]
    return element.text if any(isinstance(word, str) for word in words) else words[0] if len(words) == 1 else words


def _scalar(text: str) -> float | str:
    try:
        return float(re.sub(r"(?i)\.(?=nan|inf)", "", text))
    except ValueError:
        return text


FORMATS: Mapping[str, tuple[str, Callable[[Path, bytes], Any]]] = {
    **dict.fromkeys((".npz", ".npy"), ("NumPy's file", _numpy)),
    ".mat": ("MATLAB's .mat", lambda _, raw: matlab_tables(raw)),
    **dict.fromkeys((".txt", ".csv"), ("text", _lines)),
    ".json": ("JSON", _tree),
    **dict.fromkeys((".yml", ".yaml", ".xml"), ("YAML or XML", _tree)),
}
