"""SINDy on a triangular factor: the direct fit's coefficients in bounded memory."""

import tracemalloc
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pysindy.feature_library import PolynomialLibrary
from pysindy.optimizers import STLSQ

from hybrid_dynamics.engine import Local
from hybrid_dynamics.models import HybridEstimator, RigidBody, SindyEstimator, SindySettings, factorize
from hybrid_dynamics.models.moments import InMemory, moments


def smooth_data(samples=3000, seed=0):
    """Correlated features of one joint, as motion gives them: the seven share a few sines."""
    rng = np.random.default_rng(seed)
    waves = np.sin(np.linspace(0, 40, samples)[:, None] * rng.uniform(0.3, 3, 12) + rng.uniform(0, 6, 12))
    X = waves @ rng.normal(size=(12, 7)) * np.array([1, 1, 3, 40, 5, 2, 0.01])
    y = X[:, 4:5] + X[:, 5:6] + X[:, 6:7] + 2.25 * X[:, 1:2] + 0.3 * X[:, :1] * X[:, 1:2]
    return X, y


@pytest.mark.parametrize("chunk_rows", [97, 1000, 12_000])
def test_equals_the_direct_fit(chunk_rows):
    X, y = smooth_data()
    y = y + 0.02 * np.random.default_rng(1).normal(size=y.shape)
    theta = np.asarray(PolynomialLibrary(degree=2).fit_transform(X))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        direct = STLSQ(threshold=0.01, alpha=1e-4, max_iter=100).fit(theta, y).coef_
    chunked = SindyEstimator(SindySettings(chunk_rows=chunk_rows)).fit(X, y)
    np.testing.assert_array_equal(chunked.coef_ != 0, direct != 0)
    assert 0 < np.count_nonzero(direct) < direct.size
    assert np.linalg.norm(chunked.coef_ - direct) <= 1e-8 * np.linalg.norm(direct)


@settings(max_examples=25, deadline=None)
@given(rows=st.integers(1, 60), chunk=st.integers(1, 70), columns=st.integers(1, 4), seed=st.integers(0, 2**16))
def test_factor_keeps_every_inner_product(rows, chunk, columns, seed):
    """R'R = A'A for [Theta Y] = A, whatever the chunks, also with fewer rows than columns and far from zero."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(rows, columns)) + 10.0 * rng.normal(size=columns)
    y = rng.normal(size=(rows, 2))
    library = PolynomialLibrary(degree=3).fit(X)
    whole = np.column_stack([np.asarray(library.transform(X)), y])
    chunks = [InMemory(X[k : k + chunk], y[k : k + chunk]) for k in range(0, rows, chunk)]
    found = moments(chunks, np.asarray(library.powers_), 7, Local())
    size = np.maximum(np.linalg.norm(whole, axis=0), 1e-300)
    np.testing.assert_allclose(
        found.R.T @ found.R / size / size[:, None], whole.T @ whole / size / size[:, None], atol=1e-12
    )
    np.testing.assert_allclose(found.variance, y.var(axis=0), atol=1e-12)
    assert found.rows == rows
    assert np.array_equal(found.R, np.triu(found.R))


def test_joint_that_hardly_moves_does_not_spoil_the_fit():
    """q near 1.5 rad within 0.2 mrad: q*dq and dq differ by 1e-4, and their moments by the square of it."""
    rng = np.random.default_rng(3)
    X, _ = smooth_data()
    X[:, 0] = 1.5 + 2e-4 * X[:, 0]
    y = 3.0 * X[:, 1:2] - 2.0 * X[:, :1] * X[:, 1:2] + 0.5 * X[:, 4:5] + 1e-6 * rng.normal(size=(len(X), 1))
    theta = np.asarray(PolynomialLibrary(degree=2).fit_transform(X))
    exact = np.linalg.lstsq(theta, y, rcond=None)[0][:, 0]
    factor = factorize(X, y, SindySettings())
    found = np.linalg.lstsq(factor.theta, factor.torque, rcond=None)[0][:, 0]
    # What both leave is compared: coefficients of dependent columns are anybody's guess.
    left, least = (float(np.linalg.norm(theta @ c - y[:, 0])) for c in (found, exact))
    assert left <= least * (1 + 1e-3)
    names = SindyEstimator().fit_factor(factor).term_names()
    assert found[names.index("q1*dq1")] == pytest.approx(-2.0, rel=0.05)


def test_scaled_finds_the_small_term_and_nothing_else():
    X, y = smooth_data()
    fit = SindyEstimator(SindySettings(scaled=True, threshold=1e-3)).fit(X, y)
    found = {name for name, value in zip(fit.term_names(), fit.coef_[0], strict=True) if value}
    assert found == {"dq1", "tau_inertia1", "tau_coriolis1", "tau_gravity1", "q1*dq1"}
    np.testing.assert_allclose(fit.coef_[0][fit.coef_[0] != 0], [2.25, 1, 1, 1, 0.3], rtol=1e-6)


def test_control_absolute_threshold_loses_a_small_coefficient():
    """The same small effect in a column of large numbers falls below the published threshold in mixed units."""
    X, y = smooth_data()
    y = y + 0.005 * X[:, 3:4]
    published = SindyEstimator(SindySettings()).fit(X, y)
    scaled = SindyEstimator(SindySettings(scaled=True, threshold=1e-3)).fit(X, y)
    column = scaled.term_names().index("dddq1")
    assert published.coef_[0, column] == 0
    assert scaled.coef_[0, column] == pytest.approx(0.005, rel=1e-6)


def test_scaled_residual_is_judged_by_the_whole_torque():
    X, y = smooth_data()
    y = y - 0.3 * X[:, :1] * X[:, 1:2]
    structured = 2e-4 * y.std() * np.sin(37.0 * np.linspace(0, 40, len(y)))[:, None]
    hybrid = HybridEstimator(RigidBody(), SindyEstimator(SindySettings(scaled=True, threshold=1e-3)))
    coefficients = hybrid.fit(X, y + structured).residual.coef_[0]  # type: ignore[attr-defined]
    assert [hybrid.residual.term_names()[k] for k in np.flatnonzero(coefficients)] == ["dq1"]  # type: ignore[attr-defined]
    nothing = HybridEstimator(RigidBody(), SindyEstimator(SindySettings(scaled=True, threshold=1e-3)))
    nothing.fit(X, RigidBody().predict(X) + structured)
    assert not nothing.residual.coef_.any()  # type: ignore[attr-defined]
    assert not nothing.residual.predict(X).any()


def test_memory_does_not_grow_with_the_samples():
    def peak(samples):
        X, y = smooth_data(samples)
        tracemalloc.start()
        SindyEstimator(SindySettings(chunk_rows=1500)).fit(X, y)
        top = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return top

    library = 8 * 36 * 30_000
    assert peak(30_000) - peak(3000) < 0.2 * library
