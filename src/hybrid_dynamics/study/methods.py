"""The methods in the order and with the labels of the report. A method not listed here comes last, under its name."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Method:
    """``label`` stands in table heads; ``what`` is one sentence for the glossary."""

    name: str
    label: str
    what: str


METHODS: tuple[Method, ...] = (
    Method("rigid_body", "rigid body", "The rigid-body model of the URDF alone; nothing learned."),
    Method(
        "least_squares",
        "least squares",
        "The classical yardstick: base inertial parameters, viscous and Coulomb friction, offset and armature, by "
        "physically consistent least squares.",
    ),
    Method("sr", "SR", "Symbolic regression of the torque."),
    Method("sindy", "SINDy", "Sparse quadratic polynomial of the torque, settings as published."),
    Method("r_sr", "r-SR", "Rigid body + symbolic regression of the residual."),
    Method("r_sindy", "r-SINDy", "Rigid body + sparse quadratic polynomial of the residual, settings as published."),
    Method(
        "r_sindy_sr",
        "r-SINDy-SR",
        "Rigid body + scaled sparse polynomial + symbolic regression of what that leaves.",
    ),
    Method(
        "r_sindy_sr_published",
        "r-SINDy-SR as published",
        "The same on the published (unscaled) sparse polynomial.",
    ),
    Method("nn", "NN", "Multilayer perceptron of the torque."),
    Method("r_nn", "r-NN", "Rigid body + multilayer perceptron of the residual."),
    Method("sindy_scaled", "SINDy scaled", "SINDy with columns and target scaled before thresholding."),
    Method("r_sindy_scaled", "r-SINDy scaled", "r-SINDy with columns and target scaled before thresholding."),
    Method(
        "loop",
        "closed loop",
        "Rigid body + the physical effects that the loop traced, named and added.",
    ),
    Method(
        "true_model",
        "true model",
        "Twins only: the law the data was simulated with, at the same processed states; no competitor.",
    ),
)
_BY_NAME = {method.name: method for method in METHODS}
_ORDER = {method.name: place for place, method in enumerate(METHODS)}

#: What is no learned model: the start, and the truth of a simulated twin.
REFERENCES = ("rigid_body", "true_model")

#: Methods whose expression is the torque itself; those of the ``r_`` methods give the residual.
TORQUE_EXPRESSIONS = ("sr", "sindy", "sindy_scaled")


def label(method: str) -> str:
    """The method's label in table heads."""
    return _BY_NAME[method].label if method in _BY_NAME else method


def what(method: str) -> str:
    """One sentence on the method; empty for a method not listed."""
    return _BY_NAME[method].what if method in _BY_NAME else ""


def in_order(methods: Iterable[str]) -> list[str]:
    """``methods`` without repetition, in the report's order."""
    return sorted(set(methods), key=lambda name: (_ORDER.get(name, len(_ORDER)), name))
