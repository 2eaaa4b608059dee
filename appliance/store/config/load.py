"""Reading a rig file's text into a ``Rig``, and the error messages for a wrong file."""

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
from appliance.store.config.checks import BrokenRule, broken_rules
from appliance.store.config.rig import Rig

_MAX_BYTES = 1_000_000
_MOST_FAULTS = 100
"""Largest number of wrong keys that are named; further ones are only counted, for the file is probably no rig file."""


class ConfigError(Exception):
    """Error of a rig file that cannot be used.

    ``headline`` fits a safe screen; ``str()`` adds allowed range and remedy, and names the ``others``, further faults
    of the file; ``uncounted`` is how many there are beyond those.
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
            texts = [error.headline + (f" (allowed: {error.allowed})" if error.allowed else "") for error in others]
            remaining = [f"and {uncounted} more"] if uncounted else []
            parts.append("also wrong: " + ", ".join(texts + remaining))
        super().__init__("; ".join(parts))


def default_rig_path() -> Path:
    """Return the rig file that is packaged with the product."""
    return Path(str(resources.files("appliance").joinpath("store", "rigs", "kingfisher.toml")))


def load_rig(path: Path | str | None = None) -> Rig:
    """Read and check a rig file, by default the packaged one.

    Raises only ConfigError, for any content of the file.
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
        # Through JSON: dates and other special values of TOML become text, and the copy shares no objects with
        # ``content``.
        plain = json.loads(json.dumps(content, default=str))
        # pydantic checks each key by itself; `broken_rules` checks the rules between keys once all are valid.
        rig = TypeAdapter(Rig).validate_python(plain)
    except ValidationError as error:
        # A misspelt key first: it is the cause of a missing one.
        details = sorted(error.errors(include_url=False), key=lambda d: not _is_unknown_key(d))
        named = [_error_of_detail(detail, source) for detail in details[1 : 1 + _MOST_FAULTS]]
        raise _error_of_detail(details[0], source, named, max(0, len(details) - 1 - _MOST_FAULTS)) from None
    broken = list(broken_rules(rig))
    if broken:
        raise _error_of_rule(broken[0], source, [_error_of_rule(complaint, source) for complaint in broken[1:]])
    return rig


def _error_of_rule(rule: BrokenRule, source: str, others: Sequence[ConfigError] = ()) -> ConfigError:
    value = "" if rule.value is None else f" {_spell(rule.value)}"
    return ConfigError(
        f"{rule.key}{value} {rule.relation}",
        rule.allowed,
        f"{rule.remedy} ({source})",
        key=rule.key,
        others=others,
    )


def _is_unknown_key(detail: ErrorDetails) -> bool:
    return detail["type"] in ("unexpected_keyword_argument", "extra_forbidden")


def _error_of_detail(
    detail: ErrorDetails, source: str, others: Sequence[ConfigError] = (), uncounted: int = 0
) -> ConfigError:
    """Return the error for one fault that pydantic reported.

    ``others`` and ``uncounted``: as in ``ConfigError``.
    """

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
        # An unknown key has no range: a similar name is the only help.
        near = _nearest(detail["loc"])
        hint = f"did you mean {near}?" if near else f"known are: {', '.join(_siblings(detail['loc']))}"
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
    expected = detail["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    return wrong(f"{key} {value} is not {expected.removesuffix(' is needed')}", allowed, remedy)


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


# ------------------------------------------------------------------------- keys and ranges of the dataclasses


def _keys(kind: Any = Rig, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every key of the vocabulary with its annotated type: ``camera.left.exposure_ms``."""
    hints = get_type_hints(kind, include_extras=True)
    for key in fields(kind):
        path = f"{prefix}{key.name}"
        yield path, hints[key.name]
        if is_dataclass(hints[key.name]):
            yield from _keys(hints[key.name], path + ".")


def _siblings(loc: Sequence[int | str]) -> list[str]:
    prefix = "".join(f"{part}." for part in loc[:-1])
    return [path[len(prefix) :] for path, _ in _keys() if path.startswith(prefix) and "." not in path[len(prefix) :]]


def _nearest(loc: Sequence[int | str]) -> str | None:
    """Return the known key that was probably meant: of the same table, else of the same name elsewhere."""
    prefix = "".join(f"{part}." for part in loc[:-1])
    name = str(loc[-1])
    near = difflib.get_close_matches(name, _siblings(loc), n=1, cutoff=0.6)
    if near:
        return prefix + near[0]
    return next((path for path, _ in _keys() if path.rpartition(".")[2] == name), None)


def _range_of(loc: Sequence[int | str]) -> tuple[float | None, float | None]:
    key = ".".join(str(part) for part in loc)
    annotation = next((hint for path, hint in _keys() if path == key), None)
    lower: float | None = None
    upper: float | None = None
    # A range sits in Annotated[...], possibly inside "... | None".
    for part in (annotation, *getattr(annotation, "__args__", ())):
        for info in getattr(part, "__metadata__", ()):
            for constraint in getattr(info, "metadata", ()):
                lower = getattr(constraint, "ge", lower)
                upper = getattr(constraint, "le", upper)
    return lower, upper
