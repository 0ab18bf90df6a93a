"""What is left where a joint stands: friction holds a part of it, and no more.

The torque of a joint that stands follows from what came before, so these samples take no part in the search and prove
no law. But friction holds no more than its own torque: what stands farther off than that is a hand, a stop, a brake or
a load that the model does not know, and an all-clear beside it would be none.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects, label

from hybrid_dynamics.effects import family
from hybrid_dynamics.effects.base import INTERVALS
from hybrid_dynamics.effects.units import unit_at
from hybrid_dynamics.loop.carried import Left, rows_and_rms
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.resting import Mask, standing_rows
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.types import Array

#: Friction holds up to so many times what it brakes with at slow speed: the torque at which a joint breaks away.
BREAKS_AWAY = 2.0
#: Noise reaches so many times its rms, and now and then farther.
NOISE = 4.0
#: It is told of a run in which it lasts so long [s] in all, and for such a share of the time at which the joint stands,
#: or for so long [s] of however much.
LASTS, SHARE, LONG = 0.5, 0.05, 3.0
#: Median of the size of normal noise, in standard deviations.
MEDIAN = 0.6745
#: Stretches told of a run, and runs.
_TOLD = 3


@dataclass(frozen=True)
class Standing:
    """Per joint (n,), where it stands and more is left than friction holds: for how many ``seconds`` in all, by how
    much (``rms`` [N m]), beside the friction that ``held`` [N m] on the average; the ``share`` of these samples in the
    squares of all that is left; ``where``: runs, and between which of their stamps [s]. All 0 or empty where nothing of
    that is seen."""

    seconds: Array
    rms: Array
    held: Array
    share: Array
    where: tuple[str, ...]

    @property
    def seen(self) -> Mask:
        """(n,) joints where it is."""
        return np.asarray(self.seconds > 0)

    def notes(self, joints: Sequence[str], slides: Collection[str] = ()) -> list[str]:
        """A line a joint; ``slides`` are the prismatic ones."""
        lines = []
        for j in map(int, np.flatnonzero(self.seen)):
            unit = unit_at("N m", joints[j], slides)
            lines.append(
                f"{joints[j]}: while it stands {self.rms[j]:.3g} {unit} are left (rms, {self.seconds[j]:.3g} s in all: "
                f"{self.where[j]}), of which friction as it was found holds {self.held[j]:.3g} {unit}: a hand, a stop, "
                "a brake, a load or friction that the model does not know; leave those moments out, or look what they "
                "have in common"
            )
        return lines


def beyond_friction(
    model: Model, train: Sequence[Left], test: Sequence[Left], floor: Array, settings: LoopSettings
) -> Standing:
    """What ``model`` leaves at standstill of any run that its own friction does not hold.

    ``floor`` (n,) [N m]: noise of the torque, at least; 0 where a joint never moves, of which nothing is said.
    """
    n, speed = len(floor), settings.process.slow_speed
    # Not of the test runs: of what happens in these nobody has cleared them.
    known = np.maximum(floor, rows_and_rms(train)[1])
    seconds, square, held = np.zeros((3, n))
    where: list[list[tuple[float, str]]] = [[] for _ in range(n)]
    for part, noise in ((train, known), (test, np.maximum(known, _usual(test)))):
        for run, _, _ in part:
            own_model = model.in_run(run.name)
            slow = standing_rows(own_model, run, speed)
            dt = float(run.time[1] - run.time[0])
            stood = dt * slow.sum(axis=0)
            joints = [int(j) for j in np.flatnonzero((floor > 0) & (stood >= LASTS))]
            if not joints:
                continue
            left, holds = left_at_rest(own_model, run, joints, speed)
            far = slow[:, joints] & (np.abs(left) > BREAKS_AWAY * holds + NOISE * noise[joints])
            for k, j in enumerate(joints):
                own = far[:, k] & ~_going_on(own_model, run, j, np.where(far[:, k], left[:, k], 0.0), slow[:, j])
                lasted = dt * float(own.sum())
                if lasted >= min(max(LASTS, SHARE * stood[j]), LONG):
                    seconds[j] += lasted
                    square[j] += dt * np.sum(left[own, k] ** 2)
                    held[j] += dt * np.sum(holds[own, k])
                    where[j].append((lasted, f"run {run.name} {_stretches(run, own)}"))
    time = np.where(seconds > 0, seconds, 1.0)
    whole = np.maximum(square + _squares([*train, *test]), 1e-300)
    return Standing(seconds, np.sqrt(square / time), held / time, square / whole, tuple(map(_runs, where)))


def left_at_rest(model: Model, run: Run, joints: Sequence[int], speed: float) -> tuple[Array, Array]:
    """(K, k) [N m] what the ``model`` of ``run`` leaves of ``joints`` where they stand, slower than ``speed`` [rad/s],
    counted from the middle of what their friction may hold, and half of that."""
    m = run.motion
    middle, half = model.turning(m.q, m.dq, m.ddq, speed, joints, m.time, m.began)
    return run.tau[:, joints] - run.smooth(middle), run.smooth(half)


def _going_on(model: Model, run: Run, joint: int, left: Array, slow: NDArray[np.bool_]) -> Mask:
    """(K,) rows of ``left`` (K,) [N m], beyond friction where ``joint`` is ``slow`` and else 0, in which a push that
    the model knows goes on: it is known while the joint moves, and need not end with that."""
    out = np.zeros(len(left), bool)
    since = run.time - run.began
    for effect in model.effects:
        if not family(effect.effect).momentary or effect.joint_index(model.robot) != joint:
            continue
        (torque,) = effect.parameters.values()
        for start, end in effect.settings[INTERVALS]:
            known = (since >= start - 1.0 / run.cutoff) & (since <= end + 1.0 / run.cutoff)
            # Between motion and standstill nothing is said of a row, so nothing ends there.
            alike = known | (left * torque > 0) | ~(run.mask[:, joint] | slow)
            parts, _ = label(alike)
            out |= np.isin(parts, np.unique(parts[known])) & (left != 0)
    return out


def _runs(told: Sequence[tuple[float, str]]) -> str:
    """Those that have most of it, ``told`` with their seconds."""
    first = [text for _, text in sorted(told, key=lambda item: -item[0])[:_TOLD]]
    more = [f"{len(told) - _TOLD} more runs"] if len(told) > _TOLD else []
    return "; ".join([*first, *more])


def _stretches(run: Run, rows: Mask) -> str:
    """``from 1.00 to 1.50 s and from 3.00 to 4.25 s``: the longest of ``rows`` (K,), in their order."""
    found = [s[0] for s in find_objects(label(rows)[0])]
    longest = sorted(sorted(found, key=lambda s: s.start - s.stop)[:_TOLD], key=lambda s: s.start)
    told = [f"from {run.time[s.start]:.2f} to {run.time[s.stop - 1]:.2f} s" for s in longest]
    more = [f"{len(found) - _TOLD} more"] if len(found) > _TOLD else []
    return " and ".join([*told, *more])


def _squares(parts: Sequence[Left]) -> Array:
    """(n,) [N m]^2 s of what is left where a joint moves."""
    squares = [float(r.time[1] - r.time[0]) * np.sum(left**2 * keep, axis=0) for r, left, keep in parts]
    return np.asarray(np.sum(squares, axis=0))


def _usual(parts: Sequence[Left]) -> Array:
    """(n,) [N m] of what is left in motion for the most part: of runs that nobody has cleared of what happened once."""
    out = []
    for j in range(parts[0][1].shape[1]):
        own = np.concatenate([left[keep[:, j], j] for _, left, keep in parts])
        out.append(float(np.median(np.abs(own))) / MEDIAN if len(own) else 0.0)
    return np.array(out)
