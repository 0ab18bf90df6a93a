"""One recorded arm: rigid body, classical least squares, the loop and a black box on top of it, on runs held out.

All at the loop's bandwidth and over all rows, standing ones included: predictions are computed at the log's rate and
pass the same low-pass as the torque they are compared with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hybrid_dynamics.effects import family
from hybrid_dynamics.effects.units import unit_of
from hybrid_dynamics.errors import require
from hybrid_dynamics.identification import LeastSquares, LeastSquaresSettings
from hybrid_dynamics.loop import LoopResult
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.diagnosis import predict_run
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.identifiability import undetermined
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run, process
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.park.black_box import corrections
from hybrid_dynamics.study.park.compare import Comparison, compare
from hybrid_dynamics.study.park.regimes import REGIMES, regime_of
from hybrid_dynamics.study.park.tables import COLUMNS, PARAMETER_COLUMNS, REGIME_COLUMNS
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class ParkSettings:
    """``standing`` [rad/s], ``turn`` [s] and ``slow`` (share of the highest speed) bound the regimes of a motion;
    a single run is cut into ``parts`` for the scatter of parameters; ``seed``: of the black box."""

    standing: float = 0.02
    turn: float = 0.1
    slow: float = 0.25
    parts: int = 3
    seed: int = 0

    def __post_init__(self) -> None:
        require(self.standing >= 0, f"park.standing is {self.standing}; expected rad/s >= 0")
        require(0 <= self.turn < 10, f"park.turn is {self.turn}; expected seconds in [0, 10)")
        require(0 <= self.slow < 1, f"park.slow is {self.slow}; expected a share in [0, 1)")
        require(2 <= self.parts <= 20, f"park.parts is {self.parts}; expected 2 to 20")


@dataclass(frozen=True)
class ParkResult:
    """Rows of the three tables of one arm, see :mod:`~hybrid_dynamics.study.park.tables`."""

    joints: pd.DataFrame
    regimes: pd.DataFrame
    parameters: pd.DataFrame


def judge_arm(
    dataset: str,
    robot: Robot,
    logs: Sequence[Trajectory],
    result: LoopResult,
    loop: LoopSettings,
    least_squares: LeastSquaresSettings,
    settings: ParkSettings | None = None,
) -> ParkResult:
    """Judge the arm whose loop was closed on ``logs`` (training and test runs) with ``result``, on its test runs."""
    settings = settings or ParkSettings()
    train, test = list(result.train), list(result.test)
    # The log's own bandwidth is that of the loop on all its runs; a part of them alone would have another.
    loop = replace(loop, process=replace(loop.process, cutoff=max(run.cutoff for run in train), own_bandwidth=False))
    measured = np.concatenate([run.tau for run in test])
    classical = LeastSquares(robot, least_squares).fit([_smoothed(run) for run in train])
    found = result.found
    left = [run.tau - predict_run(found, run) for run in train]
    boxed = corrections(train, left, test, settings.seed)
    hats = {
        "rigid_body": [predict_run(Model(robot), run) for run in test],
        "least_squares": [run.smooth(classical.predict(_fine(run))) for run in test],
        "loop": [predict_run(found, run) for run in test],
        "black_box": [predict_run(found, run) + more for run, more in zip(test, boxed, strict=True)],
        "loop_confirmed": [predict_run(result.model, run) for run in test],
    }
    left_by = {name: [run.tau - hat for run, hat in zip(test, own, strict=True)] for name, own in hats.items()}
    errors = {name: np.concatenate(own) for name, own in left_by.items()}
    times = [run.time for run in test]
    against = compare(left_by["loop"], left_by["least_squares"], times, loop.block, loop.confirmation)
    regime = np.concatenate([regime_of(run, settings.standing, settings.turn, settings.slow) for run in test])
    return ParkResult(
        _joints(dataset, robot, result, measured, errors, against),
        _regimes(dataset, regime, measured, errors),
        scatter(dataset, robot, found, logs, loop, settings.parts),
    )


def _joints(
    dataset: str,
    robot: Robot,
    result: LoopResult,
    measured: Array,
    errors: dict[str, Array],
    against: tuple[Sequence[Comparison], Comparison],
) -> pd.DataFrame:
    diagnosis = result.diagnosis.to_json()
    rms = {name: np.sqrt((error**2).mean(axis=0)) for name, error in errors.items()}
    rows = []
    for j, joint in enumerate(robot.joint_names):
        floors = [diagnosis[key][j] for key in ("noise_floor", "noise_floor_low", "noise_floor_high")]
        others = (rms["least_squares"][j], rms["black_box"][j])
        shares = [explained_share(rms["rigid_body"][j], rms["loop"][j], min(floor, *others)) for floor in floors]
        rows.append(
            {
                "dataset": dataset,
                "joint": j + 1,
                "floor": floors[0],
                **{name: rms[name][j] for name in ("rigid_body", "least_squares", "loop", "black_box")},
                "explained_share": shares[0],
                "named": _named(diagnosis["effects"], joint),
                "floor_low": floors[1],
                "floor_high": floors[2],
                "explained_share_low": shares[1],
                "explained_share_high": shares[2],
                "loop_confirmed": rms["loop_confirmed"][j],
                "spread": measured[:, j].std(),
                "learnable_share": diagnosis["learnable_share"][j],
                "motion_dependent": diagnosis["motion_dependent"][j],
                "verdict": diagnosis["verdict"],
                **_compared("against_least_squares", against[0][j]),
                **_compared("arm_against_least_squares", against[1]),
            }
        )
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _compared(name: str, found: Comparison) -> dict[str, float | str]:
    return {name: found.relative, f"{name}_error": found.error, f"{name}_verdict": found.verdict}


def explained_share(rigid: float, loop: float, best: float) -> float:
    """Of the mean square that can be explained the share that named effects explain; NaN where nothing can be."""
    can = rigid**2 - best**2
    return float((rigid**2 - loop**2) / can) if can > 0 else float("nan")


def _named(effects: Sequence[dict[str, Any]], joint: str) -> str:
    """Effects that touch ``joint``, in the order they were named; in brackets where the test runs contradict them."""
    own = [e for e in effects if not e["joints"] or joint in e["joints"]]
    return " ".join(e["effect"] if e.get("confirmed", True) else f"({e['effect']})" for e in own)


def _regimes(dataset: str, regime: NDArray[np.int_], measured: Array, errors: dict[str, Array]) -> pd.DataFrame:
    rows = []
    for j in range(measured.shape[1]):
        for index, name in enumerate(REGIMES):
            mine = regime[:, j] == index
            values = {
                method: float(np.sqrt((errors[method][mine, j] ** 2).mean())) if mine.any() else float("nan")
                for method in ("rigid_body", "least_squares", "loop", "black_box")
            }
            spread = float(measured[:, j].std())
            rows.append(
                {
                    "dataset": dataset,
                    "joint": j + 1,
                    "regime": name,
                    "rows": int(mine.sum()),
                    **values,
                    "spread": spread,
                }
            )
    return pd.DataFrame(rows, columns=list(REGIME_COLUMNS))


def scatter(
    dataset: str, robot: Robot, model: Model, logs: Sequence[Trajectory], settings: LoopSettings, parts: int
) -> pd.DataFrame:
    """Parameters of ``model`` fitted on every run alone; two logs or one (a single recording) are cut into parts.

    ``scatter`` is the root mean square of (value of a run - weighted mean of the runs) / its standard error, times
    sqrt(R / (R - 1)): 1 where the standard errors tell how far runs are apart. A run that leaves a parameter open (a
    joint that turns one way only has no Coulomb friction beside an offset) has no value of it.
    """
    whole = (
        logs if len(logs) > 2 else [piece for log in logs for piece in _cut(log, parts if log.split == "train" else 1)]
    )
    pieces = [process(log, robot, settings.process) for log in whole]
    terms = [effect.term(robot) for effect in model.effects]
    fits = []
    for piece in pieces:
        fitted = refit(Evidence.of(Model(robot), [piece], terms, settings), terms)
        named = zip(fitted.model().effects, terms, strict=True)
        fits.append([(e, undetermined(fitted.evidence, terms, s)) for e, s in named])
    rows = []
    for k, effect in enumerate(model.effects):
        kind = family(effect.effect)
        for key in kind.published(effect.settings):
            known = [fit[k][0] for fit in fits if key not in fit[k][1]]
            values = np.array([e.parameters[key] for e in known], float)
            own = np.array([e.std_errors.get(key, np.nan) for e in known], float)
            good = np.isfinite(values) & np.isfinite(own) & (own > 0)
            values, own = values[good], own[good]
            rows.append(
                {
                    "dataset": dataset,
                    "effect": effect.effect,
                    "joint": effect.joints[0] if effect.joints else "",
                    "parameter": key,
                    "unit": unit_of(effect, key, robot.prismatic),
                    "value": effect.parameters[key],
                    "std_error": effect.std_errors.get(key, np.nan),
                    "runs": len(values),
                    "run_spread": float(values.std(ddof=1)) if len(values) > 1 else np.nan,
                    "run_std_error": float(np.sqrt(np.mean(own**2))) if len(values) else np.nan,
                    "scatter": _scatter(values, own),
                }
            )
    return pd.DataFrame(rows, columns=list(PARAMETER_COLUMNS))


def _scatter(values: Array, errors: Array) -> float:
    if len(values) < 2:
        return float("nan")
    weights = errors**-2.0
    mean = float((weights * values).sum() / weights.sum())
    return float(np.sqrt((((values - mean) / errors) ** 2).sum() / (len(values) - 1)))


def _cut(log: Trajectory, parts: int) -> list[Trajectory]:
    """``log`` in stretches of equal length."""
    ends = np.linspace(0, len(log.time), parts + 1).astype(int)
    return [log.rows(slice(a, b)) for a, b in pairwise(ends)]


def _smoothed(run: Run) -> Trajectory:
    return Trajectory(run.name, "train", run.time, {"q": run.q, "dq": run.dq, "ddq": run.ddq, "tau": run.tau})


def _fine(run: Run) -> Trajectory:
    motion = run.motion
    return Trajectory(run.name, "test", motion.time, {"q": motion.q, "dq": motion.dq, "ddq": motion.ddq})
