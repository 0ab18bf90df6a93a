"""What a user does not use is not loaded: libraries that take a second to import stay out until they are needed."""

import subprocess
import sys

import pytest

SECONDS = {
    "bokeh", "cvxpy", "matplotlib", "mlflow", "pandas", "pyoperon", "pysindy", "pysr", "sklearn", "sympy", "torch",
}  # fmt: skip


def loaded_by(code: str) -> set[str]:
    """Top-level names of all modules a fresh interpreter holds after ``code``."""
    shown = f"{code}\nimport sys; print(*sorted({{name.partition('.')[0] for name in sys.modules}}))"
    result = subprocess.run([sys.executable, "-c", shown], capture_output=True, text=True, check=True)
    return set(result.stdout.splitlines()[-1].split())


@pytest.mark.parametrize(
    "module", ["robots", "readers", "effects", "loop", "models.expressions", "identification", "models", "simulation"]
)
def test_a_module_loads_no_library_it_may_not_need(module):
    allowed = {"models.expressions": {"sympy"}}.get(module, set())
    assert loaded_by(f"import hybrid_dynamics.{module}") & SECONDS <= allowed


def test_what_is_used_is_loaded():
    """The check above would pass for ever if it could not see a library."""
    assert {"sklearn"} <= loaded_by("from hybrid_dynamics.models import SindyEstimator; SindyEstimator")


def test_models_offers_all_its_names():
    import hybrid_dynamics.models as models

    assert {"RigidBody", "METHODS", "load_estimator", "symbolic_regression"} <= set(models.__all__)
    for name in models.__all__:
        assert getattr(models, name) is not None
