"""What is installed without extras is enough for the loop; what needs an extra says so in one line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.small_arm import arm, write_logs

from hybrid_dynamics.errors import MissingDependencyError, needs_extra
from hybrid_dynamics.models import NetworkEstimator
from hybrid_dynamics.readers import read_log

#: Packages that only an extra brings (pyproject.toml).
EXTRAS = {
    "export": ("casadi", "mujoco"),
    "onnx": ("onnx",),
    "bags": ("mcap", "mcap_ros1", "mcap_ros2", "rosbags"),
    "nn": ("torch", "safetensors"),
    "pysr": ("pysr",),
    "study": ("cvxpy", "dvc", "hydra", "matplotlib", "mlflow", "pydantic", "pysindy", "requests", "trimesh"),
}


@pytest.fixture
def bare(monkeypatch: pytest.MonkeyPatch) -> None:
    """This interpreter as if no extra were installed: a module that is None cannot be imported."""
    blocked = {name for names in EXTRAS.values() for name in names}
    # A submodule that another test has loaded would be found without its package: it is blocked by its own name.
    for name in [*blocked, *(name for name in sys.modules if name.partition(".")[0] in blocked)]:
        monkeypatch.setitem(sys.modules, name, None)
    # A module that another test has loaded is also an attribute of its package.
    monkeypatch.delitem(sys.modules, "hybrid_dynamics.readers.decoders", raising=False)
    monkeypatch.delattr("hybrid_dynamics.readers.decoders", raising=False)


def test_a_bag_without_its_extra_is_refused_with_the_remedy(bare: None, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"0123456789")
    with pytest.raises(MissingDependencyError, match=r"needs the package mcap.*pip install '\.\[bags\]'"):
        read_log(tmp_path / "a.mcap", arm().joint_names)


def test_a_network_without_its_extra_is_refused_with_the_remedy(bare: None) -> None:
    X = np.random.default_rng(0).normal(size=(50, 14))
    with pytest.raises(MissingDependencyError, match=r"pip install '\.\[nn\]'"):
        NetworkEstimator().fit(X, X[:, :2])


def test_an_error_that_is_no_missing_package_passes_through() -> None:
    with pytest.raises(ZeroDivisionError), needs_extra("nn", "x"):
        _ = 1 / 0


def test_the_loop_and_prediction_run_without_any_extra(tmp_path: Path) -> None:
    folder = write_logs(tmp_path)
    blocked = sorted(name for names in EXTRAS.values() for name in names)
    code = (
        "import sys\n"
        "class Blocked:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name.partition('.')[0] in {blocked!r}: raise ModuleNotFoundError(name, name=name)\n"
        "sys.meta_path.insert(0, Blocked())\n"
        "from hybrid_dynamics.cli import main\n"
        "for line in sys.stdin.read().splitlines():\n"
        "    try: main(line.split())\n"
        "    except SystemExit as stop: assert not stop.code, (line, stop.code)\n"
    )
    commands = (
        "close-loop --robot robot.urdf --train train_1.parquet --test test_1.parquet --out out\n"
        "predict --model out/model.json --robot robot.urdf --data test_1.parquet --out predicted.parquet\n"
    )
    done = subprocess.run([sys.executable, "-c", code], input=commands, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (folder / "predicted.parquet").is_file()
