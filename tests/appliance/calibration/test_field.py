"""What is supposed of a field follows the data: strong and fine where they are, smooth where few, nothing where none."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.calibration.field import AIR_VALUES, EYES, LEAST_PX, REACHES, AirField, FieldPrior, kernels
from appliance.optics.correction import node_count

SIZE_PX = (1600, 1200)
INTERVALS = (10, 8)
COUNT = node_count(INTERVALS)
NOISE_PX = 0.004


def refitted(nodes_px: np.ndarray, seen: np.ndarray) -> FieldPrior:
    """The prior after each node of ``seen`` (EYES · COUNT,) was measured with the noise ``NOISE_PX``."""
    prior = FieldPrior(np.zeros((len(nodes_px),) * 2), np.zeros(len(nodes_px)), SIZE_PX, INTERVALS)
    weight = np.where(seen, NOISE_PX**-2.0, 0.0)
    noisy = nodes_px + np.random.default_rng(3).normal(0.0, NOISE_PX, len(nodes_px))
    # The data's cost is Σ w (x − noisy)²; about x = 0 its slope is −w noisy.
    prior.refit(np.diag(weight), -weight * noisy, np.zeros(len(nodes_px)), 15)
    return prior


@pytest.mark.parametrize("which", [0, 1, 2])
def test_a_field_of_one_length_is_told_from_those_of_others(which: int) -> None:
    kernel = kernels(SIZE_PX, INTERVALS)[which]
    root = np.linalg.cholesky(kernel + 1e-9 * np.eye(COUNT))
    rng = np.random.default_rng(7)
    nodes = np.concatenate([0.05 * root @ rng.normal(size=COUNT) for _ in range(EYES)])
    found = np.sqrt(refitted(nodes, np.ones(len(nodes), bool)).variances_px2)
    # Two long ones are hardly told from each other within one picture, a flaw of a window from either is.
    assert np.hypot.reduce(found) == pytest.approx(0.05, rel=0.4)
    fine, wide = found[-1], np.hypot.reduce(found[:-1])
    assert (wide < 0.5 * fine) if which == len(REACHES) - 1 else (fine < 0.3 * wide)


def test_no_field_is_believed_where_there_is_none() -> None:
    found = np.sqrt(refitted(np.zeros(EYES * COUNT), np.ones(EYES * COUNT, bool)).variances_px2)
    assert np.all(found < 3.0 * LEAST_PX)


def test_nodes_that_nothing_was_seen_of_follow_their_neighbours_with_more_doubt() -> None:
    prior = refitted(np.full(EYES * COUNT, 0.05), np.arange(EYES * COUNT) % 3 == 0)
    information = prior.information
    seen = np.arange(EYES * COUNT) % 3 == 0
    covariance = np.linalg.inv(information + np.diag(np.where(seen, NOISE_PX**-2.0, 0.0)))
    best = covariance @ np.where(seen, NOISE_PX**-2.0 * 0.05, 0.0)
    assert best[~seen] == pytest.approx(0.05, abs=0.01)
    assert np.median(np.diag(covariance)[~seen]) > 1.2 * np.median(np.diag(covariance)[seen])


def test_what_boards_say_of_a_field_survives_being_written_down() -> None:
    size = AIR_VALUES + EYES * node_count((2, 1))
    rng = np.random.default_rng(5)
    root = rng.normal(size=(size, size)) * 0.01 + np.eye(size)
    mean = rng.normal(size=size)
    field = AirField.of((2, 1), mean, root @ root.T)
    again = AirField.from_text((2, 1), field.mean, field.text)
    assert again == field
    assert again.mean == tuple(mean)
    assert again.covariance == pytest.approx(root @ root.T, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize(("text", "said"), [("AAAA", "calibrate in air again"), ("!", "not base64")])
def test_a_field_that_is_cut_off_or_garbled_is_refused(text: str, said: str) -> None:
    size = AIR_VALUES + EYES * node_count((2, 1))
    with pytest.raises(ValueError, match=said):
        AirField.from_text((2, 1), (0.0,) * size, text)
