"""The runs reduced to products of columns, as of one model: what fits and scores of all terms are linear in.

Columns that follow the load or the torque are those of the model with certain effects; the target is what is left for
the columns to explain. Both belong to a point. A linearisation is a value: every change makes another one, which shares
what has stayed (columns, the products of whole joints, sums over folds).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby

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
#: A run's number and some of its rows.
_Part = tuple[int, slice]


@dataclass(frozen=True)
class Linearisation:
    """``columns`` and ``target`` (K, n) [N m] per run over the rows ``mask`` (K, n), and the products of both.

    Of the terms that follow a model those in ``fresh`` have the columns of the starting model with ``effects``; of the
    others nothing may be asked before :meth:`refreshed`. ``gram``: per joint and block, of all columns and, as the last
    one, the target; ``sums``: of these over ``folds``; ``at_rest``: the same per joint and run, over rows ``resting``
    (K, n) in which the joint stands.
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
    resting: tuple[Mask, ...]
    at_rest: tuple[BlockGrams, ...]

    @classmethod
    def of(cls, problem: Problem, terms: Sequence[Term]) -> Linearisation:
        """Of the starting model, with columns of ``terms``."""
        columns = Columns.of(problem, terms)
        following = columns.following
        moving = columns.following_model([], following, columns.nothing_moving())
        mask = tuple(run.mask for run in problem.runs)
        target, resting = problem.base_target, problem.resting.rows
        gram = _products(columns, moving, target, mask, _in_blocks(problem.folds))
        sums = FoldSums.of(gram, problem.folds)
        at_rest = _products(columns, moving, target, resting, _whole(problem))
        fresh = frozenset(following)
        return cls(columns, mask, problem.folds, target, (), fresh, moving, gram, sums, resting, at_rest)

    def holding_links(self, share: float) -> Linearisation:
        """The same products of a problem that holds all links, as a name, within ``share`` of what is plausible."""
        return replace(self, columns=replace(self.columns, problem=self.problem.holding_links(share)))

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

    @cached_property
    def rest(self) -> tuple[Array | None, ...]:
        """Per joint the sum (p + 1, p + 1) of :attr:`at_rest` over all runs; None where the joint never stands."""
        stands = np.any([own.any(axis=0) for own in self.resting], axis=0)
        return tuple(
            gram.totals(np.ones((1, len(self.resting))))[0] if own else None
            for gram, own in zip(self.at_rest, stands, strict=True)
        )

    # -- other values -----------------------------------------------------------------------------------------------
    def folded(self, folds: Folds) -> Linearisation:
        """The same with other folds."""
        return replace(self, folds=folds, sums=FoldSums.of(self.gram, folds))

    def without_rows(self, run: int, rows: slice, joint: int | None = None) -> Linearisation:
        """The same where ``rows`` of run number ``run`` count no more, on ``joint`` or on all."""
        joints = slice(None) if joint is None else joint
        mask, resting = (
            tuple(m.copy() if r == run else m for r, m in enumerate(own)) for own in (self.mask, self.resting)
        )
        mask[run][rows, joints] = resting[run][rows, joints] = False
        gram = _products(self.columns, self.moving, self.target, mask, _in_blocks(self.folds))
        at_rest = _products(self.columns, self.moving, self.target, resting, _whole(self.problem))
        sums = FoldSums.of(gram, self.folds)
        return replace(self, mask=mask, gram=gram, sums=sums, resting=resting, at_rest=at_rest)

    def adding(self, terms: Sequence[Term]) -> Linearisation:
        """The same with the columns of ``terms`` (those not there yet)."""
        columns = self.columns.adding(terms)
        if columns is self.columns:
            return self
        following = [term for term in columns.following if term not in self.columns]
        moving = columns.following_model(self.effects, following, self.moving)
        fresh = self.fresh.union(following)
        out = replace(self, columns=columns, moving=moving, fresh=fresh)
        gram, at_rest, changed = list(self.gram), list(self.at_rest), dict[int, Indices | None]()
        for j, (old, new) in enumerate(zip(self.columns.size, columns.size, strict=True)):
            if new > old:
                added = np.arange(old, new)
                moves = np.intersect1d(added, columns.moving[j])
                gram[j] = gram[j].grown(out._in_motion(j, added), moves)
                at_rest[j] = at_rest[j].grown(out._at_rest(j, added), moves)
                changed[j] = None
        if not changed:
            return out
        return replace(out, gram=tuple(gram), sums=self.sums.renewed(gram, changed), at_rest=tuple(at_rest))

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
        gram, at_rest = list(self.gram), list(self.at_rest)
        for j, columns in changed.items():
            gram[j] = gram[j].replaced(columns, self._in_motion(j, columns))
            at_rest[j] = at_rest[j].replaced(columns, self._at_rest(j, columns))
        return replace(self, gram=tuple(gram), sums=self.sums.renewed(gram, changed), at_rest=tuple(at_rest))

    def _in_motion(self, j: int, columns: Indices) -> Array:
        """(blocks, c, p + 1) products of ``columns`` (c,) of joint ``j`` (the target is the last one) with all."""
        return self._products_of(j, columns, self.mask, _in_blocks(self.folds))

    def _at_rest(self, j: int, columns: Indices) -> Array:
        """(runs, c, p + 1), the same over the rows in which the joint stands."""
        return self._products_of(j, columns, self.resting, _whole(self.problem))

    def _products_of(self, j: int, columns: Indices, mask: Sequence[Mask], parts: Sequence[_Part]) -> Array:
        out = np.zeros((len(parts), len(columns), self.columns.size[j] + 1))
        # Run by run, as the parts are: columns of all of them at once would be most of the memory.
        for r, of_run in groupby(enumerate(parts), key=lambda part: part[1][0]):
            counted = self._counted(r, j, columns, mask[r][:, j])
            if counted is None:
                continue
            for b, (_, rows) in of_run:
                out[b, :, :-1] = self.columns.times(counted[:, rows], r, j, self.moving, rows)
                out[b, :, -1] = counted[:, rows] @ self.target[r][rows, j]
        return out

    def _counted(self, r: int, j: int, columns: Indices, mask: Mask) -> Array | None:
        """``columns`` (c,) of joint ``j``, the target behind the last one, in run number ``r``, (c, K): 0 in rows that
        do not count; None where none does."""
        if not mask.any():
            return None
        own = np.empty((len(columns), len(self.target[r])))
        of_target = columns == self.columns.size[j]
        own[~of_target] = self.columns.pick(r, j, columns[~of_target], self.moving).T
        own[of_target] = self.target[r][:, j]
        own[:, ~mask] = 0.0
        return own


def _follows_bodies_alone(term: Term) -> bool:
    kind = term.family()
    return kind.uses_body and not (kind.uses_load or kind.uses_torque)


def _same_bodies(some: Sequence[Effect], others: Sequence[Effect]) -> bool:
    """True where both change the rigid body alike."""
    one, other = ([e for e in effects if family(e.effect).changes_body] for effects in (some, others))
    return one == other


def _in_blocks(folds: Folds) -> list[_Part]:
    return [(r, slice(*rows)) for r, rows in zip(folds.blocks.run, folds.blocks.rows, strict=True)]


def _whole(problem: Problem) -> list[_Part]:
    return [(r, slice(0, len(run.time))) for r, run in enumerate(problem.runs)]


def _products(
    columns: Columns, moving: Moving, target: Sequence[Array], mask: Sequence[Mask], parts: Sequence[_Part]
) -> tuple[BlockGrams, ...]:
    """Products of all columns and, as the last one, the ``target``, per joint and part of a run, over rows of
    ``mask``."""
    out = []
    for j, size in enumerate(columns.size):
        gram = np.zeros((len(parts), size + 1, size + 1))
        for b, (r, rows) in enumerate(parts):
            if not mask[r][rows, j].any():
                continue
            own = columns.pick(r, j, np.arange(size), moving, rows)
            counted = np.column_stack([own, target[r][rows, j]])[mask[r][rows, j]]
            gram[b] = counted.T @ counted
        out.append(BlockGrams.of(gram, columns.moving[j]))
    return tuple(out)
