"""What is supposed of a field follows the data: strong and fine where they are, smooth where few, nothing where none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.calibrate.field import FieldPrior, correlations
from appliance.measure.calibration.field import AIR_VALUES, AirField
from appliance.measure.light.correction import SplineGrid, node_count

SIZE_PX = (1600, 1200)


def test_what_boards_say_of_a_field_survives_being_written_down() -> None:
    size = AIR_VALUES + AirField.EYES * node_count((2, 1))
    rng = np.random.default_rng(5)
    root = rng.normal(size=(size, size)) * 0.01 + np.eye(size)
    mean = rng.normal(size=size)
    field = AirField.of((2, 1), mean, root @ root.T)
    again = AirField.from_text((2, 1), field.mean, field.text)
    assert again == field
    assert again.mean == tuple(mean)
    assert again.covariance == pytest.approx(root @ root.T, rel=1e-5, abs=1e-6)


def test_two_nodes_are_as_much_alike_as_matern_says_of_their_distance() -> None:
    """Distance as a share of the image's width, whatever its height: 1600 / 10 px across, 900 / 3 px down."""
    columns, rows = 13, 6
    for reach, found in zip((0.5, 0.2, 0.07), correlations(SplineGrid((1600, 900), (10, 3))), strict=True):
        at = found.reshape(rows, columns, rows, columns)
        for across, down in ((0, 0), (1, 0), (5, 0), (0, 1), (3, 2)):
            r = np.sqrt(3.0) * np.hypot(across * 160.0, down * 300.0) / (reach * 1600.0)
            assert at[1, 4, 1 + down, 4 + across] == pytest.approx((1.0 + r) * np.exp(-r), rel=1e-9)
            assert at[1 + down, 4 + across, 1, 4] == pytest.approx((1.0 + r) * np.exp(-r), rel=1e-9)


def test_before_any_data_a_node_may_be_off_by_three_hundredths_of_a_pixel_for_each_length() -> None:
    size = AirField.EYES * node_count((3, 2))
    prior = FieldPrior(np.zeros((size, size)), np.zeros(size), SplineGrid(SIZE_PX, (3, 2)))
    covariance = np.linalg.inv(prior.information)
    assert np.diag(covariance) == pytest.approx(3.0 * 0.03**2, rel=1e-3)
    assert np.abs(covariance[:30, 30:]).max() < 1e-9, "one component says nothing of another, nor one camera"


def test_one_round_changes_a_variance_tenfold_at_most_and_no_data_are_perfect() -> None:
    size = AirField.EYES * node_count((3, 2))
    nothing, much = np.zeros(size), np.random.default_rng(6).normal(0.0, 5.0, size)
    for nodes, rounds, wanted in ((nothing, 1, 0.1 * 0.03**2), (much, 1, 10.0 * 0.03**2), (nothing, 15, 0.002**2)):
        prior = FieldPrior(np.zeros((size, size)), np.zeros(size), SplineGrid(SIZE_PX, (3, 2)))
        prior.refit(np.eye(size) * 1e10, -1e10 * nodes, np.zeros(size), rounds)
        assert prior.variances_px2 == pytest.approx(wanted)


@pytest.mark.parametrize("coupled", [False, True])
def test_variances_are_where_the_likelihood_of_the_data_has_its_top(coupled: bool) -> None:
    """Restricted likelihood by its textbook formula, with the data's whole covariance (Patterson and Thompson, 1971)."""
    intervals, first, free, noise = (2, 2), 7, 5, 0.3
    count = node_count(intervals)
    m = first + AirField.EYES * count
    rng = np.random.default_rng(12)
    known = np.zeros((m, m))
    root = rng.normal(size=(m, m)) * 0.02 if coupled else np.zeros((m, m))
    root[:first, :first] = rng.normal(size=(first, first))
    known[:] = root @ root.T
    mean = np.concatenate([rng.normal(size=first), 0.05 * rng.normal(size=AirField.EYES * count)])
    all_kernels = correlations(SplineGrid(SIZE_PX, intervals))
    roots = [np.linalg.cholesky(K + 1e-9 * np.eye(count)) for K in all_kernels]
    z = np.concatenate([mean + root @ rng.normal(size=m), rng.normal(size=free)])
    for k in range(AirField.EYES):
        at = slice(first + k * count, first + (k + 1) * count)
        z[at] += sum(sd * one @ rng.normal(size=count) for sd, one in zip((0.3, 0.2, 0.3), roots, strict=True))
    A = rng.normal(size=(90, m + free))
    y = A @ z + noise * rng.normal(size=len(A))
    prior = FieldPrior(known, mean, SplineGrid(SIZE_PX, intervals))
    about = z + 0.01 * rng.normal(size=len(z))
    prior.refit(A.T @ A / noise**2, -A.T @ (y - A @ about) / noise**2, about, 400)
    covariance = known.copy()
    for k in range(AirField.EYES):
        at = slice(first + k * count, first + (k + 1) * count)
        covariance[at, at] += sum(v * K for v, K in zip(prior.variances_px2, all_kernels, strict=True))
    X = A[:, m:]
    inverse = np.linalg.inv(A[:, :m] @ covariance @ A[:, :m].T + noise**2 * np.eye(len(A)))
    P = inverse - inverse @ X @ np.linalg.solve(X.T @ inverse @ X, X.T @ inverse)
    pull = P @ (y - A[:, :m] @ mean)
    for K in all_kernels:
        blocks = [A[:, first + k * count : first + (k + 1) * count] for k in range(AirField.EYES)]
        found = sum(float(pull @ one @ K @ one.T @ pull) for one in blocks)
        wanted = sum(float(np.sum((one.T @ P @ one) * K)) for one in blocks)
        assert found == pytest.approx(wanted, rel=0.04)
    assert np.linalg.inv(prior.information) == pytest.approx(covariance, abs=1e-5)


def test_a_covariance_that_rounding_has_left_without_a_factor_is_kept_all_the_same() -> None:
    """As boards before strongly flawed lenses leave it: pixels and radians, and one direction that is known to nothing."""
    size = AIR_VALUES + AirField.EYES * node_count((2, 1))
    rng = np.random.default_rng(11)
    vectors, _ = np.linalg.qr(rng.normal(size=(size, size)))
    values = np.geomspace(1e-3, 10.0, size)
    values[0] = -1e-8
    scale = np.geomspace(1e-5, 10.0, size)
    covariance = scale[:, None] * (vectors * values) @ vectors.T * scale
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(covariance)
    kept = AirField.of((2, 1), np.zeros(size), covariance).covariance
    assert np.diag(kept) == pytest.approx(np.diag(covariance), rel=1e-5)
    values[0] = -0.1
    with pytest.raises(np.linalg.LinAlgError):
        AirField.of((2, 1), np.zeros(size), scale[:, None] * (vectors * values) @ vectors.T * scale)


def test_a_field_that_is_none_is_refused() -> None:
    """Two by one intervals: 22 values and 4 · 20 nodes, a factor of 102 · 103 / 2 numbers of four bytes."""
    field = AirField.of((2, 1), np.zeros(102), np.eye(102))
    values = np.frombuffer(field.root, "<f4").copy()
    values[3] = np.nan
    for text, said in (("AAAA", "again"), ("!", "base64"), (replace(field, root=values.tobytes()).text, "finite")):
        with pytest.raises(ValueError, match=said):
            AirField.from_text((2, 1), field.mean, text)
    for count, size in ((101, 21012), (102, 21008)):
        with pytest.raises(ValueError, match=f"{count} values and {size} bytes; .* need 102 and 21012"):
            AirField((2, 1), (0.0,) * count, b"0" * size)
    known = np.diag([1.0, -1.0, *[0.0] * 80])
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite at 2 of 2"):
        FieldPrior(known, np.zeros(82), SplineGrid(SIZE_PX, (2, 1)))
