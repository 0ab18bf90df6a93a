"""The methods: one entry each, in the order and with the labels of the report.

A method is a layer on what it is built on (paper, Section "Methods compared"). To add one, write its estimator into a
module of its own (:class:`~hybrid_dynamics.models.base.LayerEstimator`) and give it an entry in :data:`METHODS`; the
stage that trains it is written by ``make deps``. Layers are named by module and class and imported when one is built,
so that a program that needs none of them does not load PyTorch.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from types import MappingProxyType
from typing import Any, Literal

from hybrid_dynamics.errors import ConfigError, require
from hybrid_dynamics.models.base import Estimator, HybridEstimator, LayerEstimator, RigidBody
from hybrid_dynamics.models.factor import Factor
from hybrid_dynamics.types import Progress

#: ``torque``: its expression is the torque; ``residual``: what it adds to the rigid body; ``physical``: parameters of a
#: physical law; ``reference``: nothing learned (the start, and the truth of a simulated twin).
Kind = Literal["torque", "residual", "physical", "reference"]


@dataclass(frozen=True)
class Layer:
    """What is fitted: the class at ``home`` (``module:class``), with the settings of ``section`` in params.yaml.

    ``kind`` names it in model.json. ``fixed`` are settings that make this layer what it is and that no configuration
    may change; ``defaults`` are those that differ from the class's own. ``reduced``: fitted from the data set's
    triangular factor (:class:`Factor`) instead of its samples.
    """

    kind: str
    home: str
    section: str
    fixed: Mapping[str, Any] = field(default_factory=dict)
    defaults: Mapping[str, Any] = field(default_factory=dict)
    reduced: bool = False

    @property
    def module(self) -> str:
        """Full name of the module that holds the estimator."""
        return self.home.partition(":")[0]

    def estimator(self) -> type[LayerEstimator]:
        """The estimator's class. Raises :class:`ConfigError` where there is none at :attr:`home`."""
        module, _, name = self.home.partition(":")
        try:
            found: type[LayerEstimator] = getattr(import_module(module), name)
        except (AttributeError, ModuleNotFoundError) as error:
            raise ConfigError(
                f"layer {self.kind!r}: {self.home} cannot be imported ({error}); correct METHODS"
            ) from None
        return found

    def settings(self, given: Any = None) -> Any:
        """``given`` or the default settings; raises :class:`ConfigError` where a fixed one differs."""
        kind = self.estimator().settings_type
        out = kind(**{**self.defaults, **self.fixed}) if given is None else given
        for name, value in self.fixed.items():
            found = getattr(out, name)
            require(found == value, f"{self.section}.{name} is {_plain(found)}; expected {_plain(value)}")
        return out


def _plain(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)


@dataclass(frozen=True)
class Method:
    """``label`` stands in table heads; ``what`` is one sentence for the glossary.

    ``layer`` is fitted to what the method ``below`` leaves (None: to the whole torque). ``section`` of params.yaml
    shapes the method; that of its layer where it has one.
    """

    name: str
    label: str
    what: str
    kind: Kind
    layer: Layer | None = None
    below: str | None = None
    own_section: str = ""

    @property
    def section(self) -> str:
        """The section of params.yaml that shapes the method."""
        return self.layer.section if self.layer is not None else self.own_section

    @property
    def learned_below(self) -> str | None:
        """The method whose trained model this one is built on; None where nothing below is learned."""
        return self.below if self.below is not None and METHODS[self.below].layer is not None else None


_MODELS = "hybrid_dynamics.models"
SR = Layer("symbolic", f"{_MODELS}.symbolic.estimator:SymbolicEstimator", "sr")
SINDY = Layer("sindy", f"{_MODELS}.sindy:SindyEstimator", "sindy", {"scaled": False}, reduced=True)
SINDY_SCALED = Layer(
    "sindy",
    f"{_MODELS}.sindy:SindyEstimator",
    "sindy_scaled",
    {"scaled": True},
    {"threshold": 1e-3, "alpha": 1e-6},
    reduced=True,
)
NETWORK = Layer("network", f"{_MODELS}.network:NetworkEstimator", "nn")


def _table(*methods: Method) -> Mapping[str, Method]:
    """By name; refuses a name that stands twice, and a chain of methods that does not end at one built on nothing."""
    out: dict[str, Method] = {}
    for method in methods:
        require(method.name not in out, f"method {method.name!r} stands twice in METHODS; give each its own name")
        out[method.name] = method
    for method in methods:
        chain = [method]
        while (below := chain[-1].below) is not None:
            require(
                below in out and chain[-1].layer is not None and len(chain) <= len(out),
                f"method {chain[-1].name!r} is built on {below!r}; expected a layer on another method of METHODS",
            )
            chain.append(out[below])
    return MappingProxyType(out)


METHODS: Mapping[str, Method] = _table(
    Method("rigid_body", "rigid body", "The rigid-body model of the URDF alone; nothing learned.", "reference"),
    Method(
        "least_squares",
        "least squares",
        "The classical baseline: base inertial parameters, viscous and Coulomb friction, offset and armature, by "
        "physically consistent least squares.",
        "physical",
        own_section="least_squares",
    ),
    Method("sr", "SR", "Symbolic regression of the torque.", "torque", SR),
    Method("sindy", "SINDy", "Sparse quadratic polynomial of the torque, settings as published.", "torque", SINDY),
    Method("r_sr", "r-SR", "Rigid body + symbolic regression of the residual.", "residual", SR, "rigid_body"),
    Method(
        "r_sindy",
        "r-SINDy",
        "Rigid body + sparse quadratic polynomial of the residual, settings as published.",
        "residual",
        SINDY,
        "rigid_body",
    ),
    Method(
        "r_sindy_sr",
        "r-SINDy-SR",
        "Rigid body + scaled sparse polynomial + symbolic regression of what that leaves.",
        "residual",
        SR,
        "r_sindy_scaled",
    ),
    Method(
        "r_sindy_sr_published",
        "r-SINDy-SR as published",
        "The same on the published (unscaled) sparse polynomial.",
        "residual",
        SR,
        "r_sindy",
    ),
    Method("nn", "NN", "Multilayer perceptron of the torque.", "torque", NETWORK),
    Method("r_nn", "r-NN", "Rigid body + multilayer perceptron of the residual.", "residual", NETWORK, "rigid_body"),
    Method(
        "sindy_scaled",
        "SINDy scaled",
        "SINDy with columns and target scaled before thresholding.",
        "torque",
        SINDY_SCALED,
    ),
    Method(
        "r_sindy_scaled",
        "r-SINDy scaled",
        "r-SINDy with columns and target scaled before thresholding.",
        "residual",
        SINDY_SCALED,
        "rigid_body",
    ),
    Method(
        "loop",
        "closed loop",
        "Rigid body + the physical effects that the loop traced, named and added.",
        "physical",
        own_section="loop",
    ),
    Method(
        "true_model",
        "true model",
        "Twins only: the law the data was simulated with, at the same processed states; no competitor.",
        "reference",
    ),
)


def layered() -> tuple[str, ...]:
    """Methods that are fitted as a layer (what the stages ``train_<method>`` train, least squares and loop apart)."""
    return tuple(name for name, method in METHODS.items() if method.layer is not None)


def layer_of_kind(kind: str) -> Layer | None:
    """The layer that ``kind`` names in a stored model, or None."""
    return next((m.layer for m in METHODS.values() if m.layer is not None and m.layer.kind == kind), None)


def build_estimator(
    method: str,
    settings: Mapping[str, Any] | None = None,
    *,
    base: Estimator | None = None,
    progress: Progress | None = None,
) -> Estimator:
    """The estimator of ``method``, not fitted. Raises :class:`ConfigError` for an unknown name.

    ``settings`` maps sections of params.yaml to their settings (defaults where one is missing). ``base``, a fitted
    model of the method below, is used as it stands instead of fitting it again. ``progress`` is handed to the layers.
    """
    known = ("rigid_body", *layered())
    require(method in known, f"method is {method!r}; expected one of {', '.join(known)}")
    entry, settings = METHODS[method], settings or {}
    if entry.layer is None:
        return RigidBody()
    layer = entry.layer.estimator()(entry.layer.settings(settings.get(entry.section)), progress)
    if entry.below is None:
        return layer
    first = base if base is not None else build_estimator(entry.below, settings, progress=progress)
    return HybridEstimator(first, layer, base_is_fitted=base is not None)


def is_reduced(method: str) -> bool:
    """Whether ``method`` is fitted from the data set's triangular factor (its layer is, and nothing below learns)."""
    entry = METHODS[method]
    return entry.layer is not None and entry.layer.reduced and entry.learned_below is None


def fit_factor(method: str, settings: Mapping[str, Any] | None, factor: Factor) -> Estimator:
    """The fitted estimator of a ``method`` that takes the factor of its data set (:func:`is_reduced`)."""
    reduced = [name for name in layered() if is_reduced(name)]
    require(method in reduced, f"method is {method!r}; expected a SINDy method ({', '.join(reduced)})")
    estimator = build_estimator(method, settings)
    layer: Any = estimator.residual if isinstance(estimator, HybridEstimator) else estimator
    if not isinstance(estimator, HybridEstimator):
        layer.fit_factor(factor)
        return estimator
    layer.fit_factor(factor.less_rigid_body())
    estimator.n_joints_ = factor.n_joints
    if isinstance(estimator.base, RigidBody):
        estimator.base.n_joints_ = factor.n_joints
    return estimator
