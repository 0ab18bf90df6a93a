"""Smoothed columns of candidate terms, per run and joint: what a fit of them is linear in."""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Effect, Motion, Term
from hybrid_dynamics.effects.acting import late
from hybrid_dynamics.effects.base import ONLY_RUN
from hybrid_dynamics.loop.layout import Layout, make_room
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.types import Array

Indices = NDArray[np.int_]

#: Models of which the torque at all states of a run is kept: a step that was tried and the one it was tried from.
KEPT = 2


def follows(term: Term) -> bool:
    """True where the columns depend on the model that is being fitted."""
    return term.family().uses_load or term.family().uses_torque


def model_in(base: Model, effects: Sequence[Effect], run: Run) -> Model:
    """``base`` with those of ``effects`` that act in ``run``."""
    return base.adding(e for e in effects if e.settings.get(ONLY_RUN) in (None, run.name))


class Columns:
    """Columns of the ``terms`` added so far: ``rows[run][joint]`` (K, p); what two terms share stands there once."""

    def __init__(self, base: Model, runs: Sequence[Run]) -> None:
        self.base, self.runs = base, list(runs)
        self.n = base.robot.n_joints
        self.terms: list[Term] = []
        #: True where effects of the starting model follow the load, and so every change of the rigid body.
        self.base_follows_load = any(e.term(base.robot).family().uses_load for e in base.effects)
        #: What the starting model says the torque is read too large by, where it says so: columns are read like it.
        self._read = None if np.all(base.readings.gain == 1.0) else base.readings.gain
        self.rows: list[list[Array]] = [[np.empty((len(r.time), 0)) for _ in range(self.n)] for r in self.runs]
        self._where: dict[Term, list[Indices | None]] = {}
        #: A search asks for the same combinations again and again.
        self._indices: dict[Layout, list[tuple[Indices, Indices]]] = {}
        self._known: list[dict[bytes, int]] = [{} for _ in range(self.n)]
        self._asked: list[deque[tuple[Model, tuple[Array, Array]]]] = [deque(maxlen=KEPT) for _ in self.runs]
        self._shares: dict[int, Array] = {}

    def __contains__(self, term: Term) -> bool:
        return term in self._where

    def size(self, joint: int) -> int:
        """Number of columns of ``joint``."""
        return int(self.rows[0][joint].shape[1])

    def acts(self, term: Term) -> NDArray[np.bool_]:
        """(n,) on which joints ``term`` has a torque."""
        return np.array([where is not None for where in self._where[term]])

    def add(self, terms: Sequence[Term]) -> list[int]:
        """Compute and append the columns of ``terms`` (those not there yet); returns the joints that have new ones."""
        motions = [run.motion for run in self.runs]
        if any(term.family().by_regressor for term in terms if term not in self):
            motions = [self._with_regressor(r) for r in range(len(self.runs))]
        new: list[list[list[Array]]] = [[[] for _ in range(self.n)] for _ in self.runs]
        for term in terms:
            if term in self._where:
                continue
            parts = self._smoothed(term, motions)
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
                where.append(self._place(j, own, [n[j] for n in new], shared=not follows(term)))
            self._where[term] = where
            self.terms.append(term)
        grown = [j for j in range(self.n) if new[0][j]]
        for j in grown:
            for r, columns in enumerate(new):
                self.rows[r][j] = np.hstack([self.rows[r][j], *columns[j]])
                columns[j].clear()
        return grown

    def _place(self, j: int, parts: list[Array], added: list[list[Array]], shared: bool) -> Indices:
        """Indices of the columns ``parts`` (one array a run) among those of joint ``j``; new ones go to ``added``."""
        index: list[int] = []
        new: list[int] = []
        size = self.rows[0][j].shape[1] + sum(part.shape[1] for part in added[0])
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
        for r, (run, motion) in enumerate(zip(self.runs, motions, strict=True)):
            columns = term.family().columns(motion, term)
            if self._read is not None:
                columns = columns * (self._read[:, None] if columns.ndim == 3 else self._read[term.index])
            if term.family().by_regressor:
                out.append(columns)
                continue
            if self.base_follows_load and term.family().changes_body:
                share = self._share(r)
                columns = columns * (share[:, :, None] if columns.ndim == 3 else share[:, [term.index]])
            out.append(run.smooth(columns))
        return out

    def _with_regressor(self, r: int) -> Motion:
        """Motion of run number ``r`` with its smoothed regressor, and in that what the starting model makes of a load.

        Computed piece by piece: at the rate of the log, and once for every term, it would be most of the memory.
        """
        run, whole = self.runs[r], self.runs[r].motion
        share = self._share(r)[:, :, None] if self.base_follows_load else None
        out = np.empty((len(run.time), self.n, 10 * self.n))
        for rows, states in run.pieces():
            part = whole.robot.regressor(whole.q[states], whole.dq[states], whole.ddq[states])
            out[rows] = run.smooth(part if share is None else part * share[states])
        return replace(whole, given_regressor=out)

    def torques(self, model: Model, r: int) -> tuple[Array, Array]:
        """:meth:`Model.acting_torques` of the states of run number ``r``.

        Those of the last models are kept: a fit asks for the same ones at the end of a step and for its next tangent.
        """
        for kept, torques in self._asked[r]:
            if kept.robot is model.robot and kept.effects == model.effects:
                return torques
        m = self.runs[r].motion
        torques = model.acting_torques(m.q, m.dq, m.ddq, m.time)
        self._asked[r].append((model, torques))
        return torques

    def _share(self, r: int) -> Array:
        """(M, n) by how much more than itself a load moves the starting model's torque in run number ``r``."""
        if r not in self._shares:
            m = self.runs[r].motion
            self._shares[r] = 1.0 + self.base.load_derivative(m.q, m.dq, m.ddq)
        return self._shares[r]

    def renew(self, effects: Sequence[Effect], terms: Sequence[Term]) -> dict[int, Indices]:
        """Compute the columns of ``terms`` that follow the load or the model's torque anew, with ``effects`` added.

        Returns which columns of which joints have changed.
        """
        terms = [s for s in terms if follows(s)]
        if not terms:
            return {}
        torque = any(s.family().uses_torque for s in terms)
        loaded = any(s.family().uses_load for s in terms)
        motions = []
        for r, run in enumerate(self.runs):
            model, m = model_in(self.base, effects, run), run.motion
            load, own = self.torques(model, r)
            # As late as it is recorded: noise of the motion stands in the column and in what is left, and at
            # different instants it would pull the delay towards none.
            given = late(own, m.time, model.readings) if torque else None
            motions.append(
                replace(m, given_load=load if loaded else None, given_torque=given, given_lag=model.readings.lag)
            )
        changed: dict[int, list[int]] = {}
        for term in terms:
            parts = self._smoothed(term, motions)
            for j, where in enumerate(self._where[term]):
                if where is not None:
                    changed.setdefault(j, []).extend(where)
                    for r, part in enumerate(parts):
                        self.rows[r][j][:, where] = part[:, j] if part.ndim == 3 else part
        return {j: np.array(columns) for j, columns in changed.items()}

    def linear(self, layout: Layout, x: Array) -> list[Array]:
        """Columns times coordinates: torque (K, n) [N m] in every run."""
        out = [np.zeros((len(run.time), self.n)) for run in self.runs]
        for j, (position, column) in enumerate(self.indices(layout)):
            # Two terms may share a column: what they ask of it adds up.
            weight = np.bincount(column, x[position], minlength=self.size(j))
            for part, rows in zip(out, self.rows, strict=True):
                part[:, j] = rows[j] @ weight
        return out

    def project(self, layout: Layout, terms: Sequence[Term], torque: Sequence[Array]) -> Array:
        """Products (K,) of the columns of ``terms`` with ``torque`` (K, n) per run; zero for others of ``layout``."""
        out = np.zeros(layout.total)
        for term, start in zip(layout.terms, layout.starts, strict=True):
            for j, where in enumerate(self._where[term]):
                if term in terms and where is not None:
                    for rows, own in zip(self.rows, torque, strict=True):
                        out[start : start + term.size] += own[:, j] @ rows[j][:, where]
        return out

    def indices(self, layout: Layout) -> list[tuple[Indices, Indices]]:
        """Per joint: positions in x and columns of the joint."""
        if layout not in self._indices:
            make_room(self._indices)
            self._indices[layout] = [self._places(layout, j) for j in range(self.n)]
        return self._indices[layout]

    def _places(self, layout: Layout, joint: int) -> tuple[Indices, Indices]:
        position: list[int] = []
        column: list[int] = []
        for term, start in zip(layout.terms, layout.starts, strict=True):
            where = self._where[term][joint]
            if where is not None:
                position.extend(range(start, start + len(where)))
                column.extend(where)
        return np.array(position, int), np.array(column, int)
