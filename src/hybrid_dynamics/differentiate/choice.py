"""The parameter of a differentiator, chosen from the data.

Linear methods: the minimiser of the estimated error of the derivative wanted (:mod:`.spectrum`), over the response of
everything the signal has passed so far. Nonlinear ones have no response; three rules are on offer:

- ``surrogate`` (default, a parametric bootstrap): a low-passed copy of the signal, whose derivatives are known, takes
  the signal's place; what the low-pass removed, reversed in time, is added as noise; the parameter with the smallest
  error against the known derivative wins. It aims at the derivative itself and knows the noise's colour.
- ``discrepancy`` (Morozov): the residual's rms equals the noise level. It aims at the signal, and smooths too much.
- ``l_curve``: the corner of log residual against log penalty. Needs no noise level, often smooths too little.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hybrid_dynamics.differentiate import butterworth
from hybrid_dynamics.differentiate.differences import central_difference
from hybrid_dynamics.differentiate.edges import transient_samples
from hybrid_dynamics.differentiate.method import DerivativeMethod, cutoff_candidates
from hybrid_dynamics.differentiate.spectrum import Spectrum, estimate_spectrum
from hybrid_dynamics.errors import ConfigError
from hybrid_dynamics.types import Array

CRITERIA = ("surrogate", "discrepancy", "l_curve")
#: Samples of the stretch (the middle of the run) on which a nonlinear method is tried out.
STRETCH = 20_000
#: Largest derivative order of a chain.
MAX_ORDER = 3


class Choice:
    """Chooses the parameters of a chain position -> velocity -> acceleration -> jerk for one signal (T,).

    Each call of :meth:`next` chooses for one more derivative, given what the earlier steps already removed.
    """

    def __init__(self, x: Array, dt: float, criterion: str = "surrogate", **options: Any) -> None:
        if criterion not in CRITERIA:
            raise ConfigError(f"criterion is {criterion!r}; expected one of {', '.join(CRITERIA)}")
        self.dt = dt
        self.criterion = criterion
        self.spectrum: Spectrum = estimate_spectrum(x, dt)
        self._x = np.asarray(x, float)
        self._options = options
        self._order = 0
        self._gain = np.ones_like(self.spectrum.frequency)
        self._surrogate: tuple[list[Array], Array, slice] | None = None

    def next(self, method: DerivativeMethod) -> float:
        """The parameter of ``method`` for the next derivative."""
        self._order += 1
        options = method.own(self._options)
        if method.response is not None:
            candidates = method.candidates(self._x, self.dt)
            gains = [self._gain * method.response(self.spectrum.frequency, self.dt, v, **options) for v in candidates]
            best = int(np.argmin([self.spectrum.risk(gain, self._order) for gain in gains]))
            self._gain = gains[best]
            return float(candidates[best])
        truth, noisy, inner = self._surrogates()
        if self.criterion == "surrogate":
            wanted = truth[self._order][inner]

            def loss(value: float) -> float:
                return float(np.mean((method.column(noisy, self.dt, value, **options)[1][inner] - wanted) ** 2))

            value = minimise(loss, method.candidates(noisy, self.dt))
        else:
            value = _by_residual(method, noisy, self.dt, self.criterion, options)
        self._surrogate = (truth, method.column(noisy, self.dt, value, **options)[1], inner)
        return float(value)

    def _surrogates(self) -> tuple[list[Array], Array, slice]:
        """Known signal and derivatives, the noisy signal as it stands at this step, and the rows clear of edges."""
        if self._surrogate is not None:
            return self._surrogate
        dt, spectrum = self.dt, self.spectrum
        cutoffs = cutoff_candidates(self._x, dt)
        risks = [spectrum.risk(butterworth.response(spectrum.frequency, c, dt), 1) for c in cutoffs]
        cutoff = float(cutoffs[int(np.argmin(risks))])
        start = max((len(self._x) - STRETCH) // 2, 0)
        truth = [butterworth.lowpass(self._x, dt, cutoff)]
        noise = (self._x - truth[0])[start : start + STRETCH][::-1]
        for _ in range(MAX_ORDER):
            truth.append(central_difference(truth[-1], dt))
        truth = [t[start : start + STRETCH] for t in truth]
        x = self._x[start : start + STRETCH]
        edge = min(transient_samples(cutoff, dt), len(x) // 8)
        noisy = truth[0] + noise if self.criterion == "surrogate" else x
        self._surrogate = (truth, noisy, slice(edge, len(x) - edge))
        return self._surrogate


def minimise(loss: Any, candidates: Array, rounds: int = 3) -> float:
    """Minimiser of ``loss`` over ``candidates`` (log-spaced), then between its neighbours, halving each round.

    A candidate that the method refuses (:class:`ConfigError`) does not take part.
    """

    def attempt(value: float) -> float:
        try:
            return float(loss(value))
        except ConfigError:
            return float("inf")

    losses = [attempt(float(v)) for v in candidates]
    best = int(np.argmin(losses))
    value, smallest = float(candidates[best]), losses[best]
    if not np.isfinite(smallest):
        raise ConfigError("no value of the parameter can be used on this signal; set it in differentiate.options")
    ratio = float(candidates[1] / candidates[0]) if len(candidates) > 1 else 1.0
    for _ in range(rounds):
        ratio = np.sqrt(ratio)
        for trial in (value * ratio, value / ratio):
            attempted = attempt(trial)
            if attempted < smallest:
                value, smallest = trial, attempted
                break
    return float(value)


def _by_residual(method: DerivativeMethod, x: Array, dt: float, criterion: str, options: dict[str, Any]) -> float:
    """The parameter by discrepancy or L-curve; the penalty is the total variation of the derivative."""
    values, residual, penalty = [], [], []
    for value in method.candidates(x, dt):
        try:
            x_hat, dx_hat = method.column(x, dt, float(value), **options)
        except ConfigError:
            continue
        values.append(float(value))
        residual.append(float(np.sqrt(np.mean((x_hat - x) ** 2))))
        penalty.append(float(np.sum(np.abs(np.diff(dx_hat)))))
    if len(values) < 3:
        raise ConfigError("too few values of the parameter can be used on this signal; set it in differentiate.options")
    log_value, log_residual, log_penalty = np.log(values), np.log(residual), np.log(penalty)
    if criterion == "discrepancy":
        order = np.argsort(log_residual)
        noise = np.log(estimate_spectrum(x, dt).noise_std)
        return float(np.exp(np.interp(noise, log_residual[order], log_value[order])))
    first = np.gradient(log_residual, log_value), np.gradient(log_penalty, log_value)
    second = np.gradient(first[0], log_value), np.gradient(first[1], log_value)
    speed = first[0] ** 2 + first[1] ** 2
    curvature = (first[0] * second[1] - first[1] * second[0]) / np.maximum(speed, np.finfo(float).tiny) ** 1.5
    return values[1 + int(np.argmax(np.abs(curvature[1:-1])))]
