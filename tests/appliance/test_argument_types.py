"""What a script hands to a function of `import kingfisher` by mistake is refused in one sentence; nothing is done in silence."""

from __future__ import annotations

import importlib
import inspect
import pickle
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Literal, get_type_hints

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.base.argument_types import annotation_text, fits, refuse_wrong_types, value_text
from appliance.desk.comparing import NominalSurface
from appliance.desk.object_scripting import ObjectOfDive
from appliance.desk.scripting import Dive, ScanOfDive
from appliance.desk.surface.fusion import PlacedScan
from appliance.measure.light.water import Water
from appliance.measure.overlap.rigid import Rigid
from appliance.measure.points.organised import OrganisedCloud
from appliance.store.wish import ScanOptions

PACKAGE = importlib.import_module("kingfisher")
FUNCTIONS = {name: getattr(PACKAGE, name) for name in PACKAGE.__all__ if inspect.isfunction(getattr(PACKAGE, name))}
METHODS = {
    method.__qualname__: method
    for kind in (Dive, ScanOfDive, ObjectOfDive)
    for name, method in vars(kind).items()
    if inspect.isfunction(method) and not name.startswith("_") and len(inspect.signature(method).parameters) > 1
}
POINTS = np.zeros((7, 3), np.float32)


class Wrong:
    """Nothing that any function wants."""


@pytest.mark.parametrize("name", [*FUNCTIONS, *METHODS])
def test_every_public_function_refuses_what_it_does_not_want(name: str) -> None:
    assert len(FUNCTIONS) > 15
    assert {"Dive.scan", "ScanOfDive.points", "ScanOfDive.frames", "ObjectOfDive.length"} <= METHODS.keys()
    function = FUNCTIONS.get(name) or METHODS[name]
    own = [] if name in FUNCTIONS else [Wrong()]
    parameters = [one for one in inspect.signature(function).parameters.values() if one.name != "self"]
    hints = get_type_hints(inspect.unwrap(function))
    for one in parameters:
        hint = hints[one.name]
        assert not fits(Wrong(), hint), f"{name}: nothing is seen in the annotation of {one.name}"
        assert fits("a.txt", hint) or not fits(Path("a.txt"), hint), f"{name}: {one.name} is a path, and may be a text"
    needed = {one.name: Wrong() for one in parameters if one.default is one.empty} or {parameters[0].name: Wrong()}
    first = next(iter(needed))
    with pytest.raises(TypeError) as refused:
        function(*own, **needed)
    assert str(refused.value) == f"{name}: {first} is a Wrong; wanted is {annotation_text(hints[first])}"
    with pytest.raises(TypeError, match=f"^{name}: .*; it is {name}"):
        function(*own, nonsense=1)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: PACKAGE.export(POINTS, "a.ply"), "export: what is a NumPy array of shape (7, 3); wanted is an OrganisedScan, an Organised"),
        (lambda: ScanOfDive(Path("1")).points(water=1.33), "ScanOfDive.points: water is 1.33, a float; wanted is a Water or None"),  # type: ignore[arg-type]
        (lambda: ScanOfDive(Path("1")).points(calibration=Wrong()),  # type: ignore[arg-type]
         "ScanOfDive.points: calibration is a Wrong; wanted is a Calibration, a path, a text or None"),
        (lambda: ScanOfDive(Path("1")).frames("both"), "ScanOfDive.frames: side is 'both', a str; wanted is 'left' or 'right'"),  # type: ignore[arg-type]
        (lambda: Dive(Path())[Wrong()], "Dive.scan: number is a Wrong; wanted is a whole number or a text"),  # type: ignore[arg-type]
        (lambda: PACKAGE.fuse([ScanOfDive(Path("1"))]), "fuse: scans is a list of 1 (ScanOfDive); wanted is several of a PlacedScan"),
        (lambda: PlacedScan(POINTS, np.eye(3), np.zeros(3)), "PlacedScan: cloud is a NumPy array of shape (7, 3); wanted is an OrganisedCloud"),  # type: ignore[arg-type]
        (lambda: NominalSurface("a", "a.stl"), "NominalSurface: triangles is 'a.stl', a str; wanted is a Nominal"),  # type: ignore[arg-type]
        (lambda: Water("warm", 0.0, 530.0), "Water: temperature_c is 'warm', a str; wanted is a number"),  # type: ignore[arg-type]
    ],
)  # fmt: skip
def test_what_people_try_first_is_answered_with_what_is_wanted(
    call: Callable[[], object], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(TypeError) as refused:
        call()
    assert str(refused.value).startswith(said)
    assert "\n" not in str(refused.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("wanted", "good", "bad"),
    [
        (float, (1, 1.5, np.float32(2), np.int64(3)), (True, "1", None, 1j)),
        (int, (1, np.uint8(2)), (1.0, True, "1")),
        (str | None, ("a", None), (b"a", 1)),
        (NDArray[np.float32], (POINTS,), ([1.0], None)),
        (Sequence[float], ([1, 2.0], (3.0,), POINTS[0], []), ("12", 3.0, ["a"], np.float64(1), np.array(1.0))),
        (tuple[str, ...], (("a", "b"), ()), (["a"], ("a", 1))),
        (Iterable[int], ([1], iter([1])), ("1", ["1"], 1)),
        (Callable[[str], None], (print,), ("print",)),
        (Literal["left", "right"], ("left",), ("up", 1)),
    ],
)
def test_a_value_fits_an_annotation_or_not(wanted: object, good: tuple[object, ...], bad: tuple[object, ...]) -> None:
    assert all(fits(one, wanted) for one in good)
    assert not any(fits(one, wanted) for one in bad)
    assert annotation_text(wanted)
    assert all("\n" not in value_text(one) for one in (*good, *bad))


def test_a_function_that_is_checked_stays_what_it_was() -> None:
    def double(x: float, times: int = 2) -> float:
        """Return a multiple."""
        return x * times

    checked = refuse_wrong_types(double)
    assert checked(3.0) == 6.0
    assert checked(1.5, times=4) == 6.0
    assert checked.__doc__ == "Return a multiple."
    assert inspect.signature(checked) == inspect.signature(double)
    assert repr(PACKAGE.fuse).startswith("<function fuse at ")
    assert PACKAGE.load_calibration.__module__ == "kingfisher"
    assert pickle.loads(pickle.dumps(PACKAGE.load_calibration)) is PACKAGE.load_calibration


def test_what_is_looked_at_in_a_notebook_is_one_line() -> None:
    grid = np.full((40, 50), np.nan, np.float32)
    cloud = OrganisedCloud(np.full((40, 50, 3), np.nan, np.float32), grid, grid, grid, np.zeros((40, 50), np.uint8))
    placed = PlacedScan(cloud, np.eye(3), np.zeros(3))
    scan, thing = ScanOfDive(Path("none/000007")), ObjectOfDive(Path("none"), "pipe", ScanOptions())
    for value in (cloud, placed, Rigid(np.eye(3), np.zeros(3)), scan, thing):
        assert "\n" not in repr(value)
        assert "nan" not in repr(value)
    assert repr(cloud).startswith("OrganisedCloud(points_mm=(40, 50, 3) float32, sigma_mm=(40, 50) float32")
    assert repr(scan).startswith("<scan 000007: ")
