"""Reading of foreign camera files: numbers by name, which ``camera_dialects`` interprets.

* ``camera_numbers``, ``cameras_in``, ``numbers_in``: OpenCV's YAML, XML and JSON and those of others; NumPy's .npz;
  MATLAB's .mat; one matrix a file, as .npy, .txt or .csv, with the name of the file; text of ``name = numbers``, or with
  the numbers below it.
* ``matlab_tables``: MATLAB's files, versions 4 to 7, read by scipy in a process of its own with little time and memory,
  since a damaged file may end the process that reads it. This module is that process's program, too.
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
from appliance.desk.foreign.camera_dialects import (
    CameraNumbers,
    NumbersOf,
    facts_of,
    interpret_numbers,
    refuse_other_lenses,
)
from appliance.desk.foreign.frames import array_heads, load_array
from appliance.desk.foreign.problem import ForeignError, Table
from appliance.measure import CalibrationError
from appliance.store import load_calibration

MOST_S, MOST_MEMORY_BYTES, MOST_TEXT_BYTES = 20, 1 << 30, 1 << 24
MAX_NUMBERS = 20_000
"""Arrays of more numbers are ignored: they belong to no camera."""


def matlab_tables(raw: bytes) -> dict[str, Any]:
    """Return numbers, lists of numbers and texts by name; structures are tables.

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
        raise ValueError(f"reading it takes longer than {MOST_S} s") from error
    if done.returncode:
        last = done.stderr.decode("utf-8", "replace").strip().rpartition("\n")[2]
        raise ValueError(last[-200:] or f"its reader ended by signal {-done.returncode}")
    tables: dict[str, Any] = json.loads(done.stdout)
    return tables


def _to_json(value: Any) -> Any:
    """Return a value of scipy in types of JSON, ``None`` for objects, cells and large arrays."""
    if isinstance(value, dict):
        return {str(name): _to_json(member) for name, member in value.items() if not str(name).startswith("__")}
    if isinstance(value, list):
        return _to_json(value[0]) if value else None  # of an array of structures the first
    if isinstance(value, str):
        return value
    array = np.asarray(value)
    return array.tolist() if array.dtype.kind in "fiu" and array.size <= MAX_NUMBERS else None


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
    tables = _to_json(content)
    if not any(tables.values()) and any(isinstance(value, MatlabOpaque) for value in content.values()):
        sys.exit(
            "it holds an object, which only MATLAB can read: save it as a structure, s = toStruct(stereoParams); "
            "save('stereo.mat', 's', '-v7')"
        )
    text = json.dumps(tables)
    if len(text) > MOST_TEXT_BYTES:
        sys.exit("it holds more numbers than a calibration has")
    sys.stdout.write(text)


if __name__ == "__main__":
    _main()


Array = NDArray[np.float64]

MAX_BYTES = 4_000_000
MAX_DEPTH = 12
"""Largest number of nested tables and lists."""
UP_TO_SCALE = 1e-3
"""Largest difference from 1 of the length of a translation without scale."""
METRES_BELOW = 3.0
"""Length below which a translation is in metres, unless its length is 1: then it has no scale."""
_NAMED_LINE = re.compile(r"(?P<name>[A-Za-z_][\w .-]*?)\s*[=:]\s*(?P<numbers>.*)")
_BREAKS = re.compile(r"[\[\](){},;]")


def camera_numbers(folder: Path, table: Table, of_projector: bool) -> CameraNumbers:
    """Return the numbers in ``cameras.files`` of two cameras, or of one and a projector.

    Files are relative to ``folder``. Raises ForeignError.
    """
    value = table.content["files"]
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise table.wrong("files", "the name of a file, or a list of names", "correct it")
    files = {name: numbers_in(folder / name) for name in names}
    return interpret_numbers(files, table.table("names") or Table("cameras.names.", {}), of_projector)


def cameras_in(folder: Path) -> dict[str, Any]:
    """Return the table [cameras] of a folder: our calibration, else the files with known numbers."""
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
    # Files of images and clouds state sizes, too. Without known numbers, list the files with matrices for the message.
    known_files = {fact.file for fact in facts_of(files) if fact.kind != "size" or fact.side == "projector"}
    listed = [
        name
        for name, values in files.items()
        if name in known_files or (not known_files and any(array.size == 9 for array in values.values()))
    ]
    if not listed:
        return {}
    unit = "mm"
    with suppress(ForeignError):
        T = camera_numbers(folder, Table("cameras.", {"files": listed}), of_projector=True).numbers["translation"]
        length = float(np.linalg.norm(T))
        unit = "m" if length < METRES_BELOW and not without_scale(length) else "mm"
    return {"files": listed, "unit": unit}


def without_scale(length: float) -> bool:
    """Return whether a translation is of length one, as calibrations without scale have it."""
    return abs(length - 1.0) < UP_TO_SCALE


def numbers_in(path: Path) -> dict[str, Array]:
    """Return matrices and vectors of a file by name; those in tables as TABLE.NAME. Raises ForeignError."""
    try:
        raw = read_bounded(path, MAX_BYTES)
    except OSError as error:
        raise ForeignError(f"{path}: {error.strerror or error}; give the calibration file of the cameras") from error
    format, read = FORMATS[path.suffix.lower()]
    try:
        content = dict(flatten_names(read(path, raw)))
    except (ElementTree.ParseError, yaml.YAMLError, ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ForeignError(
            f"{path}: not readable as {format} ({reason}); correct it, or write the matrices under [cameras.left] and "
            "[cameras.right]"
        ) from error
    refuse_other_lenses(str(path), content)
    return select_numbers(content)


def flatten_names(content: Any, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Yield numbers, lists and texts by name.

    A table with data and sizes, as OpenCV and ROS write a matrix, is its data.
    """
    if isinstance(content, list) and any(isinstance(element, dict) for element in content):
        content = {str(k): element for k, element in enumerate(content)}
    if not isinstance(content, dict):
        if prefix:
            yield prefix, content
    elif prefix and "data" in content and ({"rows", "cols"} <= content.keys() or "sizes" in content):
        yield prefix, content["data"]
    elif depth < MAX_DEPTH:
        for name, value in content.items():
            if not str(name).startswith("__"):
                yield from flatten_names(value, f"{prefix}.{name}" if prefix else str(name), depth + 1)


def select_numbers(content: Mapping[str, Any]) -> dict[str, Array]:
    """Return the entries that are numbers, up to ``MAX_NUMBERS`` each."""
    arrays = {}
    for name, value in content.items():
        with suppress(TypeError, ValueError, OverflowError):
            array = np.asarray(value)
            if array.dtype.kind in "fiu" and 1 <= array.size <= MAX_NUMBERS:
                arrays[name] = np.asarray(array, np.float64)
    return arrays


# ------------------------------------------------------------------------------------------------------- formats


def _numpy(path: Path, _: bytes) -> dict[str, Any]:
    """Return the arrays by name that may be a camera's; others are not even unpacked."""
    small = [name for name, head in array_heads(path).items() if head.size <= MAX_NUMBERS]
    return {name or path.stem: load_array(path, name, MAX_BYTES) for name in small}


def _lines(path: Path, raw: bytes) -> dict[str, Any]:
    """Return the numbers of ``name = numbers`` or ``name: numbers`` and of the lines below it, by name.

    Numbers before any name are a matrix with the name of the file.
    """
    numbers_by_name: dict[str, list[float]] = {}
    name = path.stem
    for line in raw.decode("utf-8-sig", "replace").splitlines():
        named = _NAMED_LINE.fullmatch(line.strip())
        name = named["name"] if named else name
        with suppress(ValueError):
            fields = _BREAKS.sub(" ", named["numbers"] if named else line.partition("#")[0]).split()
            if numbers := [float(word) for word in fields]:
                numbers_by_name.setdefault(name, []).extend(numbers)
    if not numbers_by_name:
        raise ValueError("it has neither lines NAME = NUMBERS nor a matrix")
    return numbers_by_name


def _tree(path: Path, raw: bytes) -> Any:
    """Return the content of YAML, XML or JSON."""
    # YAML allows no tabs, but editors write them.
    text = raw.decode("utf-8-sig", "replace").replace("\0", " ").expandtabs(4)
    if text.lstrip().startswith("<"):
        if "<!DOCTYPE" in text:
            raise ValueError("it has a document type definition")
        return _element(ElementTree.fromstring(text), 0)
    if path.suffix.lower() == ".json":
        content = json.loads(text, object_pairs_hook=_table)
    else:
        # OpenCV's first line, %YAML:1.0, is no YAML.
        events = yaml.parse(re.sub(r"(?m)^%.*$", "", text), Loader=yaml.CSafeLoader)
        content = [_node(event, events, 0) for event in events if isinstance(event, _BEGINS)]
    tables = [table for table in (content if isinstance(content, list) else [content]) if isinstance(table, dict)]
    if not tables:
        raise ValueError("it holds no names")
    return _table(pair for table in tables for pair in table.items())


_BEGINS = (yaml.MappingStartEvent, yaml.SequenceStartEvent, yaml.ScalarEvent, yaml.AliasEvent)


def _node(event: Any, events: Iterator[Any], depth: int) -> Any:
    """Return the value that begins with an event of YAML; tags are ignored."""
    if isinstance(event, yaml.ScalarEvent):
        return _scalar(event.value) if event.implicit[0] else event.value
    if isinstance(event, yaml.AliasEvent) or depth > MAX_DEPTH:
        raise ValueError(
            f"line {event.start_mark.line + 1}: {'an alias' if depth <= MAX_DEPTH else f'more than {MAX_DEPTH} levels'}"
        )
    items = []
    while isinstance(inner := next(events), _BEGINS):
        items.append(_node(inner, events, depth + 1))
    if isinstance(event, yaml.SequenceStartEvent):
        return items
    return _table(zip(items[::2], items[1::2], strict=True))


def _table(pairs: Iterable[tuple[Any, Any]]) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for name, value in pairs:
        if str(name) in table and table[str(name)] != value:
            raise ValueError(f"{name} has two different values")
        table[str(name)] = value
    return table


def _element(element: ElementTree.Element, depth: int) -> Any:
    """Return an element of XML as a list (of OpenCV's ``_``), a table, numbers, or a text."""
    if depth > MAX_DEPTH:
        raise ValueError(f"more than {MAX_DEPTH} levels")
    inner = [(child.tag, _element(child, depth + 1)) for child in element]
    if inner:
        return [value for _, value in inner] if len({tag for tag, _ in inner}) == 1 < len(inner) else dict(inner)
    values = [_scalar(word) for word in (element.text or "").split()]
    return element.text if any(isinstance(word, str) for word in values) else values[0] if len(values) == 1 else values


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
