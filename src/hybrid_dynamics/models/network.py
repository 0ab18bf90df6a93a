"""The neural-network baseline: a multilayer perceptron from the features to all joint torques.

Paper, Section "Methods compared": two hidden layers of 128 ReLU units, mean-squared error, Adam with 1e-4, batches of
1024, 100 epochs, no normalisation. As the residual of a hybrid it minimises |tau_rbd + eps(x) - tau|^2.

torch is imported where it is used: it takes seconds, and Julia (PySR) must be started before it in one process.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin

from hybrid_dynamics.errors import needs_extra, require
from hybrid_dynamics.models.base import Weights, check_data, check_features
from hybrid_dynamics.types import Array, Progress

if TYPE_CHECKING:
    import torch


_PREDICT_ROWS = 16_384
#: The order of summation follows the number of threads, so it is fixed: the same weights on every machine. One, since
#: beside busy processes a second one waits more than it works (eight times slower; idle, it gains a tenth).
THREADS = 1


@dataclass(frozen=True)
class NetworkSettings:
    """The paper's settings by default. ``hidden`` holds the widths of the hidden layers."""

    hidden: tuple[int, ...] = (128, 128)
    learning_rate: float = 1e-4
    batch_size: int = 1024
    epochs: int = 100
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "hidden", tuple(self.hidden))
        require(
            len(self.hidden) > 0 and all(isinstance(w, int) and w >= 1 for w in self.hidden),
            f"nn.hidden is {list(self.hidden)}; expected one or more layer widths of 1 or more",
        )
        require(0 < self.learning_rate < 1, f"nn.learning_rate is {self.learning_rate}; expected between 0 and 1")
        require(self.batch_size >= 1, f"nn.batch_size is {self.batch_size}; expected 1 or more")
        require(self.epochs >= 1, f"nn.epochs is {self.epochs}; expected 1 or more")
        require(0 <= self.seed < 2**63, f"nn.seed is {self.seed}; expected 0 or more")


def _torch() -> Any:
    """PyTorch; :class:`MissingDependencyError` where it is not installed."""
    with needs_extra("nn", "a neural network"):
        import torch
    return torch


@contextmanager
def _reproducible() -> Iterator[None]:
    """A fixed number of threads and deterministic kernels, and the caller's choices back afterwards."""
    torch = _torch()
    threads, deterministic = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()
    torch.set_num_threads(THREADS)
    torch.use_deterministic_algorithms(True)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        torch.use_deterministic_algorithms(deterministic)


class NetworkEstimator(RegressorMixin, BaseEstimator):
    """Multilayer perceptron. Learned: ``weights_`` (name to float32 array), ``losses_`` (mean loss of each epoch)."""

    settings_type: ClassVar[type] = NetworkSettings
    engine = ""

    def __init__(self, settings: NetworkSettings | None = None, progress: Progress | None = None) -> None:
        self.settings = settings
        self.progress = progress

    def fit(self, X: Array, y: Array, variance: Array | None = None) -> Self:
        """Train on ``X`` (N, 7n), ``y`` (N, n) [N m]; same seed, same weights."""
        torch = _torch()
        X, y = check_data(X, y)
        settings = self.settings or NetworkSettings()
        self.n_joints_ = y.shape[1]
        generator = torch.Generator().manual_seed(settings.seed)
        with _reproducible():
            inputs, targets = torch.from_numpy(X.astype(np.float32)), torch.from_numpy(y.astype(np.float32))
            network = _network(X.shape[1], settings.hidden, y.shape[1], generator)
            optimizer = torch.optim.Adam(network.parameters(), lr=settings.learning_rate, fused=True)
            loss = torch.nn.MSELoss()
            self.losses_ = []
            for epoch in range(1, settings.epochs + 1):
                order = torch.randperm(len(inputs), generator=generator)
                total = torch.zeros(())
                for batch in order.split(settings.batch_size):
                    optimizer.zero_grad(set_to_none=True)
                    value = loss(network(inputs[batch]), targets[batch])
                    value.backward()
                    optimizer.step()
                    total += value.detach() * len(batch)
                self.losses_.append(float(total) / len(inputs))
                if self.progress is not None:
                    self.progress(epoch / settings.epochs, f"mean squared error {self.losses_[-1]:.3g} N²m²")
        self.weights_ = {name: value.detach().numpy().copy() for name, value in network.state_dict().items()}
        return self

    def predict(self, X: Array) -> Array:
        """(N, n) [N m], in single precision within."""
        torch = _torch()
        X = check_features(X, self.n_joints_)
        out = np.empty((len(X), self.n_joints_))
        hidden = tuple(w.shape[0] for name, w in self.weights_.items() if name.endswith("weight"))[:-1]
        with _reproducible(), torch.inference_mode():
            network = _network(X.shape[1], hidden, self.n_joints_, torch.Generator())
            network.load_state_dict({name: torch.from_numpy(value) for name, value in self.weights_.items()})
            for start in range(0, len(X), _PREDICT_ROWS):
                rows = slice(start, start + _PREDICT_ROWS)
                out[rows] = network(torch.from_numpy(X[rows].astype(np.float32))).numpy()
        return out

    def expressions(self) -> None:
        """None: a network has no closed form worth reading."""
        return None

    def front(self) -> list[dict[str, Any]]:
        """Empty: nothing is traded against complexity."""
        return []

    def document(self, weights: Weights, path: str) -> dict[str, Any]:
        """See :class:`LayerEstimator`."""
        weights.update({f"{path}.{name}": value for name, value in self.weights_.items()})
        return {
            "kind": "network",
            "joints": self.n_joints_,
            "settings": asdict(self.settings or NetworkSettings()),
            "weights": path,
            "layers": list(self.weights_),
            "losses": self.losses_,
        }

    @classmethod
    def from_document(cls, document: dict[str, Any], weights: Weights) -> Self:
        """See :class:`LayerEstimator`."""
        estimator = cls(NetworkSettings(**document["settings"]))
        estimator.n_joints_ = int(document["joints"])
        estimator.weights_ = {name: weights[f"{document['weights']}.{name}"] for name in document["layers"]}
        estimator.losses_ = [float(loss) for loss in document["losses"]]
        return estimator


def _network(inputs: int, hidden: tuple[int, ...], outputs: int, generator: torch.Generator) -> torch.nn.Sequential:
    """Linear layers with ReLU between them, initialised as ``torch.nn.Linear`` does but from ``generator``."""
    torch = _torch()
    layers: list[Any] = []
    widths = (inputs, *hidden, outputs)
    for k, (fan_in, fan_out) in enumerate(pairwise(widths)):
        layer = torch.nn.utils.skip_init(torch.nn.Linear, fan_in, fan_out)
        bound = fan_in**-0.5
        with torch.no_grad():
            layer.weight.uniform_(-bound, bound, generator=generator)
            layer.bias.uniform_(-bound, bound, generator=generator)
        layers.append(layer)
        if k < len(hidden):
            layers.append(torch.nn.ReLU())
    return torch.nn.Sequential(*layers)  # type: ignore[no-any-return]
