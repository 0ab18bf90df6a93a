"""What one loop is given and never changes: the starting model, the runs, their motion, and what follows from them.

What is kept besides (torques of the last models, priors, constraints) follows from these alone and changes no answer.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np

from hybrid_dynamics.effects import Effect, Motion, Term, family
from hybrid_dynamics.effects.acting import late
from hybrid_dynamics.effects.base import acts_in
from hybrid_dynamics.effects.inertia import radii
from hybrid_dynamics.loop.blocks import Blocks, folds_of
from hybrid_dynamics.loop.layout import Layout, make_room
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.physics import physical_constraints
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.resting import Resting, resting_rows
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.loop.solve import Constraints
from hybrid_dynamics.types import Array

#: Models of which the torque at all states of a run is kept: a step that was tried and the one it was tried from.
KEPT = 2
#: Coordinates of like size are expected to differ by this share of the root mean square of their joint's torque: a row
#: or two of the log say more.
DIFFERENCE = 0.1


def model_in(base: Model, effects: Sequence[Effect], run: Run) -> Model:
    """``base`` with those of ``effects`` that act in ``run``."""
    return base.adding(effects).in_run(run.name)


def predict_fine(model: Model, run: Run) -> Array:
    """Prediction at the states of ``run``, not yet smoothed (M, n) [N m]."""
    m = run.motion
    return model.in_run(run.name).predict(m.q, m.dq, m.ddq, m.time, m.began)


class Problem:
    """The starting model ``base``, the training ``runs`` and the ``settings`` of a loop, and what follows from them.

    ``robot``: the one of ``base``, its bodies as far as they are known; ``folds``: those of the beginning;
    ``base_target``: torque (K, n) [N m] that ``base`` leaves in every run; ``fastest`` (n,) [rad/s] speeds in the runs.
    """

    def __init__(self, base: Model, runs: Sequence[Run], settings: LoopSettings) -> None:
        self.base, self.runs, self.settings = base, tuple(runs), settings
        self.robot = base.completed_robot
        self.n = self.robot.n_joints
        #: True where effects of the starting model follow the load, and so every change of the rigid body.
        self.base_follows_load = any(e.term(base.robot).family().uses_load for e in base.effects)
        #: What the starting model says the torque is read too large by, where it says so: columns are read like it.
        self._read = None if np.all(base.readings.gain == 1.0) else base.readings.gain
        #: (n,) [m], as the URDF describes the links: of identified ones it would grow from start to start.
        self.reach_of_links = radii(base.robot)
        self.fastest = np.max([np.abs(run.dq).max(axis=0) for run in self.runs], axis=0)
        self.folds = folds_of(self.runs, settings)
        self._asked: list[deque[tuple[Model, tuple[Array, Array]]]] = [deque(maxlen=KEPT) for _ in self.runs]
        self._rigid: list[deque[tuple[bytes, Array]]] = [deque(maxlen=KEPT) for _ in self.runs]
        self._shares: dict[int, Array] = {}
        self._priors: dict[Term, Array] = {}
        #: Links that are identified together are expected within so much of what is plausible of them.
        self.links_within = 1.0
        self._constraints: dict[Layout, Constraints] = {}

    @property
    def blocks(self) -> Blocks:
        """The runs in blocks of time."""
        return self.folds.blocks

    @cached_property
    def base_target(self) -> tuple[Array, ...]:
        """Torque (K, n) [N m] of every run that the starting model leaves."""
        return self.left([])

    @cached_property
    def base_torque(self) -> tuple[Array, ...]:
        """Smoothed torque (K, n) [N m] of the starting model in every run."""
        return tuple(run.tau - left for run, left in zip(self.runs, self.base_target, strict=True))

    @cached_property
    def resting(self) -> Resting:
        """Rows in which joints stand."""
        return resting_rows(self.base, self.runs, self.base_target, self.settings)

    @cached_property
    def base_places(self) -> dict[Term, Array]:
        """Coordinates of the effects of single joints that the starting model has, named there or not."""
        out: dict[Term, Array] = {}
        for effect in self.base.effects:
            term = effect.term(self.base.robot).as_finding
            if term.family().scope == "joint":
                own = term.family().coordinates_of(effect.parameters, self.base.robot, term)
                out[term] = out.get(term, np.zeros(len(own))) + own
        return out

    @cached_property
    def links_identified(self) -> bool:
        """True where the starting model has all links' parameters as a finding, and no guess beside one."""
        return any(family(effect.effect).all_links and effect.is_finding for effect in self.base.effects)

    # -- torques of a model -----------------------------------------------------------------------------------------
    def left(self, effects: Sequence[Effect]) -> tuple[Array, ...]:
        """Torque (K, n) [N m] of every run that the starting model with ``effects``, laws as they are, leaves."""
        models = [model_in(self.base, effects, run) for run in self.runs]
        fine = [m.recorded(self.torques(m, r)[1], self.runs[r].motion.time) for r, m in enumerate(models)]
        return tuple(run.tau - run.smooth(own) for run, own in zip(self.runs, fine, strict=True))

    def torques(self, model: Model, r: int) -> tuple[Array, Array]:
        """:meth:`Model.acting_torques` of the states of run number ``r``.

        Those of the last models are kept: a fit asks for the same ones at the end of a step and for its next tangent.
        """
        for kept, torques in self._asked[r]:
            if kept.robot is model.robot and kept.effects == model.effects:
                return torques
        m, body = self.runs[r].motion, model.rigid_body
        # Most models that a fit tries differ in their friction, not in their bodies.
        rigid = next((own for kept, own in self._rigid[r] if kept == body), None)
        torques = model.acting_torques(m.q, m.dq, m.ddq, m.time, rigid, m.began)
        if rigid is None:
            self._rigid[r].append((body, torques[0]))
        self._asked[r].append((model, torques))
        return torques

    # -- columns of a term ------------------------------------------------------------------------------------------
    def motion(self, r: int, effects: Sequence[Effect], terms: Sequence[Term]) -> Motion:
        """Motion of run number ``r`` with what columns of ``terms`` are made of: where they ask for it the regressor,
        and the bodies, load and torque of the starting model with ``effects``."""
        kinds, run = [term.family() for term in terms if acts_in(term.options, self.runs[r].name)], self.runs[r]
        torque, loaded = any(k.uses_torque for k in kinds), any(k.uses_load for k in kinds)
        motion = self._with_regressor(r) if any(k.by_regressor for k in kinds) else run.motion
        model = model_in(self.base, effects, run)
        if any(k.uses_body for k in kinds):
            motion = replace(motion, robot=model.completed_robot)
        if torque or loaded:
            load, own = self.torques(model, r)
            # As late as it is recorded: noise of the motion stands in the column and in what is left, and at different
            # instants it would pull the delay towards none.
            given = late(own, motion.time, model.readings) if torque else None
            lag = model.readings.lag
            motion = replace(motion, given_load=load if loaded else None, given_torque=given, given_lag=lag)
        return motion

    def smoothed(self, term: Term, r: int, fine: Motion) -> Array | None:
        """Columns of ``term`` in run number ``r``, (K, p) of its joint or (K, n, p), given its :meth:`motion`; None
        where the term acts in other runs only."""
        run, kind = self.runs[r], term.family()
        if not acts_in(term.options, run.name):
            return None
        # Of bodies that turn: smooth as the motion is, at its rows as good as made finer and smoothed, and asked often.
        smooth = kind.uses_body and not self.base_follows_load
        motion = replace(fine, time=run.time, q=run.q, dq=run.dq, ddq=run.ddq) if smooth else fine
        columns = kind.columns(motion, term)
        if self._read is not None:
            columns = columns * (self._read[:, None] if columns.ndim == 3 else self._read[term.index])
        if kind.by_regressor or smooth:
            return columns
        if self.base_follows_load and kind.changes_body:
            share = self._share(r)
            columns = columns * (share[:, :, None] if columns.ndim == 3 else share[:, [term.index]])
        return run.smooth(columns)

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

    def _share(self, r: int) -> Array:
        """(M, n) by how much more than itself a load moves the starting model's torque in run number ``r``."""
        if r not in self._shares:
            m = self.runs[r].motion
            self._shares[r] = 1.0 + self.base.load_derivative(m.q, m.dq, m.ddq)
        return self._shares[r]

    # -- what is known of coordinates beforehand --------------------------------------------------------------------
    def constraints(self, layout: Layout) -> Constraints:
        """What physics asks of the coordinates of ``layout``."""
        if layout not in self._constraints:
            make_room(self._constraints)
            self._constraints[layout] = physical_constraints(
                layout.terms,
                layout.starts,
                layout.total,
                self.base_places,
                self.robot,
                self.fastest,
                self.reach_of_links,
            )
        return self._constraints[layout]

    def holding_links(self, share: float) -> Problem:
        """The same where all links, as a name, are expected within ``share`` of what is plausible of them."""
        out = copy(self)
        out.links_within, out._priors = share, {}
        return out

    def prior(self, layout: Layout) -> Array:
        """(p,): one over the square of what a coordinate of ``layout`` may plausibly be."""
        return np.concatenate([np.zeros(0), *(self._prior(term) for term in layout.terms)])

    def _prior(self, term: Term) -> Array:
        """Weight (p,) that holds the coordinates of ``term`` to zero."""
        if term not in self._priors:
            named = term.family().all_links and term.is_finding
            within = self.links_within if named else 1.0
            self._priors[term] = 1.0 / (within * term.prior_scale(self.robot)) ** 2
        return self._priors[term]

    def alike(self, layout: Layout) -> Array:
        """(K, K): what holds coordinates of like size to each other, where the data is silent about one of them.

        A joint that moves one way but for the instants in which it turns over would else have of its friction the other
        way what a few rows make of it: any multiple of the joint's torque, and whole folds are predicted by that.
        """
        out = np.zeros((layout.total, layout.total))
        for term, start in zip(layout.terms, layout.starts, strict=True):
            if term.family().of_like_size and (size := self.torque_size[term.index]) > 0:
                part = slice(start, start + term.size)
                out[part, part] += (np.eye(term.size) - 1.0 / term.size) / (DIFFERENCE * size) ** 2
        return out

    @cached_property
    def torque_size(self) -> Array:
        """(n,) [N m] root mean square of every joint's recorded torque."""
        square = np.mean(np.concatenate([run.tau for run in self.runs]) ** 2, axis=0)
        return np.asarray(np.sqrt(square))
