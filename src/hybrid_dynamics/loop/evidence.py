"""The data of one loop reduced to what selection needs: Gram matrices per joint and block of time.

For every joint the smoothed columns of all candidate terms, and the torque that the starting model leaves, become one
Gram matrix per block. Fits, held-out errors and block-wise uncertainty of any combination of terms follow from sums of
these, so a candidate costs about a millisecond, whatever the length of the logs.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Effect, Motion, Term
from hybrid_dynamics.loop.gram import BlockGrams
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.physics import physical_constraints
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.loop.solve import Constraints, solve, solve_bounded
from hybrid_dynamics.types import Array

Indices = NDArray[np.int_]

#: Setting of a term that acts in one run only (an effect fitted run by run).
ONLY_RUN = "only_run"


#: A block lasts at least this many windows of the filter.
BLOCK_WINDOWS = 4.0
#: Weight of a surface that coordinates must lie on, against the data.
STIFF = 1e4
#: Share of a joint's moving rows in one run beyond which runs cannot stand in for each other.
MOST_IN_ONE = 0.8
#: Fewest blocks of time from which an uncertainty is taken, and the most that are kept.
FEWEST_BLOCKS, MOST_BLOCKS = 12, 100
#: Combinations of terms whose places and constraints are kept.
KEPT_LAYOUTS = 1000


@dataclass(frozen=True)
class Layout:
    """Where the coordinates of a combination of terms stand: ``positions[term]`` in x, size ``total``."""

    terms: tuple[Term, ...]
    starts: tuple[int, ...]
    total: int


class Held:
    """Held-out prediction of one combination of terms: every fold predicted by a fit on the others.

    ``folds[f]`` are the coordinates that the other folds gave, ``places`` where those stand among the columns of each
    joint. With the vector v of :meth:`_vector` the residual of a fold is columns @ v, so scores and block-wise products
    of residuals follow from the Gram matrices; nothing is predicted sample by sample.
    """

    def __init__(self, evidence: Evidence, places: Sequence[tuple[Indices, Indices]], folds: Sequence[Array]) -> None:
        self._evidence, self._places, self._folds = evidence, places, folds
        self.joint_errors = self._errors()

    def _vector(self, fold: int, joint: int) -> Array:
        """What turns the columns of ``joint``, its target as the last one, into the residual of ``fold``."""
        return _residual(self._places[joint], self._folds[fold], self._evidence.gram[joint].size)

    def _errors(self) -> Array:
        """(n,) squared held-out residual sums [N m]^2."""
        out = np.zeros(self._evidence.n)
        for f, grams in enumerate(self._evidence.own_sum):
            for j, gram in enumerate(grams):
                v = self._vector(f, j)
                out[j] += max(float(v @ gram @ v), 0.0)
        return out

    @cached_property
    def score(self) -> float:
        """Weighted sum of :attr:`joint_errors`."""
        return float(self.joint_errors @ self._evidence.weights)

    def change(self, old: Held, new: Held) -> Array:
        """Block-wise sums (blocks, n) [N m]^2 of this residual times the change of the prediction from ``old`` to
        ``new``."""
        evidence = self._evidence
        out = np.empty((len(evidence.block_run), evidence.n))
        for f, parts in enumerate(evidence.fold_parts):
            for j, gram in enumerate(evidence.gram):
                own, change = self._vector(f, j), old._vector(f, j) - new._vector(f, j)
                for part in parts:
                    out[part, j] = gram.forms(own, change, part)
        return out


def _residual(place: tuple[Indices, Indices], x: Array, size: int) -> Array:
    """Vector (size,) that turns the columns of a joint, the target as the last, into what coordinates ``x`` leave."""
    position, column = place
    # Two terms may share a column: what they ask of it adds up.
    v = -np.bincount(column, x[position], minlength=size).astype(float)
    v[-1] = 1.0
    return v


def _slices(index: Indices) -> list[slice]:
    """Ascending ``index`` as slices: what they select is no copy."""
    parts = np.split(index, np.flatnonzero(np.diff(index) > 1) + 1)
    return [slice(int(p[0]), int(p[-1]) + 1) for p in parts if len(p)]


def _make_room(cache: dict[Layout, Any]) -> None:
    """Drop the oldest half where ``cache`` is full."""
    if len(cache) >= KEPT_LAYOUTS:
        for layout in list(cache)[: KEPT_LAYOUTS // 2]:
            del cache[layout]


def _follows(term: Term) -> bool:
    """True where the columns depend on the model that is being fitted."""
    return term.family().uses_load or term.family().uses_torque


def term_order(term: Term) -> tuple[str, int, str]:
    """Key that sorts terms the same way every time."""
    return term.effect, -1 if term.joint is None else term.joint, repr(term.settings)


class Evidence:
    """Gram matrices of the training runs for a list of terms, with respect to a starting model."""

    def __init__(self, base: Model, runs: Sequence[Run], terms: Sequence[Term], settings: LoopSettings) -> None:
        self.base, self.runs, self.settings = base, list(runs), settings
        #: Rows that count, per run (K, n): where the joint moves and nothing disturbs it.
        self.mask = [run.mask.copy() for run in self.runs]
        self.robot = base.completed_robot
        self.n = self.robot.n_joints
        self.terms: list[Term] = []
        self.weights = np.ones(self.n)
        # What follows from the terms alone: a search asks for the same ones again and again.
        self._priors: dict[Term, Array] = {}
        self._indices: dict[Layout, list[tuple[Indices, Indices]]] = {}
        self._constraints: dict[Layout, Constraints] = {}
        self._columns: dict[Term, list[Indices | None]] = {}
        #: Columns already there, per joint: what two terms share (a link's inertia) is kept once.
        self._known: list[dict[bytes, int]] = [{} for _ in range(self.n)]
        #: Products of all columns and, as the last one, the target, per joint.
        self.gram: list[BlockGrams] = []
        self._cache: dict[tuple[frozenset[Term], bool], Held] = {}
        self._rows: list[list[Array]] = [[np.empty((len(r.time), 0)) for _ in range(self.n)] for r in self.runs]
        self.base_target = [run.tau - run.smooth(self.predict_fine(base, run)) for run in self.runs]
        #: True where effects of the starting model follow the load, and so every change of the rigid body.
        self.base_follows_load = any(e.term(base.robot).family().uses_load for e in base.effects)
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
        self._make_blocks()
        self.add_terms(terms)

    @staticmethod
    def predict_fine(model: Model, run: Run) -> Array:
        """Prediction at the states of the run, not yet smoothed (M, n)."""
        m = run.motion
        return model.predict(m.q, m.dq, m.ddq, m.time)

    # -- building ---------------------------------------------------------------------------------------------------
    def _make_blocks(self) -> None:
        owner, fold, bounds = [], [], []
        single = not self._runs_share_motion()
        folds = self.settings.time_folds if single else len(self.runs)
        lengths = [float(run.time[-1] - run.time[0]) for run in self.runs]
        # Blocks are long against the filter's window; where a log is short, as short as that allows.
        wanted = max(self.settings.block, sum(lengths) / MOST_BLOCKS)
        for r, (run, length) in enumerate(zip(self.runs, lengths, strict=True)):
            fewest = min(int(np.ceil(FEWEST_BLOCKS / len(self.runs))), int(length * run.cutoff / BLOCK_WINDOWS))
            per_run = max(round(length / wanted), fewest, folds if single else 1)
            edges = np.linspace(0, len(run.time), per_run + 1).round().astype(int)
            for k, (low, high) in enumerate(pairwise(edges)):
                owner.append(r)
                bounds.append((int(low), int(high)))
                fold.append(k * folds // per_run if single else r)
        self.block_run, self.block_fold, self.block_rows = np.array(owner), np.array(fold), bounds
        self.folds = folds
        self._run_folds = folds, self.block_fold.copy()

    def _runs_share_motion(self) -> bool:
        """False for a single run, and where a joint moves in hardly more than one: nothing else could predict that."""
        rows = np.array([mask.sum(axis=0) for mask in self.mask], float)
        total = rows.sum(axis=0)
        return len(self.runs) > 1 and bool(np.all(rows.max(axis=0)[total > 0] <= MOST_IN_ONE * total[total > 0]))

    def fold_by_run(self) -> None:
        """The folds of the beginning again."""
        self.folds, self.block_fold = self._run_folds[0], self._run_folds[1].copy()
        self._sum()

    def fold_by_time(self) -> None:
        """Fold anew: contiguous parts of every run in turn, so that every run is in every fit."""
        self.folds = self.settings.time_folds
        for r in range(len(self.runs)):
            mine = np.flatnonzero(self.block_run == r)
            self.block_fold[mine] = np.arange(len(mine)) * self.folds // max(len(mine), 1)
        self._sum()

    def add_terms(self, terms: Sequence[Term]) -> None:
        """Compute and append the columns of ``terms`` (those not there yet)."""
        new: list[list[list[Array]]] = [[[] for _ in range(self.n)] for _ in self.runs]
        for term in terms:
            if term in self._columns:
                continue
            parts = self._smoothed(term, [run.motion for run in self.runs])
            only = dict(term.settings).get(ONLY_RUN)
            if only is not None:
                parts = [p if run.name == only else np.zeros_like(p) for p, run in zip(parts, self.runs, strict=True)]
            where: list[Indices | None] = []
            for j in range(self.n):
                own = [p if p.ndim == 2 else p[:, j] for p in parts]
                acts = parts[0].ndim == 3 or term.joint == j
                if not acts or max(float(np.abs(o).max(initial=0.0)) for o in own) < 1e-9:
                    where.append(None)
                    continue
                where.append(self._place(j, own, [n[j] for n in new], shared=not _follows(term)))
            self._columns[term] = where
            self.terms.append(term)
        grown = [j for j in range(self.n) if new[0][j]]
        for j in grown:
            for r, columns in enumerate(new):
                self._rows[r][j] = np.hstack([self._rows[r][j], *columns[j]])
                columns[j].clear()
        if not self.gram:
            self._reduce()
        elif grown:
            for j in grown:
                old, size = self.gram[j].size, self._rows[0][j].shape[1] + 1
                self.gram[j] = self.gram[j].grown(size)
                self._multiply(j, np.arange(old - 1, size - 1))
            self._sum()

    def _place(self, j: int, parts: list[Array], added: list[list[Array]], shared: bool) -> Indices:
        """Indices of the columns ``parts`` (one array a run) among those of joint ``j``; new ones go to ``added``."""
        index: list[int] = []
        new: list[int] = []
        size = self._rows[0][j].shape[1] + sum(part.shape[1] for part in added[0])
        for k in range(parts[0].shape[1]):
            digest = hashlib.sha256(b"".join(p[:, k].tobytes() for p in parts)).digest()
            if shared and digest in self._known[j]:
                index.append(self._known[j][digest])
                continue
            index.append(size + len(new))
            if shared:
                self._known[j][digest] = index[-1]
            new.append(k)
        if new:
            for own, p in zip(added, parts, strict=True):
                own.append(p[:, new])
        return np.array(index, int)

    def _smoothed(self, term: Term, motions: Sequence[Motion]) -> list[Array]:
        out = []
        for run, motion in zip(self.runs, motions, strict=True):
            columns = term.family().columns(motion, term)
            if self.base_follows_load and term.family().changes_body:
                share = 1.0 + self.base.load_derivative(motion.q, motion.dq, motion.ddq)
                columns = columns * (share[:, :, None] if columns.ndim == 3 else share[:, [term.index]])
            out.append(run.smooth(columns))
        return out

    def _model_in(self, effects: Sequence[Effect], run: Run) -> Model:
        """The starting model with those of ``effects`` that act in ``run``."""
        return self.base.adding(e for e in effects if e.settings.get(ONLY_RUN) in (None, run.name))

    def renew(self, effects: Sequence[Effect], terms: Sequence[Term]) -> None:
        """Compute the columns of ``terms`` that follow the load or the model's torque anew, with ``effects`` added."""
        terms = [s for s in terms if _follows(s)]
        if not terms:
            return
        torque = any(s.family().uses_torque for s in terms)
        motions = []
        for run in self.runs:
            model, m = self._model_in(effects, run), run.motion
            load = model.completed_robot.inverse_dynamics(m.q, m.dq, m.ddq)
            given = model.without_readings().predict(m.q, m.dq, m.ddq, m.time) if torque else None
            motions.append(replace(m, given_load=load, given_torque=given))
        changed: dict[int, list[int]] = {}
        for term in terms:
            parts = self._smoothed(term, motions)
            for j, where in enumerate(self._columns[term]):
                if where is not None:
                    changed.setdefault(j, []).extend(where)
                    for r, part in enumerate(parts):
                        self._rows[r][j][:, where] = part[:, j] if part.ndim == 3 else part
        for j, columns in changed.items():
            self._multiply(j, np.array(columns))
        self._sum()

    def leave_out(self, run: int, rows: slice) -> None:
        """Let ``rows`` of run number ``run`` count no more."""
        self.mask[run][rows] = False
        self._reduce()

    def _reduce(self) -> None:
        self.gram = [self._joint_gram(j) for j in range(self.n)]
        self.count = np.array(
            [
                self.mask[r][low:high].sum(axis=0)
                for r, (low, high) in zip(self.block_run, self.block_rows, strict=True)
            ],
            float,
        )
        self._sum()

    def _joint_gram(self, j: int) -> BlockGrams:
        size = self._rows[0][j].shape[1] + 1
        gram = np.zeros((len(self.block_rows), size, size))
        for b in range(len(gram)):
            rows = self._counted(j, b)
            gram[b] = rows.T @ rows
        return BlockGrams.of(gram)

    def _counted(self, j: int, b: int) -> Array:
        """Columns of joint ``j`` and, as the last one, its target, over the rows of block ``b`` that count."""
        r, (low, high) = self.block_run[b], self.block_rows[b]
        rows = np.column_stack([self._rows[r][j][low:high], self.target[r][low:high, j]])
        return np.asarray(rows[self.mask[r][low:high, j]])

    def _multiply(self, j: int, columns: Indices) -> None:
        """Renew the products of ``columns`` of joint ``j`` with all its columns and the target."""
        for b in range(len(self.block_rows)):
            rows = self._counted(j, b)
            self.gram[j].put(b, columns, rows[:, columns].T @ rows)

    def _retarget(self) -> None:
        """Renew what depends on the target in the Gram matrices."""
        for j, gram in enumerate(self.gram):
            for b, (low, high) in enumerate(self.block_rows):
                r = self.block_run[b]
                target = np.where(self.mask[r][low:high, j], self.target[r][low:high, j], 0.0)
                gram.last[b, :-1] = target @ self._rows[r][j][low:high]
                gram.last[b, -1] = target @ target
        self._sum_target()

    def _sum(self) -> None:
        """Sums over the blocks of each fold, and over those that a fold is predicted from.

        Where a fold ends inside a run, the block next to it is left out of its fit: neighbours are not independent.
        """
        self._cache = {}
        self.fold_blocks = [np.flatnonzero(self.block_fold == f) for f in range(self.folds)]
        self._left_out = [self._edge(f) for f in range(self.folds)]
        self.fold_parts = [_slices(own) for own in self.fold_blocks]
        self.own_sum = [[g.total(own) for g in self.gram] for own in self.fold_blocks]
        self.full_gram = [np.sum([own[j] for own in self.own_sum], axis=0) for j in range(self.n)]
        #: Per joint, the sums that each fold is predicted from (folds, size, size).
        self.fold_gram = [
            np.array([full - own[j] - gram.total(edge) for own, edge in zip(self.own_sum, self._left_out, strict=True)])
            for j, (full, gram) in enumerate(zip(self.full_gram, self.gram, strict=True))
        ]
        self.samples = self.count.sum(axis=0)

    def _edge(self, fold: int) -> Indices:
        """Blocks of other folds that border on ``fold`` within a run; none where nothing else would be left."""
        mine = self.block_fold == fold
        edge = np.zeros(len(mine), bool)
        same = self.block_run[1:] == self.block_run[:-1]
        edge[1:] |= same & mine[:-1]
        edge[:-1] |= same & mine[1:]
        edge &= ~mine
        return np.flatnonzero(edge) if np.any(~mine & ~edge) else np.zeros(0, int)

    def _sum_target(self) -> None:
        """The same where only the products with the target have changed."""
        self._cache = {}
        for j in range(self.n):
            product = self.gram[j].last
            sums = [product[own].sum(axis=0) for own in self.fold_blocks]
            full = np.sum(sums, axis=0)
            for gram, value in [
                (self.full_gram[j], full),
                *((self.own_sum[f][j], sums[f]) for f in range(self.folds)),
                *(
                    (self.fold_gram[j][f], full - sums[f] - product[edge].sum(axis=0))
                    for f, edge in enumerate(self._left_out)
                ),
            ]:
                gram[:, -1] = value
                gram[-1, :] = value

    def weigh(self, floor: Array) -> None:
        """Weigh the joints in every fit and score by ``floor`` (n,) [N m]; one without a floor counts nothing."""
        seen = floor > 0
        self.weights = np.where(seen, 1.0 / np.where(seen, floor, 1.0) ** 2, 0.0)
        self._cache = {}

    def relinearise(self, effects: Sequence[Effect], terms: Sequence[Term], x: Array) -> None:
        """Make the linear problem exact at ``x``: target = tau - exact(x) + columns x (Gauss-Newton, fixed columns)."""
        linear = self.linear(terms, x)
        self._moved = True
        for r, run in enumerate(self.runs):
            model = self._model_in(effects, run)
            self.target[r] = run.tau - run.smooth(self.predict_fine(model, run)) + linear[r]
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
        layout = self.layout(terms)
        out = [np.zeros((len(run.time), self.n)) for run in self.runs]
        for term, start in zip(layout.terms, layout.starts, strict=True):
            own = x[start : start + term.size]
            for j, where in enumerate(self._columns[term]):
                if where is not None:
                    for r in range(len(self.runs)):
                        out[r][:, j] += self._rows[r][j][:, where] @ own
        return out

    def residuals(self, terms: Sequence[Term], x: Array) -> list[Array]:
        """What ``terms`` at ``x`` leave of the target (K, n) [N m] in every run."""
        return [t - part for t, part in zip(self.target, self.linear(terms, x), strict=True)]

    def acts(self, term: Term) -> NDArray[np.bool_]:
        """(n,) on which joints ``term`` has a torque."""
        return np.array([where is not None for where in self._columns[term]])

    def joint_rows(self, run: int, joint: int) -> Array:
        """Smoothed columns (K, p) of all terms that act on ``joint`` in run number ``run``."""
        return self._rows[run][joint]

    # -- solving ----------------------------------------------------------------------------------------------------
    def layout(self, terms: Sequence[Term]) -> Layout:
        sizes = [s.size for s in terms]
        starts = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
        return Layout(tuple(terms), tuple(int(v) for v in starts[:-1]), int(starts[-1]))

    def indices(self, layout: Layout) -> list[tuple[Indices, Indices]]:
        """Per joint: positions in x and columns in the joint's Gram matrix."""
        if layout not in self._indices:
            _make_room(self._indices)
            out = []
            for j in range(self.n):
                position: list[int] = []
                column: list[int] = []
                for term, start in zip(layout.terms, layout.starts, strict=True):
                    where = self._columns[term][j]
                    if where is not None:
                        position.extend(range(start, start + len(where)))
                        column.extend(where)
                out.append((np.array(position, int), np.array(column, int)))
            self._indices[layout] = out
        return self._indices[layout]

    def constraints(self, layout: Layout) -> Constraints:
        if layout not in self._constraints:
            _make_room(self._constraints)
            self._constraints[layout] = physical_constraints(
                layout.terms, layout.starts, layout.total, self._base_places, self.robot, self.fastest
            )
        return self._constraints[layout]

    def has(self, term: Term) -> bool:
        """True where the columns of ``term`` are there."""
        return term in self._columns

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
        if size:
            a[:, :: size + 1] += np.concatenate([self._prior(term) for term in layout.terms])
        return a.reshape(many, size, size), b

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
        a, b = self.normal(layout, self.full_gram if grams is None else grams)
        return self._solved(layout, a, b, self.constraints(layout), physical)

    def _solved(self, layout: Layout, a: Array, b: Array, constraints: Constraints, physical: bool) -> Array:
        """Coordinates under ``constraints``; those that must lie on a surface are held to its tangent plane, twice."""
        x = solve(a, b, constraints) if physical else solve_bounded(a, b, constraints.lower)
        for _ in range(2):
            planes = [
                (start, plane)
                for term, start in zip(layout.terms, layout.starts, strict=True)
                if (plane := term.family().surface(x[start : start + term.size], self.robot, term)) is not None
            ]
            if not planes:
                break
            stiff, target = a.copy(), b.copy()
            for start, (normal, value) in planes:
                own = slice(start, start + len(normal))
                weight = STIFF * float(np.diag(a)[own].max())
                stiff[own, own] += weight * np.outer(normal, normal)
                target[own] += weight * value * normal
            x = solve(stiff, target, constraints) if physical else solve_bounded(stiff, target, constraints.lower)
        return x

    def errors(self, terms: Sequence[Term], x: Array, blocks: NDArray[np.bool_] | None = None) -> Array:
        """Squared residual sums (blocks, n) [N m]^2 of coordinates ``x``."""
        chosen = slice(None) if blocks is None else blocks
        vectors = [_residual(p, x, g.size) for p, g in zip(self.indices(self.layout(terms)), self.gram, strict=True)]
        forms = [gram.forms(v, v, chosen) for gram, v in zip(self.gram, vectors, strict=True)]
        return np.maximum(np.column_stack(forms), 0.0)

    def held(self, terms: Sequence[Term], physical: bool = False) -> Held:
        """Held-out prediction by ``terms``: fits under bounds alone, or with bodies and friction held ``physical``."""
        key = frozenset(terms), physical
        if key not in self._cache:
            layout = self.layout(sorted(key[0], key=term_order))
            constraints = self.constraints(layout)
            a, b = self._normals(layout, self.fold_gram)
            folds = [
                self._solved(layout, a[f], b[f], constraints, physical) if layout.total else np.zeros(0)
                for f in range(self.folds)
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
        for f in range(self.folds):
            torque = self.linear(terms, self.fit(terms, [gram[f] for gram in self.fold_gram]))
            for b in self.fold_blocks[f]:
                r, (low, high) = self.block_run[b], self.block_rows[b]
                total += float(np.sum((self.target[r][low:high, joint] - torque[r][low:high, joint]) ** 2))
        return total

    def covariance(self, terms: Sequence[Term], x: Array) -> Array:
        """Covariance of ``x`` by the block sandwich: autocorrelation inside a block is respected.

        Liang and Zeger (1986), with blocks of time as clusters and the usual small-sample factor.
        """
        layout = self.layout(terms)
        a, _ = self.normal(layout, self.full_gram)
        scores = np.zeros((len(self.block_rows), layout.total))
        for j, (position, column) in enumerate(self.indices(layout)):
            if len(position):
                residual = self.gram[j].last[:, column] - self.gram[j].pick(column, column) @ x[position]
                scores[:, position] += self.weights[j] * residual
        scale = 1.0 / np.sqrt(np.diag(a))
        bread = np.linalg.pinv(a * scale[:, None] * scale[None, :], rcond=1e-14, hermitian=True)
        bread = bread * scale[:, None] * scale[None, :]
        blocks = len(scores)
        return np.asarray(bread @ (scores.T @ scores) @ bread * blocks / max(blocks - 1, 1))
