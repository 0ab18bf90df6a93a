"""The pipeline's habits on a project of four stages: what re-runs, what stays, what a lab shares through a remote."""

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
RECORDING = b"time,q1,tau1\n0,0,0\n"
PIPELINE = """
stages:
  fetch_arm:
    cmd: python -m stages.fetch arm
    always_changed: true
    params: [source, dataset.arm.source]
    outs:
      - data/arm/source: {persist: true}
  trajectories:
    cmd: echo trajectories >> ran && cp data/arm/source/source.json data/arm/trajectories.json
    deps: [data/arm/source]
    outs: [data/arm/trajectories.json]
  train_sindy:
    cmd: echo train_sindy >> ran && cp data/arm/trajectories.json data/arm/sindy.json
    params: [sindy]
    deps: [data/arm/trajectories.json]
    outs: [data/arm/sindy.json]
  train_sr:
    cmd: echo train_sr >> ran && cp data/arm/trajectories.json data/arm/sr.json
    params: [sr]
    deps: [data/arm/trajectories.json]
    outs: [data/arm/sr.json]
"""


class Lab:
    """A small project: its folder, its environment, and what its stages did."""

    def __init__(self, folder: Path, mirror: Path | None) -> None:
        self.folder = folder
        paths = os.pathsep.join([str(ROOT / "src"), str(ROOT), str(Path(sys.executable).parent)])
        self.environment = {k: v for k, v in os.environ.items() if not k.startswith(("DVC", "HYBRID_DYNAMICS"))}
        self.environment |= {"PYTHONPATH": paths, "DVC_NO_ANALYTICS": "1", "NO_PROXY": "*", "HOME": str(folder.parent)}
        self.environment["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), self.environment["PATH"]])
        if mirror is not None:
            self.environment["HYBRID_DYNAMICS_MIRROR"] = str(mirror)

    def dvc(self, *arguments: str, fails: bool = False) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "dvc", *arguments],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert (done.returncode != 0) == fails, done.stdout + done.stderr
        return done.stdout + done.stderr

    def ran(self) -> list[str]:
        """Stages that have run since it was last asked."""
        file = self.folder / "ran"
        words = file.read_text().split() if file.exists() else []
        file.unlink(missing_ok=True)
        return sorted(words)

    def provenance(self) -> str:
        return str(yaml.safe_load((self.folder / "data/arm/sindy.json").read_text())["provenance"])

    def set(self, **values: object) -> None:
        file = self.folder / "params.yaml"
        file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), **values}))


@pytest.fixture
def mirror(tmp_path: Path) -> Path:
    file = tmp_path / "mirror/owner/data/run.csv"
    file.parent.mkdir(parents=True)
    file.write_bytes(RECORDING)
    return tmp_path / "mirror"


def project(folder: Path, mirror: Path | None) -> Lab:
    folder.mkdir(parents=True)
    (folder / "dvc.yaml").write_text(PIPELINE)
    pinned = {"path": "run.csv", "size": len(RECORDING), "sha256": hashlib.sha256(RECORDING).hexdigest()}
    source = {"dataset": "arm", "repository": "owner/data", "commit": "0" * 40, "licence": "none", "files": [pinned]}
    values = {"source": "auto", "dataset": {"arm": {"source": source}}, "sindy": {"threshold": 0.01}, "sr": {"seed": 0}}
    (folder / "params.yaml").write_text(yaml.safe_dump(values))
    lab = Lab(folder, mirror)
    lab.dvc("init", "--no-scm", "--quiet")
    return lab


def test_a_run_without_the_mirror_repeats_only_what_changed(tmp_path: Path, mirror: Path) -> None:
    lab = project(tmp_path / "lab", mirror)
    lab.dvc("repro", "--quiet")
    assert lab.ran() == ["train_sindy", "train_sr", "trajectories"]
    assert lab.provenance() == "recorded"
    del lab.environment["HYBRID_DYNAMICS_MIRROR"]
    lab.set(sindy={"threshold": 0.005})
    lab.dvc("repro", "--quiet")
    assert lab.ran() == ["train_sindy"]
    assert lab.provenance() == "recorded"
    # Asked for, the twin comes; that is the control for the provenance above.
    lab.set(source="twin")
    lab.dvc("repro", "--quiet")
    assert lab.provenance() == "simulated twin"
    # And back: the recording has not gone with it.
    lab.set(source="auto")
    lab.dvc("repro", "--quiet")
    assert lab.provenance() == "recorded"


def test_an_experiment_in_a_copy_finds_the_files_of_the_repository(tmp_path: Path, mirror: Path) -> None:
    lab = project(tmp_path / "lab", None)
    raw = lab.folder / "data/raw/owner/data/run.csv"
    raw.parent.mkdir(parents=True)
    raw.write_bytes(RECORDING)
    copy = tmp_path / "copy"
    copy.mkdir()
    shutil.copy(lab.folder / "params.yaml", copy)
    # DVC names the repository an experiment was started in.
    for environment, found in (({"DVC_ROOT": str(lab.folder)}, "recorded"), ({}, "simulated twin")):
        shutil.rmtree(copy / "data", ignore_errors=True)
        subprocess.run(
            [sys.executable, "-m", "stages.fetch", "arm"], cwd=copy, env=lab.environment | environment, check=True
        )
        assert yaml.safe_load((copy / "data/arm/source/source.json").read_text())["provenance"] == found


def test_a_lab_shares_logs_and_results_through_a_folder(tmp_path: Path, mirror: Path) -> None:
    lab = project(tmp_path / "first", mirror)
    lab.dvc("remote", "add", "--default", "lab", str(tmp_path / "shared"))
    lab.dvc("repro", "--quiet")
    lab.dvc("push", "--quiet")
    colleague = Lab(tmp_path / "second", None)
    colleague.folder.mkdir()
    # What git carries: the pipeline, the parameters, the lock, the name of the remote.
    for name in ("dvc.yaml", "params.yaml", "dvc.lock", ".dvc/config"):
        (colleague.folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(lab.folder / name, colleague.folder / name)
    colleague.dvc("pull", "--quiet")
    assert (colleague.folder / "data/arm/source/run.csv").read_bytes() == RECORDING
    assert colleague.provenance() == "recorded"
    colleague.dvc("repro", "--quiet")
    assert colleague.ran() == [], "everything was there"
    assert colleague.provenance() == "recorded"
