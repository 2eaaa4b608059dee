"""Forty random mistakes in descriptions and calibrations, over sets of one and two directions: reported, unchecked or
silent."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bench.result import Measurement
from tests.support.wrong_words import DRAWN, WRONG, Described, Wrong, call, drawn_set, outcome, real_sets, told_words

SEED, COUNT = 11, 40
LEAST_NAMED = 30


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="./dev bench import_wrong_words", description=__doc__)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--count", type=int, default=COUNT)
    chosen = parser.parse_args(arguments)
    all_kept = True
    for number in measure(chosen.seed, chosen.count):
        all_kept &= number.is_kept
        print(number.line(), flush=True)
    return 0 if all_kept else 1


def measure(seed: int = SEED, count: int = COUNT) -> Iterator[Measurement]:
    """Yield the result of every correct set, and of ``count`` mistakes, with the messages of those that are not
    reported."""
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        sets = [*(drawn_set(drawing, root, 10 * seed + k) for k, drawing in enumerate(DRAWN)), *real_sets(root)]
        doubted = 0
        for described in sets:
            answer = call(described, None, root / "cloud.npz")
            doubted += len(told_words(answer, "fits") & told_words(answer, "unchecked"))
            yield Measurement(f"{described.name}: described rightly", float(answer.code), "errors", at_most=0.0)
            if answer.code:
                yield _told(answer.error)
        counts = dict.fromkeys(("named", "unchecked", "refused by another word", "silent"), 0)
        for described, wrong in _drawn(sets, seed, count):
            answer = call(described, wrong, root / "cloud.npz")
            result = outcome(answer, wrong)
            counts[result] += 1
            yield Measurement(f"{described.name}: {wrong.name}: {result}", float("nan"), "", why="")
            if result != "named":
                yield _told(answer.error or " | ".join(answer.unchecked))
        total = sum(counts.values())
        for name, number in counts.items():
            target = LEAST_NAMED * total / COUNT if name == "named" else None
            yield Measurement(
                name, float(number), f"of {total}", at_most=0.0 if name == "silent" else None, at_least=target
            )
        yield Measurement("words of right sets that fit and are unchecked", float(doubted), "", at_most=0.0)


def _drawn(sets: Sequence[Described], seed: int, count: int) -> list[tuple[Described, Wrong]]:
    """Return random mistakes that fit; each kind comes once before any comes twice."""
    random = np.random.default_rng(seed)
    left = [(described, wrong) for described in sets for wrong in WRONG if wrong.fits(described)]
    order = [left[k] for k in random.permutation(len(left))]
    times: dict[str, int] = {}
    ranked = []
    for described, wrong in order:
        times[wrong.name] = times.get(wrong.name, 0) + 1
        ranked.append((times[wrong.name], described, wrong))
    return [(described, wrong) for _, described, wrong in sorted(ranked, key=lambda each: each[0])[:count]]


def _told(text: str) -> Measurement:
    return Measurement(f"    {' '.join(text.split())[:400]}", float("nan"), "", why="")
