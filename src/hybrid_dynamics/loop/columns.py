"""Smoothed columns of candidate terms, per run and joint: what a fit of them is linear in."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.effects.base import acts_in, whole_of
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
class _Made:
    """Columns of terms in one run as of the starting model: of a term and a joint on which it has a torque their
    ``names``, digests under which ``rows`` (K,) holds those that follow no model, and the ``largest`` magnitude."""

    names: dict[tuple[Term, int], list[bytes]]
    rows: dict[bytes, Array]
    largest: dict[tuple[Term, int], float]

    @classmethod
    def of(cls, problem: Problem, r: int, terms: Sequence[Term]) -> _Made:
        """Those of ``terms`` in run number ``r``; what is there more than once is held once."""
        made = cls({}, {}, {})
        still = problem.motion(r, [], [term for term in terms if not follows(term)])
        start = problem.motion(r, [], [term for term in terms if follows(term)])
        for term in terms:
            columns = problem.smoothed(term, r, start if follows(term) else still)
            if columns is None:
                continue
            for j in range(problem.n) if columns.ndim == 3 else [term.index]:
                own = columns if columns.ndim == 2 else columns[:, j]
                made.largest[term, j] = float(np.abs(own).max(initial=0.0))
                made.names[term, j] = names = [b""] * own.shape[1]
                if follows(term):
                    continue
                for k, column in enumerate(own.T):
                    names[k] = hashlib.sha256(column.tobytes()).digest()
                    made.rows.setdefault(names[k], column.copy())
        return made


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
    #: Of every run and joint (size,), which column holds what a column is in this run: another one where a term acts in
    #: some runs alone and is there for all as well, -1 where it does not act in this one; else itself.
    _held: tuple[tuple[Indices, ...], ...]
    #: A search asks for the same combinations again and again.
    _indices: dict[Layout, list[tuple[Indices, Indices]]] = field(default_factory=dict)

    @classmethod
    def of(cls, problem: Problem, terms: Sequence[Term]) -> Columns:
        """Those of ``terms``."""
        n, none = problem.n, np.zeros(0, int)
        held = ((none,) * n,) * len(problem.runs)
        return cls(problem, (), (0,) * n, (none,) * n, {}, (), ({},) * n, held).adding(terms)

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
        parts = [term for term in asked if not follows(term) and whole_of(term) != term]
        if parts:
            rest = [term for term in asked if term not in parts]
            return self.adding([*map(whole_of, parts), *rest])._adding_parts(parts)
        if not asked:
            return self
        problem, n = self.problem, self.problem.n
        made = [_Made.of(problem, r, asked) for r in range(len(problem.runs))]
        size, moving, known = list(self.size), [list(m) for m in self.moving], [dict(k) for k in self._known]
        where = dict(self._where)
        index: list[list[int]] = [[] for _ in range(n)]
        #: Of every new column its names, one a run.
        taken: list[list[list[bytes]]] = [[] for _ in range(n)]
        for term in asked:
            own: list[Indices | None] = []
            for j in range(n):
                count = max(len(run.names.get((term, j), ())) for run in made)
                if max(run.largest.get((term, j), 0.0) for run in made) < 1e-9:
                    own.append(None)
                    continue
                if follows(term):
                    places = np.arange(size[j], size[j] + count)
                    moving[j] += places.tolist()
                    size[j] += count
                else:
                    places = np.empty(count, int)
                    for k in range(count):
                        names = [run.names[term, j][k] for run in made]
                        places[k] = known[j].setdefault(b"".join(names), size[j])
                        if places[k] == size[j]:
                            size[j] += 1
                            index[j].append(int(places[k]))
                            taken[j].append(names)
                own.append(places)
            where[term] = tuple(own)
        chunks = self._chunks
        if any(index):
            rows = []
            for r, run in enumerate(problem.runs):
                none = np.empty((len(run.time), 0))
                held = made[r].rows
                rows.append(tuple(np.column_stack([none, *(held[names[r]] for names in taken[j])]) for j in range(n)))
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
            tuple(tuple(_longer(own, new) for own, new in zip(held, size, strict=True)) for held in self._held),
            self._indices.copy(),
        )

    def _adding_parts(self, terms: Sequence[Term]) -> Columns:
        """These and those of ``terms`` that act in some runs alone; the same terms for all runs are there, so that no
        column is held twice."""
        size, where = list(self.size), dict(self._where)
        held = [list(of_run) for of_run in self._held]
        for term in terms:
            own: list[Indices | None] = []
            for j, whole in enumerate(self._where[whole_of(term)]):
                own.append(None if whole is None else np.arange(size[j], size[j] + len(whole)))
                if whole is not None:
                    size[j] += len(whole)
                    for run, of_run in zip(self.problem.runs, held, strict=True):
                        source = of_run[j][whole] if acts_in(term.options, run.name) else np.full(len(whole), -1)
                        of_run[j] = np.append(of_run[j], source)
            where[term] = tuple(own)
        return replace(
            self,
            terms=(*self.terms, *terms),
            size=tuple(size),
            _where=where,
            _held=tuple(map(tuple, held)),
            _indices=self._indices.copy(),
        )

    def following_model(self, effects: Sequence[Effect], terms: Sequence[Term], old: Moving) -> Moving:
        """The moving columns ``old`` with those of ``terms`` as the starting model with ``effects`` makes them.

        ``old`` may be of fewer terms: columns that are in neither are 0.
        """
        problem = self.problem
        out = []
        for r, run in enumerate(problem.runs):
            motion = problem.motion(r, effects, terms)
            new = {term: problem.smoothed(term, r, motion) for term in terms}
            rows = []
            for j in range(problem.n):
                own = [(term, where) for term in terms if (where := self._where[term][j]) is not None]
                have = old[r][j]
                missing = len(self.moving[j]) - have.shape[1]
                if own or missing:
                    have = np.hstack([have, np.zeros((len(run.time), missing))])
                for term, where in own:
                    part = new[term]
                    at = np.searchsorted(self.moving[j], where)
                    have[:, at] = 0.0 if part is None else part[:, j] if part.ndim == 3 else part
                rows.append(have)
            out.append(tuple(rows))
        return tuple(out)

    def nothing_moving(self) -> Moving:
        """No moving columns: where :meth:`following_model` begins."""
        return tuple(tuple(np.empty((len(run.time), 0)) for _ in range(self.problem.n)) for run in self.problem.runs)

    # -- reading ----------------------------------------------------------------------------------------------------
    def pick(self, r: int, j: int, columns: Indices, moving: Moving, rows: slice = slice(None)) -> Array:
        """``columns`` (c,) of joint ``j`` in ``rows`` of run number ``r``, (K, c)."""
        held = self._held[r][j][columns]
        out = np.zeros((len(self.problem.runs[r].time[rows]), len(columns)))
        at = np.full(self.size[j], -1)
        for index, part in self._parts(r, j, moving):
            at[index] = np.arange(len(index))
            mine = np.flatnonzero((held >= 0) & (at[held] >= 0))
            out[:, mine] = part[rows][:, at[held[mine]]]
            at[index] = -1
        return out

    def times(self, left: Array, r: int, j: int, moving: Moving, rows: slice) -> Array:
        """(c, p) products of ``left`` (c, K) with all columns of joint ``j`` in ``rows`` of run number ``r``."""
        out = np.zeros((len(left), self.size[j]))
        for index, part in self._parts(r, j, moving):
            out[:, index] = left @ part[rows]
        held = self._held[r][j]
        elsewhere = np.flatnonzero(held != np.arange(len(held)))
        if len(elsewhere):
            out[:, elsewhere] = np.where(held[elsewhere] >= 0, out[:, held[elsewhere]], 0.0)
        return out

    def linear(self, layout: Layout, x: Array, moving: Moving) -> list[Array]:
        """Columns times coordinates: torque (K, n) [N m] in every run."""
        out = [np.zeros((len(run.time), self.problem.n)) for run in self.problem.runs]
        for j, (position, column) in enumerate(self.indices(layout)):
            # Two terms may share a column: what they ask of it adds up.
            for r, torque in enumerate(out):
                held = self._held[r][j][column]
                acting = held >= 0
                weight = np.bincount(held[acting], x[position[acting]], minlength=self.size[j])
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
        """All columns of joint ``j`` that are held for run number ``r`` in pieces: their index (p,) and rows (K, p)."""
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


def _longer(held: Indices, size: int) -> Indices:
    """``held`` with what comes up to ``size``: itself."""
    return np.append(held, np.arange(len(held), size))
