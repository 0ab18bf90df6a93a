"""SINDy: a sparse polynomial of the features, found by PySINDy's STLSQ on a triangular factor in bounded memory.

With Theta the library (N, p) and Y the torque (N, n), a triangular R with ``R'R = [Theta Y]'[Theta Y]`` lets
``|Theta w - y| = |R_theta w - R_y|`` for every w, so STLSQ (ridge steps and unbiased last fit) sees the same problem in
p + n rows. R comes from moments summed chunk by chunk (:mod:`.moments`); the library never stands in memory.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.exceptions import ConvergenceWarning

from hybrid_dynamics.engine import Engine, Local
from hybrid_dynamics.errors import needs_extra, require
from hybrid_dynamics.features import feature_names
from hybrid_dynamics.models.base import Weights, check_data, check_features
from hybrid_dynamics.models.factor import Factor
from hybrid_dynamics.models.moments import CACHED_ROWS, Chunk, InMemory, factors_of, moments, monomials
from hybrid_dynamics.types import Array, Progress

if TYPE_CHECKING:
    import sympy as sp

#: Columns that vary less than this are not scaled.
_SMALLEST_STD = 1e-9


@dataclass(frozen=True)
class SindySettings:
    """The paper's settings by default (Section "Methods compared").

    ``scaled`` divides every library column and the target by its standard deviation before thresholding; then
    ``threshold`` is a share of the target's standard deviation (1e-3 finds the true terms), not one number for
    coefficients in many units.
    """

    degree: int = 2
    threshold: float = 0.01
    alpha: float = 1e-4
    max_iter: int = 100
    scaled: bool = False
    chunk_rows: int = 12_000

    def __post_init__(self) -> None:
        require(1 <= self.degree <= 4, f"sindy.degree is {self.degree}; expected 1 to 4")
        require(0 <= self.threshold < np.inf, f"sindy.threshold is {self.threshold}; expected a number of 0 or more")
        require(0 <= self.alpha < np.inf, f"sindy.alpha is {self.alpha}; expected a number of 0 or more")
        require(self.max_iter >= 1, f"sindy.max_iter is {self.max_iter}; expected 1 or more")
        require(self.chunk_rows >= 1, f"sindy.chunk_rows is {self.chunk_rows}; expected 1 or more")


def factorize(X: Array, y: Array, settings: SindySettings) -> Factor:
    """Reduce ``X`` (N, 7n) and ``y`` (N, n) [N m] to the factor that :meth:`SindyEstimator.fit_factor` takes."""
    X, y = check_data(X, y)
    powers = np.asarray(_library(settings.degree, X.shape[1]).powers_)
    rows = settings.chunk_rows
    chunks = [InMemory(X[k : k + rows], y[k : k + rows]) for k in range(0, len(X), rows)]
    return _factor(chunks, powers, settings, Local())


def factorize_chunks(
    chunks: Sequence[Chunk], features: int, settings: SindySettings, engine: Engine | None = None
) -> Factor:
    """The factor of data that need not fit into memory: ``chunks`` of ``features`` columns, read where ``engine`` runs.

    The same chunks give the same factor, to the last bit, on every engine and any number of workers.
    """
    powers = np.asarray(_library(settings.degree, features).powers_)
    return _factor(chunks, powers, settings, engine or Local())


def _factor(chunks: Sequence[Chunk], powers: NDArray[np.int64], settings: SindySettings, engine: Engine) -> Factor:
    found = moments(chunks, powers, settings.chunk_rows, engine)
    width = len(powers)
    return Factor(found.R[:, :width], found.R[:, width:], found.rows, powers.astype(np.int64), found.variance)


def _library(degree: int, features: int) -> Any:
    """PySINDy's polynomial library over ``features`` columns. Imported where it is used: PySINDy takes a second."""
    with needs_extra("study", "SINDy"):
        from pysindy.feature_library import PolynomialLibrary

    return PolynomialLibrary(degree=degree).fit(np.zeros((1, features)))


class SindyEstimator(RegressorMixin, BaseEstimator):
    """Sparse polynomial torque model of all joints.

    Learned: ``coef_`` (n, p) in physical units, ``powers_`` (p, 7n) exponents of the library terms, ``names_``.
    """

    settings_type: ClassVar[type] = SindySettings
    engine = "stlsq"

    def __init__(self, settings: SindySettings | None = None, progress: Progress | None = None) -> None:
        self.settings = settings
        self.progress = progress

    def fit(self, X: Array, y: Array, variance: Array | None = None) -> Self:
        """Fit to ``X`` (N, 7n) and ``y`` (N, n) [N m].

        With ``scaled`` the target is divided by the square root of ``variance`` (n,), the variance of the whole torque
        (default: of ``y``): a coefficient of a small residual need not be as fine as the residual is small.
        """
        factor = factorize(X, y, self.settings or SindySettings())
        return self.fit_factor(factor if variance is None else replace(factor, variance=np.asarray(variance, float)))

    def fit_factor(self, factor: Factor) -> Self:
        """Fit to data that :func:`factorize` has reduced; the same coefficients as :meth:`fit`."""
        with needs_extra("study", "SINDy"):
            from pysindy.optimizers import STLSQ

        settings = self.settings or SindySettings()
        self.n_joints_ = factor.n_joints
        self.names_ = feature_names(self.n_joints_)
        self._set_powers(factor.powers)
        theta, target = factor.theta, factor.torque
        width = theta.shape[1]
        columns, torque = np.ones(width), np.ones(self.n_joints_)
        if settings.scaled:
            columns, torque = factor.spread()[0], np.sqrt(factor.variance)
            columns[columns < _SMALLEST_STD] = 1.0
            torque[torque < _SMALLEST_STD] = 1.0
        optimizer = STLSQ(
            threshold=settings.threshold,
            alpha=settings.alpha,
            max_iter=settings.max_iter,
            # Only the first iterate's support counts, and it is the whole library; this saves a least-squares fit.
            initial_guess=np.zeros((self.n_joints_, width)),
        )
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            optimizer.fit(theta / columns, target / torque)
        self.converged_ = not any(issubclass(w.category, ConvergenceWarning) for w in caught)
        self.coef_ = np.asarray(optimizer.coef_) * torque[:, None] / columns
        self._activate()
        return self

    def set_terms(self, terms: Sequence[Sequence[tuple[str, float]]], converged: bool) -> None:
        """Take (term name, coefficient) lists, one per joint, as what was learned; the names as :meth:`term_names`."""
        self.n_joints_ = len(terms)
        self.names_ = feature_names(self.n_joints_)
        self._set_powers(np.asarray(_library((self.settings or SindySettings()).degree, len(self.names_)).powers_))
        position = {name: k for k, name in enumerate(self.term_names())}
        self.coef_ = np.zeros((self.n_joints_, len(position)))
        for joint, pairs in enumerate(terms):
            for name, value in pairs:
                self.coef_[joint, position[name]] = value
        self.converged_ = converged
        self._activate()

    def _set_powers(self, powers: NDArray[np.int64]) -> None:
        self.powers_ = powers
        self._factors = factors_of(powers)

    def _activate(self) -> None:
        self._active = np.flatnonzero(np.any(self.coef_ != 0, axis=0))

    def predict(self, X: Array) -> Array:
        """(N, n) [N m]; only the library columns in use are computed, in chunks."""
        X = check_features(X, self.n_joints_)
        out = np.zeros((len(X), self.n_joints_))
        if not len(self._active):
            return out
        coefficients = np.ascontiguousarray(self.coef_[:, self._active].T)
        factors = self._factors[self._active]
        for start in range(0, len(X), CACHED_ROWS):
            chunk = slice(start, start + CACHED_ROWS)
            out[chunk] = monomials(X[chunk], factors) @ coefficients
        return out

    def term_names(self) -> list[str]:
        """SymPy-readable name of each library term: ``1``, ``q1``, ``q1*dq2``, ``q1**2``."""
        return [term_name(exponents, self.names_) for exponents in self.powers_]

    def expressions(self) -> list[sp.Expr]:
        """One polynomial per joint, over symbols named as the features."""
        import sympy as sp

        symbols = [sp.Symbol(name) for name in self.names_]
        out = []
        for row in self.coef_:
            terms = []
            for k in np.flatnonzero(row):
                factors = [symbols[i] ** int(e) for i, e in enumerate(self.powers_[k]) if e]
                terms.append(sp.Mul(sp.Float(row[k]), *factors))
            out.append(sp.Add(*terms))
        return out

    def front(self) -> list[dict[str, Any]]:
        """Empty: there is one polynomial a joint."""
        return []

    def document(self, weights: Weights, path: str) -> dict[str, Any]:
        """See :class:`LayerEstimator`."""
        names = self.term_names()
        terms = [[{"term": names[k], "coefficient": float(row[k])} for k in np.flatnonzero(row)] for row in self.coef_]
        return {
            "kind": "sindy",
            "joints": self.n_joints_,
            "settings": asdict(self.settings or SindySettings()),
            "converged": self.converged_,
            "terms": terms,
        }

    @classmethod
    def from_document(cls, document: dict[str, Any], weights: Weights) -> Self:
        """See :class:`LayerEstimator`."""
        estimator = cls(SindySettings(**document["settings"]))
        terms = [[(str(t["term"]), float(t["coefficient"])) for t in joint] for joint in document["terms"]]
        estimator.set_terms(terms, bool(document["converged"]))
        return estimator


def term_name(exponents: NDArray[np.int64], names: tuple[str, ...]) -> str:
    """``q1*dq2**2`` for the exponents of one monomial, ``1`` for the constant."""
    parts = [names[i] if e == 1 else f"{names[i]}**{e}" for i, e in enumerate(exponents) if e]
    return "*".join(parts) or "1"
