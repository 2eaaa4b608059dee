"""Owns the command line of `kingfisher-transfer`: serving, sticks, and the list of keys."""

from __future__ import annotations

import argparse
import os
import socket
import sys
import threading
from pathlib import Path

from kingfisher_setup import durable
from kingfisher_transfer import keys, serving, stick
from kingfisher_transfer.keys import Key, KeysError
from kingfisher_transfer.serving import Places


def main() -> int:
    """Do what was typed; returns the exit code: 0 done, 1 not, 2 typed wrong."""
    typed = _parser().parse_args()
    places = Places() if typed.keys is None else Places(authorized=typed.keys)
    try:
        match typed.verb:
            case "serve":
                stopping = threading.Event()
                serving.on_signals(stopping)
                return serving.serve(places, _say_ready, stopping)
            case "stick":
                return _stick(typed.device, places)
            case "enrol":
                _tell("enrolled", keys.enrol(places.authorized, typed.file.read_bytes()))
            case "list":
                _tell("enrolled", keys.enrolled(places.authorized))
            case "forget":
                there = keys.enrolled(places.authorized)
                wanted = {key.fingerprint for key in there} if typed.all else set(typed.fingerprint)
                unknown = wanted - {key.fingerprint for key in there}
                if unknown:
                    raise KeysError(f"{', '.join(sorted(unknown))}: not enrolled; `list` shows what is")
                _tell("forgotten", keys.forget(places.authorized, wanted))
    except (KeysError, OSError) as error:
        print(f"kingfisher-transfer: {error}", file=sys.stderr)
        return 1
    return 0


def _stick(device: Path, places: Places) -> int:
    """Do what a stick asks for; what came of it is remembered for the screen, also where it was refused."""
    if not places.note.exists():
        print(f"{device}: the transfer is off; no stick is looked at", file=sys.stderr)
        return 0
    try:
        news, code = stick.of_device(device, places.authorized), 0
    except KeysError as error:
        news, code = f"refused: {error}", 1
    if news:
        print(f"stick {device.name}: {news}", file=sys.stderr)
        durable.write(places.news, news.encode("utf-8", "replace"))
    return code


def _tell(what: str, some: list[Key]) -> None:
    for key in some:
        print(f"{key.fingerprint}  {key.kind}  {key.comment}".rstrip())
    print(f"{len(some)} {what}", file=sys.stderr)


def _say_ready() -> None:
    """Tell systemd that the server runs (sd_notify(3)); nothing where nobody listens."""
    where = os.environ.get("NOTIFY_SOCKET")
    if where:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as to:
            to.connect(f"\0{where[1:]}" if where.startswith("@") else where)
            to.send(b"READY=1")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="kingfisher-transfer", description="Scans for desks that have a key.")
    parser.add_argument(
        "--keys", type=Path, metavar="FILE", help="the file of enrolled keys (default: the instrument's)"
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    verbs.add_parser("serve", help="serve until the note is gone (a unit does)")
    verbs.add_parser("stick", help="take keys from a stick (a unit does)").add_argument("device", type=Path)
    verbs.add_parser("enrol", help="enrol the public keys in a file").add_argument("file", type=Path)
    verbs.add_parser("list", help="the keys that are enrolled")
    forget = verbs.add_parser("forget", help="forget keys")
    forget.add_argument("fingerprint", nargs="*", help="SHA256:…, as `list` shows it")
    forget.add_argument("--all", action="store_true", help="every key")
    return parser
