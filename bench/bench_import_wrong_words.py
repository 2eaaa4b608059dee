"""Forty wrong words and wrong cameras' numbers, drawn with a seed over sets of one and two directions: named, unchecked or silent."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bench.result import Measured
from tests.support.wrong_words import DRAWN, WRONG, Described, Wrong, call, drawn_set, outcome, real_sets, told_words

SEED, COUNT = 11, 40
LEAST_NAMED = 30


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="./dev bench import_wrong_words", description=__doc__)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--count", type=int, default=COUNT)
    chosen = parser.parse_args(arguments)
    kept = True
    for one in measure(chosen.seed, chosen.count):
        kept &= one.kept
        print(one.line(), flush=True)
    return 0 if kept else 1


def measure(seed: int = SEED, count: int = COUNT) -> Iterator[Measured]:
    """Every set rightly described, then ``count`` of all mistakes that fit a set; what was said stands behind those that are not named."""
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        sets = [*(drawn_set(own, root, 10 * seed + k) for k, own in enumerate(DRAWN)), *real_sets(root)]
        doubted = 0
        for one in sets:
            said = call(one, None, root / "cloud.npz")
            doubted += len(told_words(said, "fits") & told_words(said, "unchecked"))
            yield Measured(f"{one.name}: described rightly", float(said.code), "errors", at_most=0.0)
            if said.code:
                yield _told(said.error)
        counts = dict.fromkeys(("named", "unchecked", "refused by another word", "silent"), 0)
        for one, wrong in _drawn(sets, seed, count):
            said = call(one, wrong, root / "cloud.npz")
            found = outcome(said, wrong)
            counts[found] += 1
            yield Measured(f"{one.name}: {wrong.name}: {found}", float("nan"), "", why="")
            if found != "named":
                yield _told(said.error or " | ".join(said.unchecked))
        total = sum(counts.values())
        for name, number in counts.items():
            least = LEAST_NAMED * total / COUNT if name == "named" else None
            yield Measured(
                name, float(number), f"of {total}", at_most=0.0 if name == "silent" else None, at_least=least
            )
        yield Measured("words of right sets that fit and are unchecked", float(doubted), "", at_most=0.0)


def _drawn(sets: Sequence[Described], seed: int, count: int) -> list[tuple[Described, Wrong]]:
    """Draw from all that fit; each kind comes once before any comes twice."""
    random = np.random.default_rng(seed)
    left = [(one, wrong) for one in sets for wrong in WRONG if wrong.fits(one)]
    order = [left[k] for k in random.permutation(len(left))]
    times: dict[str, int] = {}
    ranked = []
    for one, wrong in order:
        times[wrong.name] = times.get(wrong.name, 0) + 1
        ranked.append((times[wrong.name], one, wrong))
    return [(one, wrong) for _, one, wrong in sorted(ranked, key=lambda each: each[0])[:count]]


def _told(text: str) -> Measured:
    return Measured(f"    {' '.join(text.split())[:400]}", float("nan"), "", why="")
