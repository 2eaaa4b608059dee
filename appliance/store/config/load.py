"""Owns the way from a rig file's text to a ``Rig``, and the words in which a wrong file is refused."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from importlib import resources
from pathlib import Path
from typing import Any, get_type_hints

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from appliance.base import parse_toml, read_text
from appliance.store.config.checks import Complaint, complaints
from appliance.store.config.rig import Rig

_MAX_BYTES = 1_000_000
_MOST_FAULTS = 100
"""Number of wrong keys that a rig file may have: beyond this the file is something else, and the rest is counted."""


class ConfigError(Exception):
    """The rig file cannot be used. ``headline`` fits a safe screen; ``str()`` adds allowed range and remedy, and names
    the ``others``, further faults of the file; ``uncounted`` is how many there are beyond those.
    """

    def __init__(
        self,
        headline: str,
        allowed: str,
        remedy: str,
        *,
        key: str | None = None,
        others: Sequence[ConfigError] = (),
        uncounted: int = 0,
    ) -> None:
        self.headline = headline
        self.key = key
        """Path of the key (``camera.left.exposure_ms``); ``None`` when the file as a whole is wrong."""
        self.allowed = allowed
        self.remedy = remedy
        parts = [f"CONFIG: {headline}"]
        if allowed:
            parts.append(f"allowed: {allowed}")
        parts.append(remedy)
        if others:
            named = [other.headline + (f" (allowed: {other.allowed})" if other.allowed else "") for other in others]
            more = [f"and {uncounted} more"] if uncounted else []
            parts.append("also wrong: " + ", ".join(named + more))
        super().__init__("; ".join(parts))


def default_rig_path() -> Path:
    """Return the rig file that is packaged with the product."""
    return Path(str(resources.files("appliance").joinpath("store", "rigs", "kingfisher.toml")))


def load_rig(path: Path | str | None = None) -> Rig:
    """Read and check a rig file, by default the packaged one.

    Raises ConfigError, never anything else, for whatever the file holds.
    """
    path = Path(path or default_rig_path())
    try:
        text = read_text(path, _MAX_BYTES)
    except OSError as error:
        raise ConfigError(
            f"{path}: {error.strerror or error}", "a readable rig file", "give another one with --rig PATH"
        ) from error
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{path}: byte {error.start} is not UTF-8", "a text file in UTF-8", "restore the file from its copy"
        ) from error
    return parse_rig(text, str(path))


def parse_rig(text: str, source: str = "rig file") -> Rig:
    """Read a rig from text like ``load_rig``; ``source`` names it in messages."""
    try:
        content = parse_toml(text)
    except ValueError as error:
        raise ConfigError(f"{source}: {error}", "TOML 1.0", "correct that line") from error
    return rig_from_mapping(content, source)


def rig_from_mapping(content: Mapping[str, Any], source: str = "rig") -> Rig:
    """Check a parsed rig file. Raises ConfigError that explains the first wrong key and names all others."""
    try:
        # Through JSON: dates and other TOML oddities become text, and the value shares nothing with its source.
        plain = json.loads(json.dumps(content, default=str))
        # pydantic judges each key by itself; what keys mean for each other is asked by `complaints` once all are sound.
        rig = TypeAdapter(Rig).validate_python(plain)
    except ValidationError as error:
        # A misspelt key first: what is missing because of it would only hide the cause.
        details = sorted(error.errors(include_url=False), key=lambda d: not _is_unknown_key(d))
        named = [_explain(detail, source) for detail in details[1 : 1 + _MOST_FAULTS]]
        raise _explain(details[0], source, named, max(0, len(details) - 1 - _MOST_FAULTS)) from None
    broken = list(complaints(rig))
    if broken:
        raise _complain(broken[0], source, [_complain(complaint, source) for complaint in broken[1:]])
    return rig


def _complain(broken: Complaint, source: str, others: Sequence[ConfigError] = ()) -> ConfigError:
    value = "" if broken.value is None else f" {_spell(broken.value)}"
    return ConfigError(
        f"{broken.key}{value} {broken.relation}",
        broken.allowed,
        f"{broken.remedy} ({source})",
        key=broken.key,
        others=others,
    )


def _is_unknown_key(detail: ErrorDetails) -> bool:
    return detail["type"] in ("unexpected_keyword_argument", "extra_forbidden")


def _explain(detail: ErrorDetails, source: str, others: Sequence[ConfigError] = (), uncounted: int = 0) -> ConfigError:
    """Return the words for one fault that pydantic found; ``others`` and ``uncounted`` as in ``ConfigError``."""

    def wrong(headline: str, allowed: str, remedy: str) -> ConfigError:
        return ConfigError(headline, allowed, remedy, key=key, others=others, uncounted=uncounted)

    key = ".".join(_short(str(part)) for part in detail["loc"])
    value = _spell(detail["input"])
    context = detail.get("ctx", {})
    lower, upper = _range_of(detail["loc"])
    allowed = f"{lower:g}..{upper:g} {_unit(key)}".rstrip() if lower is not None and upper is not None else ""
    remedy = f"correct it in {source}"
    kind = detail["type"]
    if _is_unknown_key(detail):
        # The range of an unknown key is not known either: a name that is, is the only help.
        near = _nearest(detail["loc"])
        hint = f"did you mean {near}?" if near else f"known here: {', '.join(_siblings(detail['loc']))}"
        return wrong(f"{key} unknown key", "", f"{hint} ({source})")
    if kind in ("missing", "missing_argument"):
        return wrong(f"{key} missing", allowed, f"add it to {source}")
    if kind in ("less_than_equal", "greater_than_equal"):
        sign, limit = (">", context["le"]) if kind == "less_than_equal" else ("<", context["ge"])
        return wrong(f"{key} {value} {sign} {limit:g}", allowed, remedy)
    if kind == "literal_error":
        return wrong(f"{key} {value}", str(context["expected"]), remedy)
    if kind == "string_pattern_mismatch":
        return wrong(f"{key} {value}", '"package.module:function"', remedy)
    wanted = detail["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    return wrong(f"{key} {value} is not {wanted.removesuffix(' is needed')}", allowed, remedy)


def _spell(value: object) -> str:
    return _short(json.dumps(value, default=str) if not isinstance(value, float) else f"{value:g}")


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."


_UNITS = {
    "_mm": "mm", "_um": "µm", "_px": "px", "_ms": "ms", "_us": "µs", "_hz": "Hz", "_deg": "°", "_c": "°C",
    "_nm": "nm", "_psu": "psu", "_db": "dB", "_v": "V", "_mb": "MB", "_vsyncs": "vsyncs",
}  # fmt: skip


def _unit(key: str) -> str:
    return next((unit for ending, unit in _UNITS.items() if key.endswith(ending)), "")


# ------------------------------------------------------------------------- what the dataclasses know


def _tables(kind: Any = Rig, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every key of the vocabulary with its annotated type: ``camera.left.exposure_ms``."""
    hints = get_type_hints(kind, include_extras=True)
    for one in fields(kind):
        path = f"{prefix}{one.name}"
        yield path, hints[one.name]
        if is_dataclass(hints[one.name]):
            yield from _tables(hints[one.name], path + ".")


def _siblings(loc: Sequence[int | str]) -> list[str]:
    prefix = "".join(f"{part}." for part in loc[:-1])
    return [path[len(prefix) :] for path, _ in _tables() if path.startswith(prefix) and "." not in path[len(prefix) :]]


def _nearest(loc: Sequence[int | str]) -> str | None:
    """Return the known key that was probably meant: of the same table, else of the same name elsewhere."""
    prefix = "".join(f"{part}." for part in loc[:-1])
    name = str(loc[-1])
    near = difflib.get_close_matches(name, _siblings(loc), n=1, cutoff=0.6)
    if near:
        return prefix + near[0]
    return next((path for path, _ in _tables() if path.rpartition(".")[2] == name), None)


def _range_of(loc: Sequence[int | str]) -> tuple[float | None, float | None]:
    wanted = ".".join(str(part) for part in loc)
    annotation = next((hint for path, hint in _tables() if path == wanted), None)
    lower: float | None = None
    upper: float | None = None
    # A range sits in Annotated[...], possibly inside "... | None".
    for part in (annotation, *getattr(annotation, "__args__", ())):
        for info in getattr(part, "__metadata__", ()):
            for constraint in getattr(info, "metadata", ()):
                lower = getattr(constraint, "ge", lower)
                upper = getattr(constraint, "le", upper)
    return lower, upper
