"""The data of one loop reduced to what selection needs: Gram matrices per joint and block of time.

For every joint the smoothed columns of all candidate terms, and the torque that the starting model leaves, become one
Gram matrix per block. Fits, held-out errors and block-wise uncertainty of any combination of terms follow from sums of
these, so a candidate costs about a millisecond, whatever the length of the logs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop.blocks import Indices, folds_by_time, folds_of
from hybrid_dynamics.loop.columns import Columns, model_in
from hybrid_dynamics.loop.gram import BlockGrams
from hybrid_dynamics.loop.held import Held, residual_vector
from hybrid_dynamics.loop.jackknife import covariance_of
from hybrid_dynamics.loop.layout import Layout, make_room, term_order
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.physics import physical_constraints
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.loop.solve import Constraints, solve, solve_bounded
from hybrid_dynamics.loop.sums import FoldSums
from hybrid_dynamics.types import Array

#: Beside a gain of all joints, links may change by no more than about this multiple of the starting model's torque.
MULTIPLE = 1e-3
#: Weight of a surface that coordinates must lie on, against the data.
STIFF = 1e4


class Evidence:
    """Gram matrices of the training runs for a list of terms, with respect to a starting model."""

    def __init__(self, base: Model, runs: Sequence[Run], terms: Sequence[Term], settings: LoopSettings) -> None:
        self.base, self.runs, self.settings = base, list(runs), settings
        #: Rows that count, per run (K, n): where the joint moves and nothing disturbs it.
        self.mask = [run.mask.copy() for run in self.runs]
        self.robot = base.completed_robot
        self.n = self.robot.n_joints
        self.weights = np.ones(self.n)
        # What follows from the terms alone: a search asks for the same ones again and again.
        self._priors: dict[Term, Array] = {}
        self._indices: dict[Layout, list[tuple[Indices, Indices]]] = {}
        self._constraints: dict[Layout, Constraints] = {}
        self._multiples: dict[Layout, Array] = {}
        self.columns = Columns(base, runs)
        #: Products of all columns and, as the last one, the target, per joint.
        self.gram: list[BlockGrams] = []
        self._cache: dict[tuple[frozenset[Term], bool], Held] = {}
        self.base_target = self.exact([])
        self._base_places: dict[Term, Array] = {}
        for effect in base.effects:
            term = effect.term(base.robot)
            if term.family().scope == "joint":
                own = term.family().coordinates_of(effect.parameters, base.robot, term)
                self._base_places[term] = self._base_places.get(term, np.zeros(len(own))) + own
        #: Fastest speed of every joint in the runs (n,) [rad/s].
        self.fastest = np.max([np.abs(run.dq).max(axis=0) for run in self.runs], axis=0)
        self.target = [t.copy() for t in self.base_target]
        self._moved = False
        self.folds = self._first_folds = folds_of(self.runs, settings)
        self.blocks = self.folds.blocks
        self.add_terms(terms)

    @staticmethod
    def predict_fine(model: Model, run: Run) -> Array:
        """Prediction at the states of the run, not yet smoothed (M, n)."""
        m = run.motion
        return model.predict(m.q, m.dq, m.ddq, m.time)

    @property
    def base_torque(self) -> list[Array]:
        """Smoothed torque (K, n) [N m] of the starting model in every run."""
        return [run.tau - left for run, left in zip(self.runs, self.base_target, strict=True)]

    # -- building ---------------------------------------------------------------------------------------------------
    def fold_by_run(self) -> None:
        """The folds of the beginning again."""
        self.folds = self._first_folds
        self._sum()

    def fold_by_time(self) -> None:
        """Fold anew: contiguous parts of every run in turn, so that every run is in every fit."""
        self.folds = folds_by_time(self.blocks, self.settings.time_folds)
        self._sum()

    def add_terms(self, terms: Sequence[Term]) -> None:
        """Compute and append the columns of ``terms`` (those not there yet)."""
        grown = self.columns.add(terms)
        if not self.gram:
            self._reduce()
        elif grown:
            for j in grown:
                old, size = self.gram[j].size, self.columns.size(j) + 1
                self.gram[j] = self.gram[j].grown(size)
                self._multiply(j, np.arange(old - 1, size - 1))
                self.sums.renew(j, self.gram[j])
            self._cache = {}

    def renew(self, effects: Sequence[Effect], terms: Sequence[Term]) -> None:
        """Columns of ``terms`` that follow the load or the model's torque anew, see :meth:`Columns.renew`."""
        for j, columns in self.columns.renew(effects, terms).items():
            self._multiply(j, columns)
            self.sums.renew_columns(j, self.gram[j], columns)
            self._cache = {}

    def leave_out(self, run: int, rows: slice) -> None:
        """Let ``rows`` of run number ``run`` count no more."""
        self.mask[run][rows] = False
        self._multiples = {}
        self._reduce()

    def _reduce(self) -> None:
        self.gram = [self._joint_gram(j) for j in range(self.n)]
        self.count = np.array(
            [
                self.mask[r][low:high].sum(axis=0)
                for r, (low, high) in zip(self.blocks.run, self.blocks.rows, strict=True)
            ],
            float,
        )
        self.samples = self.count.sum(axis=0)
        self._sum()

    def _joint_gram(self, j: int) -> BlockGrams:
        size = self.columns.rows[0][j].shape[1] + 1
        gram = np.zeros((len(self.blocks.rows), size, size))
        for b in range(len(gram)):
            rows = self._counted(j, b)
            gram[b] = rows.T @ rows
        return BlockGrams.of(gram)

    def _counted(self, j: int, b: int) -> Array:
        """Columns of joint ``j`` and, as the last one, its target, over the rows of block ``b`` that count."""
        r, (low, high) = self.blocks.run[b], self.blocks.rows[b]
        rows = np.column_stack([self.columns.rows[r][j][low:high], self.target[r][low:high, j]])
        return np.asarray(rows[self.mask[r][low:high, j]])

    def _multiply(self, j: int, columns: Indices) -> None:
        """Renew the products of ``columns`` of joint ``j`` with all its columns and the target."""
        rows = [run[j] for run in self.columns.rows]
        counted = [np.where(mask[:, [j]], own[:, columns], 0.0) for mask, own in zip(self.mask, rows, strict=True)]
        products = np.empty((len(self.blocks), len(columns), self.gram[j].size))
        for b, (low, high) in enumerate(self.blocks.rows):
            r = self.blocks.run[b]
            own = counted[r][low:high].T
            products[b, :, :-1], products[b, :, -1] = own @ rows[r][low:high], own @ self.target[r][low:high, j]
        self.gram[j].put(columns, products)

    def _retarget(self) -> None:
        """Renew what depends on the target in the Gram matrices."""
        for j, gram in enumerate(self.gram):
            for b, (low, high) in enumerate(self.blocks.rows):
                r = self.blocks.run[b]
                target = np.where(self.mask[r][low:high, j], self.target[r][low:high, j], 0.0)
                gram.last[b, :-1] = target @ self.columns.rows[r][j][low:high]
                gram.last[b, -1] = target @ target
            self.sums.renew_columns(j, gram, np.array([gram.size - 1]))
        self._cache = {}

    def _sum(self) -> None:
        self._cache = {}
        self.sums = FoldSums(self.gram, self.folds)

    def weigh(self, floor: Array) -> None:
        """Weigh the joints in every fit and score by ``floor`` (n,) [N m]; one without a floor counts nothing."""
        seen = floor > 0
        self.weights = np.where(seen, 1.0 / np.where(seen, floor, 1.0) ** 2, 0.0)
        self._cache, self._multiples = {}, {}

    def exact(self, effects: Sequence[Effect]) -> list[Array]:
        """Torque (K, n) [N m] of every run that the starting model with ``effects``, laws as they are, leaves."""
        models = [model_in(self.base, effects, run) for run in self.runs]
        fine = [m.recorded(self.columns.torques(m, r)[1], self.runs[r].motion.time) for r, m in enumerate(models)]
        return [run.tau - run.smooth(own) for run, own in zip(self.runs, fine, strict=True)]

    def relinearise(self, left: Sequence[Array], terms: Sequence[Term], x: Array) -> None:
        """Make the linear problem exact at ``x``, where ``terms`` leave ``left``: target = left + columns x.

        (Gauss-Newton with columns that stay.)
        """
        self._moved = True
        self.target = [own + part for own, part in zip(left, self.linear(terms, x), strict=True)]
        self._retarget()

    def reset(self) -> None:
        """The target of the beginning again: for models that are linear."""
        if not self._moved:
            return
        self._moved = False
        self.target = [t.copy() for t in self.base_target]
        self._retarget()

    def linear(self, terms: Sequence[Term], x: Array) -> list[Array]:
        """Columns times coordinates: torque (K, n) [N m] of ``terms`` in every run."""
        return self.columns.linear(self.layout(terms), x)

    def residuals(self, terms: Sequence[Term], x: Array) -> list[Array]:
        """What ``terms`` at ``x`` leave of the target (K, n) [N m] in every run."""
        return [t - part for t, part in zip(self.target, self.linear(terms, x), strict=True)]

    def squared_error(self, left: Sequence[Array]) -> float:
        """Weighted squared sum, in squared floors, of residuals ``left`` (K, n) [N m] of every run: rows that count."""
        sums = sum(np.sum(np.where(m, r, 0.0) ** 2, axis=0) for m, r in zip(self.mask, left, strict=True))
        return float(sums @ self.weights)

    def acts(self, term: Term) -> NDArray[np.bool_]:
        """(n,) on which joints ``term`` has a torque."""
        return self.columns.acts(term)

    # -- solving ----------------------------------------------------------------------------------------------------
    def layout(self, terms: Sequence[Term]) -> Layout:
        """Where the coordinates of ``terms`` stand in x."""
        return Layout.of(terms)

    def indices(self, layout: Layout) -> list[tuple[Indices, Indices]]:
        """Per joint: positions in x and columns in the joint's Gram matrix."""
        return self.columns.indices(layout)

    def constraints(self, layout: Layout) -> Constraints:
        """What physics asks of the coordinates of ``layout``."""
        if layout not in self._constraints:
            make_room(self._constraints)
            self._constraints[layout] = physical_constraints(
                layout.terms, layout.starts, layout.total, self._base_places, self.robot, self.fastest
            )
        return self._constraints[layout]

    def has(self, term: Term) -> bool:
        """True where the columns of ``term`` are there."""
        return term in self.columns

    def in_base(self, term: Term) -> bool:
        """True where the starting model has an effect at ``term``."""
        return term in self._base_places

    def normal(self, layout: Layout, grams: Sequence[Array]) -> tuple[Array, Array]:
        """Weighted normal equations with the weak prior; ``grams``: the sum of some blocks, per joint."""
        a, b = self._normals(layout, [gram[None] for gram in grams])
        return a[0], b[0]

    def _normals(self, layout: Layout, grams: Sequence[Array]) -> tuple[Array, Array]:
        """The same for several sums at once: ``grams`` (m, size, size) per joint; returns (m, K, K) and (m, K)."""
        size, many = layout.total, len(grams[0])
        a, b = np.zeros((many, size * size)), np.zeros((many, size))
        for j, (position, column) in enumerate(self.indices(layout)):
            if len(position):
                gram = grams[j].reshape(many, -1)
                width = grams[j].shape[1]
                # Flat places: picking by rows and columns takes several times as long.
                picked = gram.take((column[:, None] * width + column).ravel(), axis=1)
                a[:, (position[:, None] * size + position).ravel()] += self.weights[j] * picked
                b[:, position] += self.weights[j] * grams[j][:, column, -1]
        a[:, :: size + 1] += self.prior(layout)
        return a.reshape(many, size, size) + self._defined(layout), b

    def _defined(self, layout: Layout) -> Array | float:
        """What makes a gain of all joints beside all links' parameters one number (K, K); 0 where there are not both.

        The two can make the same torque. The gain is the multiple of the starting model's torque that is nearest to
        the recorded one: what the links change is held orthogonal to that torque.
        """
        gain = any(t.joint is None and t.family().shared for t in layout.terms)
        links = [t for t in layout.terms if t.family().all_links]
        if not gain or not links:
            return 0.0
        if layout not in self._multiples:
            make_room(self._multiples)
            own = self.base_torque
            weighted = [m * self.weights * o for m, o in zip(self.mask, own, strict=True)]
            size = max(sum(float(np.sum(w * o)) for w, o in zip(weighted, own, strict=True)), 1e-300)
            along = self.columns.project(layout, links, weighted) / size
            self._multiples[layout] = np.outer(along, along) / MULTIPLE**2
        return self._multiples[layout]

    def prior(self, layout: Layout) -> Array:
        """(p,): one over the square of what a coordinate of ``layout`` may plausibly be."""
        return np.concatenate([np.zeros(0), *(self._prior(term) for term in layout.terms)])

    def _prior(self, term: Term) -> Array:
        """Weight (p,) that holds the coordinates of ``term`` to zero."""
        if term not in self._priors:
            self._priors[term] = 1.0 / term.family().prior_scale(self.robot, term) ** 2
        return self._priors[term]

    def fit(self, terms: Sequence[Term], grams: Sequence[Array] | None = None, physical: bool = True) -> Array:
        """Coordinates of ``terms``, jointly, on the sum of blocks ``grams`` (default: all)."""
        layout = self.layout(terms)
        if layout.total == 0:
            return np.zeros(0)
        a, b = self.normal(layout, self.sums.full if grams is None else grams)
        return self._solved(layout, a, b, self.constraints(layout), physical)

    def _solved(self, layout: Layout, a: Array, b: Array, constraints: Constraints, physical: bool) -> Array:
        """Coordinates under ``constraints``; those that must lie on a surface are held to its tangent plane, twice."""
        full = physical and not layout.on_surfaces
        x = solve(a, b, constraints) if full else solve_bounded(a, b, constraints.lower)
        for _ in range(2 if layout.on_surfaces else 0):
            stiff, target = a.copy(), b.copy()
            for term, start in layout.on_surfaces:
                own = slice(start, start + term.size)
                normal, value = term.family().surface(x[own], self.robot, term)
                weight = STIFF * float(np.diag(a)[own].max())
                stiff[own, own] += weight * np.outer(normal, normal)
                target[own] += weight * value * normal
            x = solve(stiff, target, constraints) if physical else solve_bounded(stiff, target, constraints.lower)
        return x

    def errors(self, terms: Sequence[Term], x: Array, blocks: NDArray[np.bool_] | None = None) -> Array:
        """Squared residual sums (blocks, n) [N m]^2 of coordinates ``x``."""
        chosen = slice(None) if blocks is None else blocks
        vectors = [
            residual_vector(p, x, g.size) for p, g in zip(self.indices(self.layout(terms)), self.gram, strict=True)
        ]
        forms = [gram.forms(v, v, chosen) for gram, v in zip(self.gram, vectors, strict=True)]
        return np.maximum(np.column_stack(forms), 0.0)

    def held(self, terms: Sequence[Term], physical: bool = False) -> Held:
        """Held-out prediction by ``terms``: fits under bounds alone, or with bodies and friction held ``physical``."""
        key = frozenset(terms), physical
        if key not in self._cache:
            layout = self.layout(sorted(key[0], key=term_order))
            constraints = self.constraints(layout)
            a, b = self._normals(layout, self.sums.others)
            folds = [
                self._solved(layout, a[f], b[f], constraints, physical) if layout.total else np.zeros(0)
                for f in range(self.folds.number)
            ]
            self._cache[key] = Held(self, self.indices(layout), folds)
        return self._cache[key]

    def constrained(self, terms: Sequence[Term]) -> bool:
        """True where the fit of ``terms`` under bounds alone asks for a body or a friction that cannot exist."""
        constraints = self.constraints(self.layout(terms))
        if not constraints.coupled:
            return False
        x = self.fit(terms, physical=False)
        return not constraints.satisfied(np.maximum(x, constraints.lower))

    def held_out_all_rows(self, terms: Sequence[Term], joint: int) -> float:
        """Held-out squared residual sum [N m]^2 of ``joint`` over all rows, standing ones too; fits see moving ones."""
        total = 0.0
        for f in range(self.folds.number):
            torque = self.linear(terms, self.fit(terms, [gram[f] for gram in self.sums.others]))
            for b in self.folds.own[f]:
                r, (low, high) = self.blocks.run[b], self.blocks.rows[b]
                total += float(np.sum((self.target[r][low:high, joint] - torque[r][low:high, joint]) ** 2))
        return total

    def covariance(self, terms: Sequence[Term], x: Array) -> Array:
        """Covariance of ``x``, every block of time left out in turn (:mod:`.jackknife`)."""
        layout = self.layout(terms)
        parts, scores = self.by_block(layout, x, self.weights)
        return covariance_of(self.normal(layout, self.sums.full)[0], parts, scores, self.blocks.run)

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
