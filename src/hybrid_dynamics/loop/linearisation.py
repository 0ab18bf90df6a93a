"""The runs reduced to products of columns, as of one model: what fits and scores of all terms are linear in.

Columns that follow the load or the torque are those of the model with certain effects; the target is what is left for
the columns to explain. Both belong to a point. A linearisation is a value: every change makes another one, which shares
what has stayed (columns, the products of whole joints, sums over folds).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.loop.blocks import Folds, Indices
from hybrid_dynamics.loop.columns import Columns, Moving
from hybrid_dynamics.loop.gram import BlockGrams
from hybrid_dynamics.loop.layout import Layout
from hybrid_dynamics.loop.problem import Problem
from hybrid_dynamics.loop.sums import FoldSums
from hybrid_dynamics.types import Array

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Linearisation:
    """``columns`` and ``target`` (K, n) [N m] per run over the rows ``mask`` (K, n), and the products of both.

    Of the terms that follow a model those in ``fresh`` have the columns of the starting model with ``effects``; of the
    others nothing may be asked before :meth:`refreshed`. ``gram``: per joint and block, of all columns and, as the last
    one, the target; ``sums``: of these over ``folds``.
    """

    columns: Columns
    mask: tuple[Mask, ...]
    folds: Folds
    target: tuple[Array, ...]
    effects: tuple[Effect, ...]
    fresh: frozenset[Term]
    moving: Moving
    gram: tuple[BlockGrams, ...]
    sums: FoldSums

    @classmethod
    def of(cls, problem: Problem, terms: Sequence[Term]) -> Linearisation:
        """Of the starting model, with columns of ``terms``."""
        columns = Columns.of(problem, terms)
        following = columns.following
        moving = columns.following_model([], following, columns.nothing_moving())
        mask = tuple(run.mask for run in problem.runs)
        gram = _products(columns, moving, problem.base_target, mask)
        sums = FoldSums.of(gram, problem.folds)
        return cls(columns, mask, problem.folds, problem.base_target, (), frozenset(following), moving, gram, sums)

    @property
    def problem(self) -> Problem:
        """What never changes."""
        return self.columns.problem

    @cached_property
    def count(self) -> Array:
        """(blocks, n) rows that count."""
        blocks = self.folds.blocks
        rows = zip(blocks.run, blocks.rows, strict=True)
        return np.array([self.mask[r][low:high].sum(axis=0) for r, (low, high) in rows], float)

    # -- other values -----------------------------------------------------------------------------------------------
    def folded(self, folds: Folds) -> Linearisation:
        """The same with other folds."""
        return replace(self, folds=folds, sums=FoldSums.of(self.gram, folds))

    def without_rows(self, run: int, rows: slice, joint: int | None = None) -> Linearisation:
        """The same where ``rows`` of run number ``run`` count no more, on ``joint`` or on all."""
        mask = tuple(m.copy() if r == run else m for r, m in enumerate(self.mask))
        mask[run][rows, slice(None) if joint is None else joint] = False
        gram = _products(self.columns, self.moving, self.target, mask)
        return replace(self, mask=mask, gram=gram, sums=FoldSums.of(gram, self.folds))

    def adding(self, terms: Sequence[Term]) -> Linearisation:
        """The same with the columns of ``terms`` (those not there yet)."""
        columns = self.columns.adding(terms)
        if columns is self.columns:
            return self
        following = [term for term in columns.following if term not in self.columns]
        moving = columns.following_model(self.effects, following, self.moving)
        fresh = self.fresh.union(following)
        out = replace(self, columns=columns, moving=moving, fresh=fresh)
        gram, changed = list(self.gram), dict[int, Indices | None]()
        for j, (old, new) in enumerate(zip(self.columns.size, columns.size, strict=True)):
            if new > old:
                added = np.arange(old, new)
                gram[j] = gram[j].grown(out._products_of(j, added), np.intersect1d(added, columns.moving[j]))
                changed[j] = None
        return replace(out, gram=tuple(gram), sums=self.sums.renewed(gram, changed)) if changed else out

    def at(self, effects: Sequence[Effect]) -> Linearisation:
        """The same with columns that follow a model as of the starting model with ``effects``, once asked for."""
        if tuple(effects) == self.effects:
            return self
        alike = (
            frozenset(t for t in self.fresh if _follows_bodies_alone(t)) if _same_bodies(effects, self.effects) else ()
        )
        return replace(self, effects=tuple(effects), fresh=frozenset(alike))

    def refreshed(self, terms: Collection[Term]) -> Linearisation:
        """The same where also ``terms`` have the columns of :attr:`effects`."""
        out, changed = self._with_columns(terms)
        return out._replaced(changed)

    def with_target(self, target: Sequence[Array]) -> Linearisation:
        """The same with another ``target`` (K, n) [N m] per run."""
        if all(new is old for new, old in zip(target, self.target, strict=True)):
            return self
        last = {j: np.array([size]) for j, size in enumerate(self.columns.size)}
        return replace(self, target=tuple(target))._replaced(last)

    def tangent(self, effects: Sequence[Effect], left: Sequence[Array], layout: Layout, x: Array) -> Linearisation:
        """At the starting model with ``effects``, exact at the coordinates ``x`` of ``layout``, where these leave
        ``left`` (K, n) [N m] of every run: target = left + columns x."""
        out, changed = self.at(effects)._with_columns(layout.following)
        torque = out.columns.linear(layout, x, out.moving)
        target = tuple(own + part for own, part in zip(left, torque, strict=True))
        every = {j: np.append(changed.get(j, np.zeros(0, int)), size) for j, size in enumerate(self.columns.size)}
        return replace(out, target=target)._replaced(every)

    def _with_columns(self, terms: Collection[Term]) -> tuple[Linearisation, dict[int, Indices]]:
        """With columns of ``terms`` of :attr:`effects`, but with products as they were; of which joints and columns
        these are others now."""
        stale = [term for term in self.columns.following if term in terms and term not in self.fresh]
        if not stale:
            return self, {}
        moving = self.columns.following_model(self.effects, stale, self.moving)
        changed: dict[int, Indices] = {}
        for j in range(self.problem.n):
            places = [where for term in stale if (where := self.columns.where(term)[j]) is not None]
            if places:
                changed[j] = np.concatenate(places)
        return replace(self, moving=moving, fresh=self.fresh.union(stale)), changed

    def _replaced(self, changed: Mapping[int, Indices]) -> Linearisation:
        """The same with new products where ``changed``: of each such joint the columns, or the target as the last."""
        if not changed:
            return self
        gram = list(self.gram)
        for j, columns in changed.items():
            gram[j] = gram[j].replaced(columns, self._products_of(j, columns))
        return replace(self, gram=tuple(gram), sums=self.sums.renewed(gram, changed))

    def _products_of(self, j: int, columns: Indices) -> Array:
        """(blocks, c, p + 1) products of ``columns`` (c,) of joint ``j`` (the target is the last one) with all."""
        blocks, size = self.folds.blocks, self.columns.size[j]
        out = np.empty((len(blocks), len(columns), size + 1))
        counted = [self._counted(r, j, columns) for r in range(len(self.mask))]
        for b, (low, high) in enumerate(blocks.rows):
            r, rows = blocks.run[b], slice(low, high)
            own = counted[r][:, rows]
            out[b, :, :-1] = self.columns.times(own, r, j, self.moving, rows)
            out[b, :, -1] = own @ self.target[r][rows, j]
        return out

    def _counted(self, r: int, j: int, columns: Indices) -> Array:
        """``columns`` (c,) of joint ``j``, the target behind the last one, in run number ``r``, (c, K): 0 in rows that
        do not count."""
        own = np.empty((len(columns), len(self.target[r])))
        of_target = columns == self.columns.size[j]
        own[~of_target] = self.columns.pick(r, j, columns[~of_target], self.moving).T
        own[of_target] = self.target[r][:, j]
        own[:, ~self.mask[r][:, j]] = 0.0
        return own


def _follows_bodies_alone(term: Term) -> bool:
    kind = term.family()
    return kind.uses_body and not (kind.uses_load or kind.uses_torque)


def _same_bodies(some: Sequence[Effect], others: Sequence[Effect]) -> bool:
    """True where both change the rigid body alike."""
    one, other = ([e for e in effects if family(e.effect).changes_body] for effects in (some, others))
    return one == other


def _products(
    columns: Columns, moving: Moving, target: Sequence[Array], mask: Sequence[Mask]
) -> tuple[BlockGrams, ...]:
    """Products of all columns and, as the last one, the ``target``, per joint and block, over rows of ``mask``."""
    blocks, out = columns.problem.blocks, []
    for j, size in enumerate(columns.size):
        gram = np.zeros((len(blocks), size + 1, size + 1))
        for b, (low, high) in enumerate(blocks.rows):
            r, rows = blocks.run[b], slice(low, high)
            own = columns.pick(r, j, np.arange(size), moving, rows)
            counted = np.column_stack([own, target[r][rows, j]])[mask[r][rows, j]]
            gram[b] = counted.T @ counted
        out.append(BlockGrams.of(gram, columns.moving[j]))
    return tuple(out)
