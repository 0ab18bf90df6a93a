"""The classical baseline: base inertial parameters, rotor inertia and friction by physically consistent least squares.

    tau = Y(q, dq, ddq) pi + Ia ddq + fv dq + fc s(dq) + fo,   s(dq) = tanh(dq / w) or sign(dq)

is linear in its parameters (Sousa and Cortesao, IJRR 33(6), 2014, eq. 1-3). Fitted is the ordinary estimate, weighted
by each joint's noise, then the nearest physically consistent one (:mod:`~hybrid_dynamics.identification.physical`).
Data of any length is reduced to triangular factors first (:mod:`~hybrid_dynamics.identification.factors`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import jsonschema
import numpy as np
import pinocchio as pin

from hybrid_dynamics.errors import HybridDynamicsError, InputError, require
from hybrid_dynamics.identification.base_parameters import BaseParameters, base_parameters, full_regressor
from hybrid_dynamics.identification.estimate import Estimate, estimate
from hybrid_dynamics.identification.factors import block_factors, low_pass_taps, smooth_sign
from hybrid_dynamics.identification.physical import physical_least_squares
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

FRICTION = (("fv", "viscous_coefficient", "N m s/rad"), ("fc", "coulomb_torque", "N m"), ("fo", "offset", "N m"))
_CHUNK = 5000


@dataclass(frozen=True)
class LeastSquaresSettings:
    """Settings of :class:`LeastSquares`.

    ``physical``: physically consistent estimate (else the ordinary one). ``prior_weight``: pull towards the robot's
    description per sample, in units of the torque noise's variance. ``sign_widths`` [rad/s]: candidates for the width
    of sign(dq), chosen per joint by cross-validation over all rows (0 is the plain sign). ``min_speed`` [rad/s]:
    slower rows of a joint are not used to fit it. ``filter_cutoff`` [Hz]: low-pass for torque and all columns alike,
    0 for none (the data comes filtered). ``block_seconds`` [s]: block of the jackknife, longer than the residual's
    correlation. ``max_rows``: recordings are thinned to this many samples. ``reweightings``: passes of noise
    weighting. ``seed``: of the random states that the base parameters are grouped from.
    """

    physical: bool = True
    prior_weight: float = 1e-5
    sign_widths: tuple[float, ...] = (0.0, 0.01, 0.03, 0.08)
    min_speed: float = 0.02
    filter_cutoff: float = 0.0
    block_seconds: float = 1.0
    max_rows: int = 60_000
    reweightings: int = 2
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "sign_widths", tuple(float(w) for w in self.sign_widths))
        require(
            1e-9 <= self.prior_weight <= 1, f"least_squares.prior_weight is {self.prior_weight}; expected 1e-9 to 1"
        )
        require(
            len(self.sign_widths) > 0 and all(0 <= w <= 10 for w in self.sign_widths),
            f"least_squares.sign_widths is {list(self.sign_widths)}; expected one or more values from 0 to 10 rad/s",
        )
        require(0 <= self.min_speed <= 1, f"least_squares.min_speed is {self.min_speed}; expected 0 to 1 rad/s")
        require(self.filter_cutoff >= 0, f"least_squares.filter_cutoff is {self.filter_cutoff}; expected 0 Hz or more")
        require(
            0.01 <= self.block_seconds <= 1e3,
            f"least_squares.block_seconds is {self.block_seconds}; expected 0.01 to 1000 s",
        )
        require(self.max_rows >= 1000, f"least_squares.max_rows is {self.max_rows}; expected 1000 or more")
        require(0 <= self.reweightings <= 20, f"least_squares.reweightings is {self.reweightings}; expected 0 to 20")
        require(self.seed >= 0, f"least_squares.seed is {self.seed}; expected 0 or more")


class LeastSquares:
    """Estimator: ``fit(trajectories)``, ``predict(trajectory)``. Torque is what the drive delivers [N m].

    Learned: ``inertial_parameters_`` (10 n,) in the order of :meth:`Robot.regressor`, ``armature_`` (n,) [kg m^2],
    ``viscous_`` (n,) [N m s/rad], ``coulomb_`` (n,), ``offset_`` (n,) [N m], ``sign_width_`` (n,) [rad/s],
    ``noise_`` (n,) [N m] residual deviation, ``parameters_`` (rows of the parameter table: parameter, expression, unit,
    described, ordinary, value, std_error, relative_std_percent), ``condition_number_`` (whole weighted regressor, unit
    columns), ``base_condition_number_`` (inertial columns in SI units, as the literature reports it).
    """

    def __init__(self, robot: Robot, settings: LeastSquaresSettings | None = None) -> None:
        self.robot = robot
        self.settings = settings or LeastSquaresSettings()
        self.base: BaseParameters = base_parameters(robot, seed=self.settings.seed)

    def fit(self, trajectories: Iterable[Trajectory]) -> LeastSquares:
        """Identify from ``trajectories`` holding ``q dq ddq tau``; raises :class:`InputError` where one does not."""
        settings, robot, n = self.settings, self.robot, self.robot.n_joints
        blocks = block_factors(
            robot,
            self.base,
            trajectories,
            widths=settings.sign_widths,
            min_speed=settings.min_speed,
            block_seconds=settings.block_seconds,
            max_rows=settings.max_rows,
            filter_cutoff=settings.filter_cutoff,
        )
        result = estimate(blocks, self.base.size, settings.reweightings)
        prior_armature = np.array([robot.model.armature[robot.model.idx_vs[i]] for i in robot.joint_ids])
        if settings.physical:
            inertial, armature, friction = physical_least_squares(
                result.factor,
                result.target,
                result.rows,
                self.base.grouping,
                robot.inertial_parameters,
                prior_armature,
                self._armature_scale(),
                settings.prior_weight,
            )
        else:
            # The full vector nearest to the description that has the ordinary estimate's base parameters.
            prior = np.append(robot.inertial_parameters, prior_armature)
            gap = result.x[: self.base.size] - self.base.grouping @ prior
            full = prior + np.linalg.pinv(self.base.grouping) @ gap
            inertial, armature, friction = full[: 10 * n], full[10 * n :], result.x[self.base.size :]
        self.inertial_parameters_, self.armature_ = inertial, armature
        self.viscous_, self.coulomb_, self.offset_ = friction.reshape(3, n)
        self.sign_width_ = np.array([settings.sign_widths[w] for w in result.width_index])
        self.noise_ = result.noise
        self.condition_number_ = result.condition_number
        self.base_condition_number_ = result.base_condition_number
        self.rows_ = result.rows
        self.parameters_ = self._table(result, np.append(robot.inertial_parameters, prior_armature))
        return self

    def predict(self, trajectory: Trajectory) -> Array:
        """Torque (T, n) [N m] at the states ``q dq ddq`` of ``trajectory`` (a features or derivatives table's run).

        With ``filter_cutoff`` the prediction passes the same low-pass as the data of the fit.
        """
        self._check_fitted()
        q, dq, ddq = (trajectory[s] for s in ("q", "dq", "ddq"))
        tau = self._rigid_body(q, dq, ddq) + self.friction_torque(dq)
        taps = low_pass_taps(self.settings.filter_cutoff, trajectory.dt) if self.settings.filter_cutoff else np.ones(1)
        return tau if len(taps) == 1 else _smooth(tau, taps)

    def friction_torque(self, dq: Array) -> Array:
        """Friction and offset (T, n) [N m] at ``dq`` (T, n) [rad/s]."""
        sign = np.column_stack([smooth_sign(dq[:, j], float(w)) for j, w in enumerate(self.sign_width_)])
        return self.viscous_ * dq + self.coulomb_ * sign + self.offset_

    def identified_robot(self) -> Robot:
        """A copy of the robot with the identified inertias and rotor inertias (physical estimates only)."""
        self._check_fitted()
        if not self.settings.physical:
            raise HybridDynamicsError(
                "least squares: an ordinary estimate is not a robot; set least_squares.physical to true"
            )
        robot = self.robot.copy()
        for i, link in zip(robot.joint_ids, self.inertial_parameters_.reshape(-1, 10), strict=True):
            robot.model.inertias[i] = pin.Inertia.FromDynamicParameters(link)
        armature = np.array(robot.model.armature)
        armature[[robot.model.idx_vs[i] for i in robot.joint_ids]] = self.armature_
        robot.model.armature = armature
        return robot

    def _rigid_body(self, q: Array, dq: Array, ddq: Array) -> Array:
        if self.settings.physical:
            return self.identified_robot().inverse_dynamics(q, dq, ddq)
        full = np.append(self.inertial_parameters_, self.armature_)
        parts = [slice(k, k + _CHUNK) for k in range(0, len(q), _CHUNK)]
        return np.concatenate([full_regressor(self.robot, q[s], dq[s], ddq[s]) @ full for s in parts])

    def _armature_scale(self) -> Array:
        """Largest mean own inertia M_jj [kg m^2] of the described robot over random poses, for every joint (n,).

        Reflected rotor inertias of geared wrists exceed what the link's own inertia suggests, so the scale is common.
        """
        rng = np.random.default_rng(self.settings.seed)
        n = self.robot.n_joints
        q = rng.uniform(-np.pi, np.pi, (64, n))
        zero = np.zeros_like(q)
        gravity = self.robot.inverse_dynamics(q, zero, zero)
        own = [
            np.mean((self.robot.inverse_dynamics(q, zero, np.tile(np.eye(n)[j], (64, 1))) - gravity)[:, j])
            for j in range(n)
        ]
        return np.full(n, max(own))

    def _table(self, result: Estimate, prior: Array) -> list[dict[str, Any]]:
        n, p = self.robot.n_joints, self.base.size
        full = np.append(self.inertial_parameters_, self.armature_)
        value = np.concatenate([self.base.grouping @ full, self.viscous_, self.coulomb_, self.offset_])
        described = np.concatenate([self.base.grouping @ prior, np.full(3 * n, np.nan)])
        joints = range(1, n + 1)
        names = [*self.base.base_names, *(f"{f}{j}" for f, _, _ in FRICTION for j in joints)]
        expressions = [*self.base.expressions, *names[p:]]
        units = [*self.base.units, *(unit for _, _, unit in FRICTION for _ in joints)]
        rows = []
        for k, name in enumerate(names):
            error = result.std_error[k]
            rows.append(
                {
                    "parameter": name,
                    "expression": expressions[k],
                    "unit": units[k],
                    "described": None if math.isnan(described[k]) else float(described[k]),
                    "ordinary": float(result.x[k]),
                    "value": float(value[k]),
                    "std_error": float(error) if math.isfinite(error) else None,
                    "relative_std_percent": (
                        float(100 * error / abs(result.x[k])) if math.isfinite(error) and result.x[k] else None
                    ),
                }
            )
        return rows

    def _check_fitted(self) -> None:
        if not hasattr(self, "inertial_parameters_"):
            raise HybridDynamicsError("least squares: not fitted yet; call fit first")

    def to_json(self) -> dict[str, Any]:
        """The fitted model as JSON values (see ``SCHEMA``)."""
        self._check_fitted()
        conditions = {k: getattr(self, f"{k}_") for k in ("condition_number", "base_condition_number")}
        return {
            "schema": 1,
            "method": "least_squares",
            "robot": self.robot.name,
            "joints": list(self.robot.joint_names),
            "settings": asdict(self.settings) | {"sign_widths": list(self.settings.sign_widths)},
            "inertial_parameters": self.inertial_parameters_.reshape(-1, 10).tolist(),
            "armature": self.armature_.tolist(),
            "viscous": self.viscous_.tolist(),
            "coulomb": self.coulomb_.tolist(),
            "offset": self.offset_.tolist(),
            "sign_width": self.sign_width_.tolist(),
            "noise": self.noise_.tolist(),
            **{k: value if math.isfinite(value) else None for k, value in conditions.items()},
            "rows": self.rows_,
            "parameters": self.parameters_,
        }

    @classmethod
    def from_json(cls, document: Mapping[str, Any], robot: Robot) -> LeastSquares:
        """Rebuild what :meth:`to_json` wrote; raises :class:`InputError` where it does not fit the schema or robot."""
        try:
            jsonschema.validate(document, SCHEMA)
        except jsonschema.ValidationError as error:
            where = "/".join(str(part) for part in error.absolute_path) or "document"
            raise InputError(f"least squares model: {where}: {error.message}; fit the model again") from None
        if tuple(document["joints"]) != robot.joint_names:
            raise InputError(
                f"least squares model: is of joints {', '.join(document['joints'])}; robot {robot.name} has "
                f"{', '.join(robot.joint_names)}; give the robot it was fitted on"
            )
        unknown = sorted(set(document["settings"]) - {field.name for field in fields(LeastSquaresSettings)})
        if unknown:
            raise InputError(f"least squares model: settings: unknown name {unknown[0]!r}; fit the model again")
        if len(document["inertial_parameters"]) != robot.n_joints:
            raise InputError(
                f"least squares model: inertial_parameters has {len(document['inertial_parameters'])} links; expected "
                f"{robot.n_joints}; fit it again"
            )
        model = cls(robot, LeastSquaresSettings(**document["settings"]))
        model.inertial_parameters_ = np.array(document["inertial_parameters"], float).ravel()
        for key in ("armature", "viscous", "coulomb", "offset", "sign_width", "noise"):
            values = np.array(document[key], float)
            if values.shape != (robot.n_joints,):
                raise InputError(
                    f"least squares model: {key} has {len(values)} values; expected {robot.n_joints}; fit it again"
                )
            setattr(model, f"{key}_", values)
        for key in ("condition_number", "base_condition_number"):
            setattr(model, f"{key}_", math.inf if document[key] is None else float(document[key]))
        model.rows_ = int(document["rows"])
        model.parameters_ = [dict(row) for row in document["parameters"]]
        return model


def _smooth(values: Array, taps: Array) -> Array:
    """Filter (T, n) by symmetric ``taps``; at the ends the taps inside are renormalised."""
    half = len(taps) // 2
    weight = np.convolve(np.ones(len(values)), taps, mode="full")[half : half + len(values)]
    out = [np.convolve(column, taps, mode="full")[half : half + len(values)] / weight for column in values.T]
    return np.column_stack(out)


_NUMBERS = {"type": "array", "items": {"type": "number"}}
SCHEMA: Mapping[str, Any] = {
    "type": "object",
    "properties": {
        "schema": {"const": 1},
        "method": {"const": "least_squares"},
        "robot": {"type": "string"},
        "joints": {"type": "array", "items": {"type": "string"}, "minItems": 1},
        "settings": {"type": "object"},
        "inertial_parameters": {"type": "array", "items": {**_NUMBERS, "minItems": 10, "maxItems": 10}},
        **dict.fromkeys(("armature", "viscous", "coulomb", "offset", "sign_width", "noise"), _NUMBERS),
        "condition_number": {"type": ["number", "null"]},
        "base_condition_number": {"type": ["number", "null"]},
        "rows": {"type": "integer"},
        "parameters": {"type": "array", "items": {"type": "object"}},
    },
}
SCHEMA = {**SCHEMA, "required": list(SCHEMA["properties"])}
