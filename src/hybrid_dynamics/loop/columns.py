"""Smoothed columns of candidate terms, per run and joint: what a fit of them is linear in."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop.layout import Layout, follows, make_room
from hybrid_dynamics.loop.problem import Problem
from hybrid_dynamics.types import Array

Indices = NDArray[np.int_]
#: Columns that follow a model, ``[run][joint]`` (K, m), in the order of :attr:`Columns.moving`.
Moving = tuple[tuple[Array, ...], ...]


@dataclass(frozen=True)
class _Chunk:
    """Columns that were added together and follow nothing: of each joint their ``index`` (p,), and per run and joint
    ``rows`` (K, p)."""

    index: tuple[Indices, ...]
    rows: tuple[tuple[Array, ...], ...]


@dataclass(frozen=True)
class Columns:
    """Where the columns of ``terms`` stand, and those that no model changes; what two terms share stands there once.

    A value: more terms make another one (:meth:`adding`), which shares the columns that are there and numbers them
    alike. ``size`` (n,) columns of every joint; ``moving`` (m,) of every joint those that follow a model.
    """

    problem: Problem
    terms: tuple[Term, ...]
    size: tuple[int, ...]
    moving: tuple[Indices, ...]
    _where: Mapping[Term, tuple[Indices | None, ...]]
    _chunks: tuple[_Chunk, ...]
    _known: tuple[Mapping[bytes, int], ...]
    #: A search asks for the same combinations again and again.
    _indices: dict[Layout, list[tuple[Indices, Indices]]] = field(default_factory=dict)

    @classmethod
    def of(cls, problem: Problem, terms: Sequence[Term]) -> Columns:
        """Those of ``terms``."""
        n, none = problem.n, np.zeros(0, int)
        return cls(problem, (), (0,) * n, (none,) * n, {}, (), ({},) * n).adding(terms)

    def __contains__(self, term: Term) -> bool:
        return term in self._where

    @property
    def following(self) -> tuple[Term, ...]:
        """Those of the terms whose columns follow a model."""
        return tuple(term for term in self.terms if follows(term))

    def where(self, term: Term) -> tuple[Indices | None, ...]:
        """Of every joint, which columns are those of ``term``; None where it has no torque."""
        return self._where[term]

    def acts(self, term: Term) -> NDArray[np.bool_]:
        """(n,) on which joints ``term`` has a torque."""
        return np.array([where is not None for where in self._where[term]])

    # -- building ---------------------------------------------------------------------------------------------------
    def adding(self, terms: Sequence[Term]) -> Columns:
        """These and the columns of ``terms`` (those not there yet)."""
        asked = [term for term in dict.fromkeys(terms) if term not in self]
        if not asked:
            return self
        problem, n = self.problem, self.problem.n
        still = problem.motions([], [term for term in asked if not follows(term)])
        start = problem.motions([], [term for term in asked if follows(term)])
        size, moving, known = list(self.size), [list(m) for m in self.moving], [dict(k) for k in self._known]
        where = dict(self._where)
        index: list[list[int]] = [[] for _ in range(n)]
        parts: list[list[list[Array]]] = [[[] for _ in range(n)] for _ in problem.runs]
        for term in asked:
            columns = problem.smoothed(term, start if follows(term) else still)
            own: list[Indices | None] = []
            for j in range(n):
                mine = [p if p.ndim == 2 else p[:, j] for p in columns]
                acts = columns[0].ndim == 3 or term.joint == j
                if not acts or max(float(np.abs(o).max(initial=0.0)) for o in mine) < 1e-9:
                    own.append(None)
                elif follows(term):
                    places = np.arange(size[j], size[j] + mine[0].shape[1])
                    own.append(places)
                    moving[j] += places.tolist()
                    size[j] += len(places)
                else:
                    places, new = _places(mine, known[j], size[j])
                    own.append(places)
                    index[j] += range(size[j], size[j] + len(new))
                    size[j] += len(new)
                    for held, o in zip(parts, mine, strict=True):
                        if new:
                            held[j].append(o[:, new])
            where[term] = tuple(own)
        chunks = self._chunks
        if any(index):
            rows = []
            for run, held in zip(problem.runs, parts, strict=True):
                rows.append(tuple(np.hstack([np.empty((len(run.time), 0)), *held[j]]) for j in range(n)))
                held.clear()
            chunks = (*chunks, _Chunk(tuple(np.array(i, int) for i in index), tuple(rows)))
        return Columns(
            problem,
            (*self.terms, *asked),
            tuple(size),
            tuple(np.array(m, int) for m in moving),
            where,
            chunks,
            tuple(known),
            self._indices.copy(),
        )

    def following_model(self, effects: Sequence[Effect], terms: Sequence[Term], old: Moving) -> Moving:
        """The moving columns ``old`` with those of ``terms`` as the starting model with ``effects`` makes them.

        ``old`` may be of fewer terms: columns that are in neither are 0.
        """
        problem = self.problem
        motions = problem.motions(effects, terms)
        new = {term: problem.smoothed(term, motions) for term in terms}
        out = []
        for r, run in enumerate(problem.runs):
            rows = []
            for j in range(problem.n):
                own = [(term, where) for term in terms if (where := self._where[term][j]) is not None]
                have = old[r][j]
                missing = len(self.moving[j]) - have.shape[1]
                if own or missing:
                    have = np.hstack([have, np.zeros((len(run.time), missing))])
                for term, where in own:
                    part = new[term][r]
                    have[:, np.searchsorted(self.moving[j], where)] = part[:, j] if part.ndim == 3 else part
                rows.append(have)
            out.append(tuple(rows))
        return tuple(out)

    def nothing_moving(self) -> Moving:
        """No moving columns: where :meth:`following_model` begins."""
        return tuple(tuple(np.empty((len(run.time), 0)) for _ in range(self.problem.n)) for run in self.problem.runs)

    # -- reading ----------------------------------------------------------------------------------------------------
    def pick(self, r: int, j: int, columns: Indices, moving: Moving, rows: slice = slice(None)) -> Array:
        """``columns`` (c,) of joint ``j`` in ``rows`` of run number ``r``, (K, c)."""
        out = np.empty((len(self.problem.runs[r].time[rows]), len(columns)))
        at = np.full(self.size[j], -1)
        for index, part in self._parts(r, j, moving):
            at[index] = np.arange(len(index))
            mine = np.flatnonzero(at[columns] >= 0)
            out[:, mine] = part[rows][:, at[columns[mine]]]
            at[index] = -1
        return out

    def times(self, left: Array, r: int, j: int, moving: Moving, rows: slice) -> Array:
        """(c, p) products of ``left`` (c, K) with all columns of joint ``j`` in ``rows`` of run number ``r``."""
        out = np.empty((len(left), self.size[j]))
        for index, part in self._parts(r, j, moving):
            out[:, index] = left @ part[rows]
        return out

    def linear(self, layout: Layout, x: Array, moving: Moving) -> list[Array]:
        """Columns times coordinates: torque (K, n) [N m] in every run."""
        out = [np.zeros((len(run.time), self.problem.n)) for run in self.problem.runs]
        for j, (position, column) in enumerate(self.indices(layout)):
            # Two terms may share a column: what they ask of it adds up.
            weight = np.bincount(column, x[position], minlength=self.size[j])
            for r, torque in enumerate(out):
                for index, part in self._parts(r, j, moving):
                    own = np.flatnonzero(weight[index])
                    if len(own):
                        torque[:, j] += part @ weight[index]
        return out

    def project(self, term: Term, torque: Sequence[Array], moving: Moving) -> Array:
        """Products (p,) of the columns of ``term`` with ``torque`` (K, n) per run, over all joints."""
        out = np.zeros(term.size)
        for j, where in enumerate(self._where[term]):
            if where is not None:
                for r, own in enumerate(torque):
                    out += own[:, j] @ self.pick(r, j, where, moving)
        return out

    def _parts(self, r: int, j: int, moving: Moving) -> list[tuple[Indices, Array]]:
        """All columns of joint ``j`` in run number ``r`` in pieces: their index (p,) and rows (K, p)."""
        still = [(chunk.index[j], chunk.rows[r][j]) for chunk in self._chunks if len(chunk.index[j])]
        return [*still, (self.moving[j], moving[r][j])] if len(self.moving[j]) else still

    def indices(self, layout: Layout) -> list[tuple[Indices, Indices]]:
        """Per joint: positions in x and columns of the joint."""
        if layout not in self._indices:
            make_room(self._indices)
            self._indices[layout] = [self._positions(layout, j) for j in range(self.problem.n)]
        return self._indices[layout]

    def _positions(self, layout: Layout, joint: int) -> tuple[Indices, Indices]:
        position: list[int] = []
        column: list[int] = []
        for term, start in zip(layout.terms, layout.starts, strict=True):
            where = self._where[term][joint]
            if where is not None:
                position.extend(range(start, start + len(where)))
                column.extend(where)
        return np.array(position, int), np.array(column, int)


def _places(parts: Sequence[Array], known: dict[bytes, int], size: int) -> tuple[Indices, list[int]]:
    """Places of the columns ``parts`` (one array a run) among those ``known`` by digest, and which of them are new.

    New ones come behind ``size`` others, and are known from then on.
    """
    index: list[int] = []
    new: list[int] = []
    for k in range(parts[0].shape[1]):
        digest = hashlib.sha256(b"".join(p[:, k].tobytes() for p in parts)).digest()
        if digest not in known:
            known[digest] = size + len(new)
            new.append(k)
        index.append(known[digest])
    return np.array(index, int), new
