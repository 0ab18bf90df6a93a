"""Every differentiator: one call, stated response, parameters near the best, and controls that would fail."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid_dynamics.differentiate import (
    DIFFERENTIATORS,
    DifferentiateSettings,
    derivative_errors,
    derivatives,
    differentiate_trajectory,
    get_differentiator,
)
from hybrid_dynamics.differentiate.choice import Choice
from hybrid_dynamics.differentiate.spectrum import estimate_spectrum
from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.trajectory import Trajectory

DT = 0.002
ROWS = 6000
STRONG = {"butterworth": 4.0, "spline": 4.0, "kalman": 4.0, "savitzky_golay": 151, "total_variation": 1e-6}
LINEAR = [name for name, method in DIFFERENTIATORS.items() if method.response is not None]


def with_every_method(first, second, both_slow=False):
    """Both values with every method; total variation takes longest: with ``first``, or both, in `make test` alone."""
    later = (first, second) if both_slow else (first,)
    return [
        pytest.param(value, name, marks=pytest.mark.slow if name == "total_variation" and value in later else ())
        for name in DIFFERENTIATORS
        for value in (first, second)
    ]


def motion(order, rows=ROWS, joints=2):
    t = DT * np.arange(rows)
    w = 2 * np.pi * np.array([0.15, 0.4, 0.9, 1.6])
    size = np.array([0.7, 0.3, 0.08, 0.02])
    phase = np.outer(np.arange(1, joints + 1), [0.3, 1.0, 2.0, 4.0])
    return np.stack([(size * w**order * np.sin(w * t[:, None] + p + order * np.pi / 2)).sum(1) for p in phase], 1)


def encoder(x, counts):
    step = 2 * np.pi / counts
    return np.round(x / step) * step


def run(signals, name="run"):
    return Trajectory(name, "test", DT * np.arange(len(next(iter(signals.values())))), signals)


@pytest.fixture(scope="module")
def truth():
    return run({name: motion(k) for k, name in enumerate(("q", "dq", "ddq", "dddq"))})


# --- one call ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", DIFFERENTIATORS)
def test_one_and_two_dimensional_signals_agree(name):
    method = get_differentiator(name)
    x = encoder(motion(0, 1500), 65536)
    options = {method.parameter: STRONG[name]}
    both = method(x, DT, **options)
    for j in range(2):
        single = method(x[:, j], DT, **options)
        for k in range(2):
            assert single[k].shape == (1500,)
            np.testing.assert_allclose(both[k][:, j], single[k], atol=1e-12)


@pytest.mark.parametrize("name", DIFFERENTIATORS)
def test_line_passes_unchanged(name):
    method = get_differentiator(name)
    t = DT * np.arange(1500)
    smooth, rate = method(2 - 3 * t, DT, **{method.parameter: STRONG[name]})
    np.testing.assert_allclose(smooth, 2 - 3 * t, atol=1e-9)
    np.testing.assert_allclose(rate, -3, atol=1e-6)


@pytest.mark.parametrize("name", LINEAR)
@settings(max_examples=10, deadline=None)
@given(a=st.floats(-3, 3), b=st.floats(-3, 3), seed=st.integers(0, 50))
def test_linear_methods_superpose(name, a, b, seed):
    method = get_differentiator(name)
    x, y = np.random.default_rng(seed).normal(size=(2, 800))
    options = {method.parameter: STRONG[name]}
    for k in range(2):
        together = method(a * x + b * y, DT, **options)[k]
        apart = a * method(x, DT, **options)[k] + b * method(y, DT, **options)[k]
        np.testing.assert_allclose(together, apart, atol=1e-8 * max(1, np.max(np.abs(together))))


@pytest.mark.parametrize("name", DIFFERENTIATORS)
def test_nothing_is_delayed(name):
    """Run backwards, a signal has the derivative backwards with the other sign."""
    method = get_differentiator(name)
    x = encoder(motion(0, 2000)[:, 0], 65536)
    options = {method.parameter: STRONG[name]}
    forward, backward = method(x, DT, **options)[1], method(x[::-1], DT, **options)[1][::-1]
    inner = slice(500, -500)
    np.testing.assert_allclose(forward[inner], -backward[inner], atol=1e-5 * np.std(forward))  # type: ignore[call-overload]


@pytest.mark.parametrize("name", LINEAR)
@pytest.mark.parametrize("frequency", [1.0, 4.0, 9.0])
def test_response_is_as_stated(name, frequency):
    method = get_differentiator(name)
    wave = np.exp(2j * np.pi * frequency * DT * np.arange(4000))
    rate = method.column(wave.real, DT, STRONG[name])[1] + 1j * method.column(wave.imag, DT, STRONG[name])[1]
    measured = (rate / (2j * np.pi * frequency * wave))[1500:-1500]
    stated = float(method.response(np.array([frequency]), DT, STRONG[name])[0])  # type: ignore[misc]
    np.testing.assert_allclose(measured, stated, atol=1e-6)


# --- choice from the data ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [1e-5, 1e-4, 1e-3])
def test_noise_level_is_found(noise):
    x = motion(0)[:, 0] + noise * np.random.default_rng(3).normal(size=ROWS)
    assert estimate_spectrum(x, DT).noise_std == pytest.approx(noise, rel=0.15)


def test_bandwidth_lies_above_the_fastest_sine_and_grows_with_it():
    quiet = encoder(motion(0)[:, 0], 65536)
    slow = estimate_spectrum(quiet, DT).bandwidth
    fast = estimate_spectrum(quiet, DT / 4).bandwidth
    assert 1.6 < slow < 8
    assert fast == pytest.approx(4 * slow, rel=1e-6)


@pytest.mark.parametrize(("counts", "name"), with_every_method(65536, 4096, both_slow=True))
def test_automatic_choice_is_near_the_best(name, counts, truth):
    one = run({name: value[:, :1] for name, value in truth.signals.items()})
    rows = derivative_errors(one, run({"q": encoder(one["q"], counts)}), [name])
    ratios = {(row["signal"], row["joint"]): row["ratio"] for row in rows}
    for joint in (1, "all"):
        assert ratios["dq", joint] < 1.3
        assert ratios["ddq", joint] < 1.3


@pytest.mark.parametrize("name", LINEAR)
def test_choice_follows_the_noise(name):
    """Control: what is chosen for a coarse encoder is far from the best for a fine one."""
    method = get_differentiator(name)
    fine, coarse = (Choice(encoder(motion(0)[:, 0], counts), DT).next(method) for counts in (2**22, 2**11))
    weaker = fine / coarse if method.weaker > 1 else coarse / fine
    assert weaker > 1.4
    x = encoder(motion(0)[:, 0], 2**11)
    inner = slice(1000, -1000)
    error = [np.std((method.column(x, DT, value)[1] - motion(1)[:, 0])[inner]) for value in (fine, coarse)]
    assert error[0] > 1.3 * error[1]


def test_criteria_of_total_variation_order_as_documented():
    method = get_differentiator("total_variation")
    x = encoder(motion(0)[:, 0], 4096)
    alpha = {c: Choice(x, DT, c).next(method) for c in ("surrogate", "discrepancy", "l_curve")}
    assert alpha["discrepancy"] > alpha["surrogate"]
    residual = method.column(x, DT, alpha["discrepancy"])[0] - x
    assert np.std(residual) == pytest.approx(estimate_spectrum(x, DT).noise_std, rel=0.1)
    assert all(value > 0 for value in alpha.values())


def test_same_data_same_choice():
    x = encoder(motion(0, 1500)[:, 0], 4096)
    for method in DIFFERENTIATORS.values():
        first, second = (method(x, DT)[1] for _ in range(2))
        np.testing.assert_array_equal(first, second)


def test_parameters_may_be_given_per_derivative():
    method = get_differentiator("spline")
    x = encoder(motion(0), 65536)
    chain = derivatives(x, DT, method, 2, cutoff_hz=[6.0, [5.0, 7.0]])
    np.testing.assert_array_equal(chain.parameters[0], [6, 6])
    np.testing.assert_array_equal(chain.parameters[1], [5, 7])
    np.testing.assert_allclose(chain.values[2], method(method(x, DT, cutoff_hz=6.0)[1], DT, cutoff_hz=[5.0, 7.0])[1])


# --- whole runs --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("velocity", "name"), with_every_method(False, True))
def test_whole_runs_with_every_method(name, velocity, truth):
    rng = np.random.default_rng(0)
    signals = {"q": encoder(truth["q"], 65536), "tau": 2 * truth["ddq"] + truth["dq"]}
    if velocity:
        signals["dq"] = truth["dq"] + 1e-3 * rng.normal(size=truth["dq"].shape)
    out, report = differentiate_trajectory(run(signals), DifferentiateSettings(method=name))
    inner = slice(report["trim_rows"][0], ROWS - report["trim_rows"][1])
    np.testing.assert_allclose(out.time, truth.time[inner])
    bounds = {"q": 1e-3, "dq": 0.02, "ddq": 0.15, "tau": 0.02}
    for signal, bound in bounds.items():
        wanted = truth[signal] if signal != "tau" else signals["tau"]
        wanted = wanted[inner]
        assert np.sqrt(np.mean((out[signal] - wanted) ** 2)) < bound * np.std(wanted), signal
    assert report["method"] == name
    assert report["source"] == ("dq" if velocity else "q")
    assert len(report["noise_std"]) == len(report["bandwidth_hz"]) == 2
    assert "Butterworth" in report["torque_filter"]


def test_misuse_is_refused_by_name(truth):
    x = encoder(motion(0, 500), 65536)
    with pytest.raises(ConfigError, match="unknown differentiator 'magic'; expected one of butterworth"):
        get_differentiator("magic")
    with pytest.raises(ConfigError, match="dt is 0"):
        get_differentiator("spline")(x, 0.0)
    with pytest.raises(ConfigError, match="window is 900"):
        get_differentiator("savitzky_golay")(x, DT, window=900)
    broken = x.copy()
    broken[41, 1] = np.nan
    with pytest.raises(InputError, match="not finite at row 42"):
        get_differentiator("kalman")(broken, DT)
    with pytest.raises(InputError, match="too few for a spectrum"):
        get_differentiator("spline")(x[:20], DT)
    with pytest.raises(InputError, match="same instants"):
        derivative_errors(truth, run({"q": x}))
    settings_ = DifferentiateSettings(options={"cutoff_hz": 3.0})
    with pytest.raises(ConfigError, match=r"differentiate\.options\.cutoff_hz: set differentiate\.cutoff_hz"):
        differentiate_trajectory(run({"q": x, "tau": x}), settings_)
