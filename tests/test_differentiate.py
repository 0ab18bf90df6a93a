"""Derivatives of whole runs: sampling instants, bandwidth, edges, and what is refused."""

import numpy as np
import pytest

from hybrid_dynamics.differentiate import DifferentiateSettings, differentiate_trajectory
from hybrid_dynamics.differentiate.butterworth import lowpass, response
from hybrid_dynamics.differentiate.differences import central_difference
from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.trajectory import Trajectory

FREQUENCIES = np.array([0.2, 0.5, 0.9])
AMPLITUDES = np.array([0.6, 0.25, 0.1])


def multi_sine(time, order):
    """The ``order``-th derivative of a two-joint multi-sine."""
    columns = []
    for phase in (0.3, 1.7):
        w = 2 * np.pi * FREQUENCIES
        angle = w * time[:, None] + phase * np.arange(1, 4) + order * np.pi / 2
        columns.append(np.sum(AMPLITUDES * w**order * np.sin(angle), axis=1))
    return np.column_stack(columns)


def recorded(rate=100.0, seconds=30.0, noise=1e-4, seed=0, velocity=False):
    time = np.arange(0, seconds, 1 / rate)
    rng = np.random.default_rng(seed)
    q = multi_sine(time, 0) + noise * rng.normal(size=(len(time), 2))
    tau = 3 * multi_sine(time, 2) + 0.5 * multi_sine(time, 1)
    signals = {"q": q, "tau": tau + 0.05 * rng.normal(size=tau.shape)}
    if velocity:
        signals["dq"] = multi_sine(time, 1) + 1e-3 * rng.normal(size=q.shape)
    return Trajectory("run", "train", time, signals)


def relative(estimate, truth):
    return np.sqrt(np.mean((estimate - truth) ** 2)) / np.std(truth)


# --- zero-order hold ---------------------------------------------------------------------------------------------


def held_mass(inertia=0.5, damping=6.75, dt=1e-3, rows=4000):
    """inertia ddq + damping dq = tau with tau held over each step, solved exactly."""
    time = dt * np.arange(rows)
    tau = np.column_stack([10 * np.sin(7 * time) + 4 * np.sin(23 * time + 1)])
    decay = np.exp(-damping / inertia * dt)
    q, dq = np.zeros_like(tau), np.zeros_like(tau)
    for k in range(rows - 1):
        steady = tau[k] / damping
        dq[k + 1] = steady + (dq[k] - steady) * decay
        q[k + 1] = q[k] + steady * dt + (dq[k] - steady) * (1 - decay) * inertia / damping
    return Trajectory("mass", "train", time, {"q": q, "dq": dq, "tau": tau}), inertia, damping


def test_zoh_recovers_inertia_and_damping_where_same_instant_pairing_does_not():
    run, inertia, damping = held_mass()
    out, report = differentiate_trajectory(run, DifferentiateSettings(method="zoh"))
    fit = np.linalg.lstsq(np.hstack([out["ddq"], out["dq"]]), out["tau"], rcond=None)[0][:, 0]
    assert fit == pytest.approx([inertia, damping], rel=2e-4)
    # Control: state and torque taken at the same instant put the damping off by far more.
    naive = np.hstack([np.gradient(run["dq"], run.dt, axis=0), run["dq"]])[1:-1]
    off = np.linalg.lstsq(naive, run["tau"][1:-1], rcond=None)[0][1, 0]
    assert abs(off / damping - 1) > 2e-3
    assert report["trim_rows"] == [1, 2]


def test_zoh_rows_keep_their_torque_and_take_the_middle_of_their_interval():
    run, _, _ = held_mass(rows=50)
    out, _ = differentiate_trajectory(run, DifferentiateSettings(method="zoh"))
    np.testing.assert_array_equal(out["tau"], run["tau"][1:-2])
    np.testing.assert_allclose(out.time, run.time[1:-2] + run.dt / 2, atol=1e-12)
    np.testing.assert_allclose(out["q"], (run["q"][1:-2] + run["q"][2:-1]) / 2)
    np.testing.assert_allclose(out["dddq"][1:-1], (out["ddq"][2:] - out["ddq"][:-2]) / (2 * run.dt))


# --- low-pass ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("accuracy", [2, 4, 6])
def test_central_difference_is_exact_for_polynomials(accuracy):
    t = np.linspace(-1, 1, 41)
    coefficients = np.arange(1.0, accuracy + 2)
    x = np.polynomial.polynomial.polyval(t, coefficients)
    truth = np.polynomial.polynomial.polyval(t, np.polynomial.polynomial.polyder(coefficients))
    np.testing.assert_allclose(central_difference(x, t[1] - t[0], accuracy), truth, rtol=1e-9, atol=1e-9)


def test_lowpass_has_the_stated_response_and_no_delay():
    dt, cutoff = 0.01, 5.0
    t = np.arange(0, 40, dt)
    for frequency in (1.0, 5.0, 9.0):
        wave = np.exp(2j * np.pi * frequency * t)
        out = lowpass(wave.real, dt, cutoff) + 1j * lowpass(wave.imag, dt, cutoff)
        gain = np.mean((out / wave)[1000:-1000])
        assert gain.real == pytest.approx(float(response(np.array([frequency]), cutoff, dt)[0]), abs=1e-6)
        assert abs(gain.imag) < 1e-6
    assert float(response(np.array([cutoff]), cutoff, dt)[0]) == pytest.approx(np.sqrt(0.5))


@pytest.mark.parametrize("velocity", [False, True])
def test_recorded_run_has_true_derivatives_at_the_same_instants(velocity):
    run = recorded(velocity=velocity)
    out, report = differentiate_trajectory(run, DifferentiateSettings())
    for order, (signal, bound) in enumerate((("q", 1e-3), ("dq", 2e-3), ("ddq", 2e-2), ("dddq", 0.1))):
        assert relative(out[signal], multi_sine(out.time, order)) < bound, signal
    fit = np.linalg.lstsq(np.hstack([out["ddq"][:, :1], out["dq"][:, :1]]), out["tau"][:, 0], rcond=None)[0]
    assert fit == pytest.approx([3, 0.5], rel=0.01)
    assert report["source"] == ("dq" if velocity else "q")
    assert 0.9 < report["cutoff_hz"] < 10
    assert len(out.time) == len(run.time) - sum(report["trim_rows"])


def test_torque_passes_the_same_filter_as_the_motion():
    """A torque proportional to the measured velocity stays so, sample by sample; with another filter it would not."""
    run = recorded(velocity=True)
    run = run.with_signals(tau=4 * run["dq"])
    out, _ = differentiate_trajectory(run, DifferentiateSettings(cutoff_hz=4.0))
    np.testing.assert_allclose(out["tau"], 4 * out["dq"], atol=1e-12)


def test_overrides_are_obeyed():
    run = recorded()
    out, report = differentiate_trajectory(run, DifferentiateSettings(cutoff_hz=7.0, trim_s=1.5))
    assert report["cutoff_hz"] == 7.0
    assert report["trim_rows"] == [150, 150]
    assert out.time[0] == pytest.approx(run.time[150])


# --- refusals ----------------------------------------------------------------------------------------------------


def test_uneven_grid_is_refused_by_row():
    run = recorded()
    time = run.time.copy()
    time[500:] += 0.004
    with pytest.raises(InputError, match=r"run: time step .* at row 500.*resample"):
        differentiate_trajectory(Trajectory("run", "train", time, run.signals), DifferentiateSettings())


def test_zoh_without_velocity_and_short_runs_are_refused():
    with pytest.raises(InputError, match="needs dq"):
        differentiate_trajectory(recorded(), DifferentiateSettings(method="zoh"))
    with pytest.raises(InputError, match="longer run"):
        differentiate_trajectory(recorded(seconds=0.8), DifferentiateSettings(cutoff_hz=4.0))


@pytest.mark.parametrize(
    ("settings", "name"),
    [
        ({"method": "magic"}, "differentiate.method"),
        ({"cutoff_hz": -1.0}, "differentiate.cutoff_hz"),
        ({"order": 0}, "differentiate.order"),
        ({"trim_s": -0.5}, "differentiate.trim_s"),
    ],
)
def test_settings_out_of_range_are_refused_by_name(settings, name):
    with pytest.raises(ConfigError, match=name):
        DifferentiateSettings(**settings)


def test_cutoff_beyond_half_the_rate_is_refused():
    with pytest.raises(ConfigError, match="cutoff_hz is 60"):
        differentiate_trajectory(recorded(), DifferentiateSettings(cutoff_hz=60.0))
