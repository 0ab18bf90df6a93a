"""The data of one loop reduced to what selection needs: Gram matrices per joint and block of time.

For every joint the smoothed columns of all candidate terms, and the torque that the starting model leaves, become one
Gram matrix per block. Fits, held-out errors and block-wise uncertainty of any combination of terms follow from sums of
these, so a candidate costs about a millisecond, whatever the length of the logs.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop.blocks import Blocks, Folds, Indices, folds_by_time
from hybrid_dynamics.loop.gram import BlockGrams
from hybrid_dynamics.loop.held import Held, change_by_block, residual_vector
from hybrid_dynamics.loop.jackknife import covariance_of
from hybrid_dynamics.loop.layout import Layout, make_room, term_order
from hybrid_dynamics.loop.linearisation import Linearisation, Mask
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.problem import Problem
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.loop.solve import Constraints, solve_all, solve_bounded
from hybrid_dynamics.loop.sums import FoldSums, picked
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: Beside a gain of all joints, links may change by no more than about this multiple of the starting model's torque.
MULTIPLE = 1e-3
#: Weight of a surface that coordinates must lie on, against the data. Along it they stay where they were, too, in
#: directions that the data hardly determines: a plane is met by a way far along it, where the surface has bent off.
STIFF, HELD_ALONG = 1e4, 1e-6
#: A combination of terms, and whether bodies and friction are held physical.
_Asked = tuple[frozenset[Term], bool]


class Evidence:
    """What the training runs say of any terms, as of one linearisation, with joints weighed by ``weights`` (n,).

    A value. Whatever is asked of it, and whatever other models are fitted in between, gives the same numbers: to weigh,
    to fold, to leave out rows, to add columns or to stand at another model makes another value, which shares what has
    stayed. What is kept of answers (and the columns of candidates that follow the model, which are made when somebody
    asks for them) spares time and changes nothing.
    """

    def __init__(self, linearisation: Linearisation, weights: Array, at_rest: Array) -> None:
        self.problem: Problem = linearisation.problem
        self.weights = weights
        #: (n,) of every row in which a joint stands.
        self._at_rest = at_rest
        weights.flags.writeable = at_rest.flags.writeable = False
        self._linear = linearisation
        #: Held-out predictions of terms that follow no model: the same at every point with this target.
        self._still: dict[_Asked, Held] = {}
        self._following: dict[_Asked, Held] = {}
        self._multiples: dict[Term, Array] = {}

    @classmethod
    def of(cls, base: Model, runs: Sequence[Run], terms: Sequence[Term], settings: LoopSettings) -> Evidence:
        """Of ``runs`` at the starting model ``base``, with columns of ``terms`` and joints weighed alike."""
        problem = Problem(base, runs, settings)
        return cls(Linearisation.of(problem, terms), np.ones(problem.n), np.zeros(problem.n))

    # -- what it holds ----------------------------------------------------------------------------------------------
    @property
    def base(self) -> Model:
        """The starting model."""
        return self.problem.base

    @property
    def robot(self) -> Robot:
        """The starting model's, its bodies as far as they are known."""
        return self.problem.robot

    @property
    def runs(self) -> tuple[Run, ...]:
        """The training runs."""
        return self.problem.runs

    @property
    def settings(self) -> LoopSettings:
        """As the loop was asked."""
        return self.problem.settings

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.problem.n

    @property
    def blocks(self) -> Blocks:
        """The runs in blocks of time."""
        return self._linear.folds.blocks

    @property
    def folds(self) -> Folds:
        """What is held out together."""
        return self._linear.folds

    @property
    def mask(self) -> tuple[Mask, ...]:
        """Rows that count, per run (K, n): where the joint moves and nothing disturbs it."""
        return self._linear.mask

    @property
    def target(self) -> tuple[Array, ...]:
        """Torque (K, n) [N m] per run that the columns of terms are to explain."""
        return self._linear.target

    @property
    def count(self) -> Array:
        """(blocks, n) rows that count."""
        return self._linear.count

    @property
    def samples(self) -> Array:
        """(n,) rows that count."""
        return np.asarray(self.count.sum(axis=0))

    @property
    def terms(self) -> tuple[Term, ...]:
        """Those whose columns are there."""
        return self._linear.columns.terms

    @property
    def gram(self) -> tuple[BlockGrams, ...]:
        """Products of columns and, as the last one, the target, per joint: of terms whose :meth:`indices` were asked
        for."""
        return self._linear.gram

    @property
    def sums(self) -> FoldSums:
        """The same over all blocks and over folds."""
        return self._linear.sums

    def has(self, term: Term) -> bool:
        """True where the columns of ``term`` are there."""
        return term in self._linear.columns

    def in_base(self, term: Term) -> bool:
        """True where the starting model has an effect at ``term``."""
        return term.as_finding in self.problem.base_places

    def acts(self, term: Term) -> NDArray[np.bool_]:
        """(n,) on which joints ``term`` has a torque."""
        return self._linear.columns.acts(term)

    # -- other values -----------------------------------------------------------------------------------------------
    def weigh(self, floor: Array) -> Evidence:
        """With joints weighed in every fit and score by ``floor`` (n,) [N m]; one without a floor counts nothing."""
        seen = floor > 0
        weights = np.where(seen, 1.0 / np.where(seen, floor, 1.0) ** 2, 0.0)
        return Evidence(self._linear, weights, self.problem.resting.weights(floor))

    def holding_links(self, share: float) -> Evidence:
        """Where all links, as a name, are held within ``share`` of what is plausible of them."""
        if share == self.problem.links_within:
            return self
        return Evidence(self._linear.holding_links(share), self.weights, self._at_rest)

    def fold_by_time(self) -> Evidence:
        """Folded anew: parts of every run in turn, so that every run is in every fit."""
        folds = folds_by_time(self.runs, self.blocks, self.settings.time_folds)
        return Evidence(self._linear.folded(folds), self.weights, self._at_rest)

    def leave_out(self, run: int, rows: slice, joint: int | None = None) -> Evidence:
        """Where ``rows`` of run number ``run`` count no more, on ``joint`` or on all."""
        return Evidence(self._linear.without_rows(run, rows, joint), self.weights, self._at_rest)

    def adding(self, terms: Sequence[Term]) -> Evidence:
        """With the columns of ``terms`` (those not there yet)."""
        linear = self._linear.adding(terms)
        if linear is self._linear:
            return self
        out = Evidence(linear, self.weights, self._at_rest)
        # Columns have kept their numbers. What is added here another value may number otherwise: copies.
        out._still, out._following = self._still.copy(), self._following.copy()
        out._multiples = self._multiples.copy()
        return out

    def at(self, effects: Sequence[Effect], terms: Sequence[Term] = ()) -> Evidence:
        """At the starting model with ``effects``, those of a linear model: what the starting model leaves is the
        target, and columns that follow the load or the torque are of this model. Those of ``terms`` are made at once.
        """
        following = self.layout(terms).following
        linear = self._linear.at(effects).with_target(self.problem.base_target).refreshed(following)
        if linear is self._linear:
            return self
        out = Evidence(linear, self.weights, self._at_rest)
        out._multiples = self._multiples
        if linear.target is self._linear.target:
            out._still = self._still
        return out

    def with_base_target(self) -> Evidence:
        """With what the starting model leaves as the target, and columns as they are."""
        return self.at(self._linear.effects)

    def tangent(self, effects: Sequence[Effect], left: Sequence[Array], terms: Sequence[Term], x: Array) -> Evidence:
        """The linear problem that is exact at ``x``, where ``effects``, those of ``terms``, leave ``left`` (K, n) [N m]
        of every run: target = left + columns x (Gauss-Newton)."""
        out = Evidence(self._linear.tangent(effects, left, self.layout(terms), x), self.weights, self._at_rest)
        out._multiples = self._multiples
        return out

    # -- torques ----------------------------------------------------------------------------------------------------
    def linear(self, terms: Sequence[Term], x: Array) -> list[Array]:
        """Columns times coordinates: torque (K, n) [N m] of ``terms`` in every run."""
        layout = self.layout(terms)
        self._ready(layout.following)
        return self._linear.columns.linear(layout, x, self._linear.moving)

    def residuals(self, terms: Sequence[Term], x: Array) -> list[Array]:
        """What ``terms`` at ``x`` leave of the target (K, n) [N m] in every run."""
        return [t - part for t, part in zip(self.target, self.linear(terms, x), strict=True)]

    def squared_error(self, left: Sequence[Array]) -> float:
        """Weighted squared sum, in squared floors, of residuals ``left`` (K, n) [N m] of every run: over rows that
        count, and those at rest as much as they do."""
        out = 0.0
        for rows, weights in ((self.mask, self.weights), (self._linear.resting, self._at_rest)):
            sums = sum(np.sum(np.where(m, r, 0.0) ** 2, axis=0) for m, r in zip(rows, left, strict=True))
            out += float(sums @ weights)
        return out

    def columns_of(self, joint: int, columns: Indices | None = None) -> list[Array]:
        """``columns`` (c,) of ``joint``, or all, in every run (K, c); of terms whose :meth:`indices` were asked for."""
        if columns is None:
            self._ready(frozenset(self.terms))
            columns = np.arange(self._linear.columns.size[joint])
        own = self._linear
        return [own.columns.pick(r, joint, columns, own.moving) for r in range(len(self.runs))]

    # -- solving ----------------------------------------------------------------------------------------------------
    def layout(self, terms: Sequence[Term]) -> Layout:
        """Where the coordinates of ``terms`` stand in x."""
        return Layout.of(terms)

    def indices(self, layout: Layout) -> list[tuple[Indices, Indices]]:
        """Per joint: positions in x and columns in the joint's Gram matrix, which holds them from then on."""
        self._ready(layout.following)
        return self._linear.columns.indices(layout)

    def unit_square(self, term: Term) -> float:
        """Mean square [N m]^2 of what ``term``, of one coefficient, makes on its joint where that is one."""
        return self.square_at(term, np.ones(1))

    def square_at(self, term: Term, x: Array) -> float:
        """Mean square [N m]^2 of what ``term`` makes on its joint at coordinates ``x`` (p,)."""
        joint = term.index
        _, columns = self.indices(self.layout([term]))[joint]
        own = self.sums.full[joint][np.ix_(columns, columns)]
        return float(x @ own @ x) / max(float(self.samples[joint]), 1.0)

    def _ready(self, following: frozenset[Term]) -> None:
        """Make the columns that follow the model, where one of ``following`` is asked for the first time: all of them,
        since who asks for one goes on to others."""
        if not following <= self._linear.fresh:
            self._linear = self._linear.refreshed(self.terms)

    def constraints(self, layout: Layout) -> Constraints:
        """What physics asks of the coordinates of ``layout``."""
        return self.problem.constraints(layout)

    def prior(self, layout: Layout) -> Array:
        """(p,): one over the square of what a coordinate of ``layout`` may plausibly be."""
        return self.problem.prior(layout)

    def normal(self, layout: Layout, grams: Sequence[Array] | None = None) -> tuple[Array, Array]:
        """Weighted normal equations with the weak prior; ``grams``: per joint the sum of some blocks (default: all)."""
        self._ready(layout.following)
        a, b = self._normals(layout, [gram[None] for gram in (self.sums.full if grams is None else grams)])
        return a[0], b[0]

    def _normals(self, layout: Layout, grams: Sequence[Array]) -> tuple[Array, Array]:
        """The same for several sums at once: ``grams`` (m, size, size) per joint; returns (m, K, K) and (m, K)."""
        size, many = layout.total, len(grams[0])
        a, b = np.zeros((many, size * size)), np.zeros((many, size))
        for j, (position, column) in enumerate(self.indices(layout)):
            if len(position):
                places = (position[:, None] * size + position).ravel()
                # One after the other: adding to all at once costs half as much again.
                for own, part in zip(a, picked(grams[j], column), strict=True):
                    own[places] += self.weights[j] * part.ravel()
                b[:, position] += self.weights[j] * grams[j][:, column, -1]
                if (rest := self._linear.rest[j]) is not None:
                    b[:, position] += self._at_rest[j] * rest[column, -1]
        a[:, :: size + 1] += self.prior(layout)
        held = self._defined(layout) + self.problem.alike(layout) + self.rest_normal(layout)
        return a.reshape(many, size, size) + held, b

    def rest_normal(self, layout: Layout) -> Array:
        """(K, K): what rows at rest add to the normal matrix."""
        out = np.zeros((layout.total, layout.total))
        for j, (position, column) in enumerate(self.indices(layout)):
            if len(position) and (rest := self._linear.rest[j]) is not None:
                out[position[:, None], position] += self._at_rest[j] * rest[column[:, None], column]
        return out

    def _defined(self, layout: Layout) -> Array | float:
        """What makes a gain of all joints beside all links' parameters one number (K, K); 0 where there are not both.

        The two can make the same torque. The gain is the multiple of the starting model's torque that is nearest to
        the recorded one: what the links change is held orthogonal to that torque.
        """
        gain = any(t.joint is None and t.family().shared for t in layout.terms)
        links = [t for t in layout.terms if t.family().all_links]
        if not gain or not links:
            return 0.0
        along = np.zeros(layout.total)
        for term, start in zip(layout.terms, layout.starts, strict=True):
            if term in links:
                along[start : start + term.size] = self._along(term)
        return np.outer(along, along) / MULTIPLE**2

    def _along(self, term: Term) -> Array:
        """(p,): by how much of the starting model's torque a coordinate of ``term``, which follows no model, moves
        it."""
        if term not in self._multiples:
            own = self.problem.base_torque
            weighted = [m * self.weights * o for m, o in zip(self.mask, own, strict=True)]
            size = max(sum(float(np.sum(w * o)) for w, o in zip(weighted, own, strict=True)), 1e-300)
            self._multiples[term] = self._linear.columns.project(term, weighted, self._linear.moving) / size
        return self._multiples[term]

    def fit(self, terms: Sequence[Term], grams: Sequence[Array] | None = None, physical: bool = True) -> Array:
        """Coordinates of ``terms``, jointly, on the sum of blocks ``grams`` (default: all)."""
        layout = self.layout(terms)
        if layout.total == 0:
            return np.zeros(0)
        a, b = self.normal(layout, grams)
        return np.asarray(self._solved(layout, a[None], b[None], self.constraints(layout), physical)[0])

    def _solved(self, layout: Layout, a: Array, b: Array, constraints: Constraints, physical: bool) -> Array:
        """Coordinates (m, K) of ``a`` (m, K, K) and ``b`` (m, K) under ``constraints``; those that must lie on a
        surface are held to its tangent plane, twice."""
        full = physical and not layout.on_surfaces
        x = solve_all(a, b, constraints) if full else solve_bounded(a, b, constraints.lower)
        for last in (False, True) if layout.on_surfaces else ():
            stiff, target = a.copy(), b.copy()
            for (term, start), m in product(layout.on_surfaces, range(len(b))):
                own = slice(start, start + term.size)
                normal, value = term.family().surface(x[m, own], self.robot, term)
                size, across = float(np.diag(a[m])[own].max()), np.outer(normal, normal)
                along = np.eye(len(normal)) - across
                stiff[m, own, own] += size * (STIFF * across + HELD_ALONG * along)
                target[m, own] += size * (STIFF * value * normal + HELD_ALONG * along @ x[m, own])
            # Where the tangent plane lies bodies hardly matter.
            full = physical and last
            lower = constraints.lower
            x = solve_all(stiff, target, constraints, False) if full else solve_bounded(stiff, target, lower)
        return x

    def errors(self, terms: Sequence[Term], x: Array, blocks: NDArray[np.bool_] | None = None) -> Array:
        """Squared residual sums (blocks, n) [N m]^2 of coordinates ``x``."""
        chosen, places = slice(None) if blocks is None else blocks, self.indices(self.layout(terms))
        vectors = [residual_vector(p, x, g.size) for p, g in zip(places, self.gram, strict=True)]
        forms = [gram.forms(v, v, chosen) for gram, v in zip(self.gram, vectors, strict=True)]
        return np.maximum(np.column_stack(forms), 0.0)

    def held(self, terms: Sequence[Term], physical: bool = False) -> Held:
        """Held-out prediction by ``terms``: fits under bounds alone, or with bodies and friction held ``physical``."""
        key = frozenset(terms), physical
        if (known := self._still.get(key) or self._following.get(key)) is not None:
            return known
        layout = self.layout(sorted(key[0], key=term_order))
        places, constraints = self.indices(layout), self.constraints(layout)
        a, b = self._normals(layout, self.sums.others)
        folds = self._solved(layout, a, b, constraints, physical) if layout.total else b
        held = Held.of(self.sums, places, folds, self.weights)
        kept = self._following if layout.following else self._still
        make_room(kept)
        kept[key] = held
        return held

    def change(self, left: Held, old: Held, new: Held) -> Array:
        """Block-wise sums (blocks, n) [N m]^2 of what ``left`` leaves times the change of the prediction from ``old``
        to ``new``: held-out predictions of this value."""
        return change_by_block(left, old, new, self.gram, self.folds)

    def constrained(self, terms: Sequence[Term]) -> bool:
        """True where the fit of ``terms`` under bounds alone asks for a body or a friction that cannot exist."""
        constraints = self.constraints(self.layout(terms))
        if not constraints.coupled:
            return False
        x = self.fit(terms, physical=False)
        return not constraints.satisfied(np.maximum(x, constraints.lower))

    def held_out_on(self, terms: Sequence[Term], joint: int, rows: Sequence[Sequence[NDArray[np.bool_]]]) -> Array:
        """Held-out squared residual sums [N m]^2 of ``joint`` over each of ``rows``, (K,) of every run: also those that
        fits do not see, where it stands."""
        total = np.zeros(len(rows))
        self._ready(self.layout(terms).following)
        for f in range(self.folds.number):
            torque = self.linear(terms, self.fit(terms, [gram[f] for gram in self.sums.others]))
            for b in self.folds.own[f]:
                r, (low, high) = self.blocks.run[b], self.blocks.rows[b]
                square = (self.target[r][low:high, joint] - torque[r][low:high, joint]) ** 2
                total += [float(np.sum(square[part[r][low:high]])) for part in rows]
        return total

    def covariance(self, terms: Sequence[Term], x: Array) -> Array:
        """Covariance of ``x``: every block of time left out in turn (:mod:`.jackknife`), and rows at rest."""
        layout = self.layout(terms)
        parts, scores = self.by_block(layout, x, self.weights)
        return covariance_of(self.normal(layout)[0], parts, scores, self.blocks.run, self.rest_normal(layout))

    def by_block(self, layout: Layout, x: Array, weights: Array) -> tuple[Array, Array]:
        """Each block's share of the normal matrix (B, K, K), joints weighed by ``weights`` (n,), and its scores (B, K)
        at ``x``."""
        size, blocks = layout.total, len(self.blocks)
        parts, scores = np.zeros((blocks, size, size)), np.zeros((blocks, size))
        for j, (position, column) in enumerate(self.indices(layout)):
            if len(position):
                square = self.gram[j].pick(column, column)
                parts[:, position[:, None], position] += weights[j] * square
                scores[:, position] += weights[j] * (self.gram[j].last[:, column] - square @ x[position])
        return parts, scores
