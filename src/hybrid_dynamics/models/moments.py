"""Second moments of a polynomial library: one pass over the data, chunk by chunk, in half the work of a QR.

Least squares needs ``G = A'A`` of ``A = [Theta Y]`` alone, and sums of chunks may be taken anywhere in any number of
processes. But forming ``A'A`` squares the condition of ``A``, which for raw monomials is hopeless: ``q**2`` of a joint
that stays near 1.5 rad is its ``q`` once more. The span of all monomials up to a degree does not change under
``x -> (x - mean) / scale``, so the moments are taken of the standardised features, whose monomials are as independent
as the motion allows, and the triangular factor of the raw library follows exactly: ``A = A~ T`` with known ``T``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, eigh
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from hybrid_dynamics.engine import Engine
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.types import Array

#: Rows whose library columns stay in the processor's cache: four times as fast as thousands at a time.
CACHED_ROWS = 512


class Chunk(Protocol):
    """A part of the data that a process reads where it is: features (m, 7n) and torque (m, n)."""

    def read(self) -> tuple[Array, Array]:
        """Features (N, m) and target (N, n)."""


@dataclass(frozen=True)
class InMemory:
    """Data that stands in memory: ``X`` (m, 7n), ``y`` (m, n)."""

    X: Array
    y: Array

    def read(self) -> tuple[Array, Array]:
        """Features (N, m) and target (N, n)."""
        return self.X, self.y


@dataclass(frozen=True)
class Moments:
    """What a least-squares fit needs: ``R`` (p + n, p + n) triangular with ``R'R = A'A``, rows, variance of y (n,)."""

    R: Array
    rows: int
    variance: Array


def factors_of(powers: NDArray[np.int64]) -> NDArray[np.int64]:
    """(p, degree) columns to multiply for each monomial of ``powers`` (p, f); column f stands for ones."""
    degree = max(int(powers.sum(axis=1).max()), 1)
    out = np.full((len(powers), degree), powers.shape[1])
    for term, exponents in enumerate(powers):
        used = np.repeat(np.arange(len(exponents)), exponents)
        out[term, : len(used)] = used
    return out


def monomials(X: Array, factors: NDArray[np.int64]) -> Array:
    """(m, p) products of the columns of ``X`` (m, f) that :func:`factors_of` lists."""
    extended = np.column_stack([X, np.ones(len(X))])
    out = extended[:, factors[:, 0]]
    for k in range(1, factors.shape[1]):
        out *= extended[:, factors[:, k]]
    return out


def moments(chunks: Sequence[Chunk], powers: NDArray[np.int64], chunk_rows: int, engine: Engine) -> Moments:
    """Moments of the library ``powers`` (p, f) and the torque over ``chunks``, summed in their order.

    The result depends on the chunks and ``chunk_rows`` (rows a product), not on the engine or its number of workers.
    Raises :class:`InputError` where there is no sample.
    """
    rows, total, squares = 0, np.zeros(1), np.zeros(1)
    for count, one, two in engine.map(_sums, chunks):
        rows, total, squares = rows + count, total + one, squares + two
    if rows == 0:
        raise InputError("no sample to factorise; expected at least one")
    mean = total / rows
    scale = np.sqrt(np.maximum(squares / rows - mean**2, 0.0))
    scale[scale <= 1e-9 * np.abs(mean)] = 1.0  # a constant: any scale will do
    gram = np.zeros((1, 1))
    product = partial(_gram, mean=mean, scale=scale, factors=factors_of(powers), rows=chunk_rows)
    for part in engine.map(product, chunks):
        gram = gram + part
    n = len(mean) - powers.shape[1]
    variance = np.diag(gram)[-n:] / rows - (gram[-n:, 0] / rows) ** 2
    with threadpool_limits(1, user_api="blas"):
        R = np.linalg.qr(_root(gram) @ _from_standardised(powers, mean, scale), mode="r")
    return Moments(np.asarray(R), rows, variance * scale[-n:] ** 2)


def _sums(chunk: Chunk) -> tuple[int, Array, Array]:
    both = np.column_stack(chunk.read())
    return len(both), both.sum(axis=0), np.einsum("ij,ij->j", both, both)


def _gram(chunk: Chunk, mean: Array, scale: Array, factors: NDArray[np.int64], rows: int) -> Array:
    """Lower triangle of A~'A~ of one chunk; its first column belongs to the constant."""
    X, y = chunk.read()
    split, width = X.shape[1], len(factors)
    columns = width + y.shape[1]
    out = np.zeros((columns, columns), order="F")
    work = np.empty((min(rows, len(X)), columns))
    # One thread: the order of summation, and with it the last digits, must not depend on the machine.
    with threadpool_limits(1, user_api="blas"):
        for start in range(0, len(X), rows):
            x = (X[start : start + rows] - mean[:split]) / scale[:split]
            for inner in range(0, len(x), CACHED_ROWS):
                block = slice(inner, min(inner + CACHED_ROWS, len(x)))
                work[block, :width] = monomials(x[block], factors)
            work[: len(x), width:] = (y[start : start + rows] - mean[split:]) / scale[split:]
            out = blas.dsyrk(1.0, work[: len(x)].T, beta=1.0, c=out, lower=1, overwrite_c=1)
    return out


def _root(gram: Array) -> Array:
    """Square root ``W`` with ``W'W = gram`` (lower triangle given), of columns scaled to one.

    Directions below what rounding leaves of the largest are dependences of the library and get nothing.
    """
    size = np.sqrt(np.diag(gram))
    size[size == 0] = 1.0
    values, vectors = eigh(gram / size / size[:, None], lower=True, overwrite_a=True, check_finite=False)
    values[values < 4 * np.finfo(float).eps * values[-1]] = 0.0
    return np.asarray(np.sqrt(values)[:, None] * vectors.T * size)


def _from_standardised(powers: NDArray[np.int64], mean: Array, scale: Array) -> Array:
    """(p + n, p + n) ``T`` with ``[Theta Y] = [Theta~ Y~] T``: monomials of x = mean + scale x~, multiplied out."""
    place: dict[tuple[int, ...], int] = {
        tuple(int(f) for f in np.repeat(np.arange(powers.shape[1]), row)): k for k, row in enumerate(powers)
    }
    out = np.zeros((len(powers) + len(mean) - powers.shape[1],) * 2)
    for used, column in place.items():
        terms: dict[tuple[int, ...], float] = {(): 1.0}
        for feature in used:
            grown: dict[tuple[int, ...], float] = {}
            for term, value in terms.items():
                grown[term] = grown.get(term, 0.0) + value * mean[feature]
                longer = (*term, feature)  # features come in ascending order, so the key is sorted
                grown[longer] = grown.get(longer, 0.0) + value * scale[feature]
            terms = grown
        for term, value in terms.items():
            out[place[term], column] = value
    for k in range(len(powers), len(out)):
        feature = powers.shape[1] + k - len(powers)
        out[place[()], k], out[k, k] = mean[feature], scale[feature]
    return out
