"""Total variation: the minimiser against an independent solver and other packages, and its certificate."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid_dynamics.differentiate import get_differentiator, tv_solver
from hybrid_dynamics.differentiate.total_variation import objective, solve
from hybrid_dynamics.errors import ConfigError

cvxpy = pytest.importorskip("cvxpy")


def noisy(rows, dt=0.01, noise=1e-3, seed=0):
    t = dt * np.arange(rows)
    clean = 0.6 * np.sin(2 * np.pi * 0.3 * t) + 0.2 * np.sin(2 * np.pi * 1.1 * t + 1)
    return clean + noise * np.random.default_rng(seed).normal(size=rows)


def by_cvxpy(x, dt, alpha):
    """F minimised as it is defined: over the derivative and the initial value, through the integration matrix."""
    rates, start = cvxpy.Variable(len(x) - 1), cvxpy.Variable()
    xi = start + dt * cvxpy.hstack([0, cvxpy.cumsum(rates)])
    problem = cvxpy.Problem(
        cvxpy.Minimize(0.5 * dt * cvxpy.sum_squares(xi - x) + alpha * cvxpy.norm1(cvxpy.diff(rates)))
    )
    problem.solve(solver="CLARABEL", tol_gap_abs=1e-14, tol_gap_rel=1e-12, tol_feas=1e-12)
    return start.value + dt * np.concatenate([[0], np.cumsum(rates.value)])


@pytest.mark.parametrize(("rows", "dt"), [(60, 0.01), (300, 0.01), (300, 0.001), (700, 0.004)])
@pytest.mark.parametrize("lam", [1e-5, 1e-3, 0.1, 5.0])
def test_objective_equals_cvxpy(rows, dt, lam):
    x, alpha = noisy(rows, dt), lam * dt**2
    ours, theirs = solve(x, dt, alpha), by_cvxpy(x, dt, alpha)
    value = objective(ours.xi, x, dt, alpha)
    assert value == pytest.approx(ours.objective, rel=1e-9)
    assert value == pytest.approx(objective(theirs, x, dt, alpha), rel=1e-6)
    # The gap is a proof: nothing, cvxpy's solution included, may lie below objective - gap.
    assert ours.gap <= 1e-8 * value
    assert objective(theirs, x, dt, alpha) >= (value - ours.gap) * (1 - 1e-9)
    np.testing.assert_allclose(ours.xi, theirs, atol=1e-5)


@settings(max_examples=60, deadline=None)
@given(
    rows=st.integers(5, 60),
    lam=st.floats(1e-4, 1e2),
    seed=st.integers(0, 1000),
    size=st.sampled_from([1e-6, 1.0, 1e6]),
)
def test_gap_bounds_the_distance_to_every_other_point(rows, lam, seed, size):
    """F is 1-strongly convex: F(xi) <= F(other) + gap for any other point, here the truth of a perturbed dual."""
    rng = np.random.default_rng(seed)
    y = size * rng.normal(size=rows)
    found = tv_solver.solve(y, size * lam)

    def value(xi):
        return 0.5 * np.sum((xi - y) ** 2) + size * lam * np.sum(np.abs(np.diff(xi, 2)))

    assert value(found.xi) == pytest.approx(found.objective, rel=1e-9)
    assert 0 <= found.gap <= 1e-6 * found.objective
    for scale in (1e-4, 1e-2, 1.0):
        other = found.xi + size * scale * rng.normal(size=rows)
        distance = 0.5 * np.sum((other - found.xi) ** 2)
        slack = found.gap + 2 * np.sqrt(found.gap * distance)
        assert value(other) + slack + 1e-9 * found.objective >= found.objective + distance


@settings(max_examples=30, deadline=None)
@given(slope=st.floats(-5, 5), offset=st.floats(-5, 5), seed=st.integers(0, 100))
def test_a_straight_line_added_to_the_signal_is_added_to_the_solution(slope, offset, seed):
    x, dt, alpha = noisy(200, seed=seed), 0.01, 1e-6
    line = offset + slope * dt * np.arange(200)
    np.testing.assert_allclose(solve(x + line, dt, alpha).xi, solve(x, dt, alpha).xi + line, atol=1e-6)


def test_large_alpha_gives_the_least_squares_line_and_small_alpha_the_signal():
    x, dt = noisy(400), 0.01
    t = np.arange(400)
    largest = tv_solver.straight(x) * dt**2
    line = solve(x, dt, 1.001 * largest)
    np.testing.assert_allclose(line.xi, np.polyval(np.polyfit(t, x, 1), t), atol=1e-10)
    assert line.gap == 0
    assert np.max(np.abs(np.diff(solve(x, dt, 0.9 * largest).xi, 2))) > 1e-9
    np.testing.assert_allclose(solve(x, dt, 1e-12).xi, x, atol=1e-6)


def test_alpha_does_not_depend_on_the_sampling_rate():
    """The same motion and noise density at 200 and 1000 Hz: the derivative of the same alpha is the same."""
    method = get_differentiator("total_variation")
    slow, fast = 0.005, 0.001
    x_fast = noisy(10_000, fast, noise=0)
    rates = method(x_fast, fast, alpha=1e-6)[1][::5], method(x_fast[::5], slow, alpha=1e-6)[1]
    assert np.sqrt(np.mean((rates[0] - rates[1]) ** 2)) < 0.02 * np.std(rates[0])


@pytest.mark.parametrize("alpha", [1e-8, 1e-6, 1e-4])
def test_no_other_package_scores_lower(alpha):
    """PyNumDiff's convex and Chartrand routines and derivative's lasso, each in its own scaling, judged by our F."""
    pynumdiff = pytest.importorskip("pynumdiff")
    derivative = pytest.importorskip("derivative")
    rows, dt = 120, 0.01
    x = noisy(rows, dt)
    ours = solve(x, dt, alpha).objective
    scale = pynumdiff.utils.utility.robust_data_scale(x)
    candidates = {"tvrdiff": pynumdiff.tvrdiff(x, dt, order=1, gamma=2 * alpha / dt**2 / scale)[0]}
    candidates["chartrand"] = pynumdiff.iterative_velocity(x, dt, num_iterations=10, gamma=alpha, cg_maxiter=200)[0]
    t = dt * np.arange(rows)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the lasso says that it has not converged
        lasso = derivative.TrendFiltered(order=0, alpha=alpha / dt, max_iter=3_000)
        candidates["trend_filtered"] = lasso.x(x, t)
    scores = {name: objective(np.asarray(xi), x, dt, alpha) for name, xi in candidates.items()}
    for name, score in scores.items():
        assert score >= ours * (1 - 1e-9), name
    # Control: the comparison is fair, the convex routine comes close to the optimum.
    assert scores["tvrdiff"] < 1.05 * ours


def test_too_large_alpha_on_a_long_run_is_refused_or_certified():
    """Rounding may end the iteration early, but never without a certificate or a word."""
    x, dt = noisy(20_000, 0.001), 0.001
    largest = tv_solver.straight(x) * dt**2
    for share in (1e-6, 1e-4, 1e-2, 0.3):
        try:
            found = solve(x, dt, share * largest)
        except ConfigError as error:
            assert "smaller alpha" in str(error)  # noqa: PT017
        else:
            assert found.gap <= 1e-6 * found.objective


def test_bad_values_are_refused_by_name():
    method = get_differentiator("total_variation")
    with pytest.raises(ConfigError, match="alpha is -1"):
        method(noisy(100), 0.01, alpha=-1.0)
    with pytest.raises(ConfigError, match="criterion is 'best'"):
        method(noisy(200), 0.01, criterion="best")
    with pytest.raises(ConfigError, match="unknown option 'cutoff_hz'"):
        method(noisy(100), 0.01, cutoff_hz=3.0)
