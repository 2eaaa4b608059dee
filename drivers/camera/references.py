"""Owns what is asked of a camera's description before GenApi may see it: GenApi follows some wrong references blindly.

A ``pPort`` that names a node other than a port, or any other reference that names a port, ends the process from below
Python, where nothing can be caught (genicam 1.6). Such a description is refused like any other that cannot be used.
"""

from __future__ import annotations

from xml.etree import ElementTree


class WrongReference(ValueError):
    """The description is not well formed, or names a node where there is none of the needed kind."""


def check_references(xml: str) -> None:
    """Raises WrongReference for what GenApi would not survive; everything else it judges itself."""
    try:
        root = ElementTree.fromstring(xml.encode())
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise WrongReference(f"not well-formed XML: {error}") from error
    ports = {node.get("Name") for node in root.iter() if _kind(node) == "Port"}
    for node in root.iter():
        kind, name = _kind(node), (node.text or "").strip()
        if kind == "pPort" and name not in ports:
            raise WrongReference(f"pPort names {name[:40]!r}, which is no port")
        if kind.startswith("p") and kind != "pPort" and name in ports:
            raise WrongReference(f"{kind} names {name[:40]!r}, which is a port and no feature")


def _kind(node: ElementTree.Element) -> str:
    """The element's name without its name space."""
    return str(node.tag).rpartition("}")[2]
