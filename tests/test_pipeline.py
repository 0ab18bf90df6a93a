"""The pipeline as a whole: the committed parameters, one pass through DVC at a small scale, one experiment."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
import yaml
from dvc.repo import Repo
from stages import dag, generate_sim
from stages.compose import compose

from hybrid_dynamics.errors import ConfigError
from hybrid_dynamics.trajectory import SIMULATED, read_metadata, read_trajectories

ROOT = Path(__file__).resolve().parents[1]
#: One arm of the park beside, whose recording cannot be had: it is left out. Each further one costs every pass a while.
PARK = ["fetched=[tx40]", "park=[ur10e,tx40]", "added_arms=[tx40]"]
#: One arm through all methods, the one with the longer way (fetched, a twin, asked); the blind cases are the Panda's,
#: which has no data of its own here.
SMALL = ["scale=small", "datasets=[ur10e]", "recorded=[ur10e]", *PARK]


def test_params_are_the_composition_of_conf(tmp_path):
    compose(tmp_path / "params.yaml", [])
    assert (tmp_path / "params.yaml").read_text() == (ROOT / "params.yaml").read_text(), "run `make params`"


def test_the_page_of_the_stages_is_the_one_of_the_pipeline(monkeypatch):
    monkeypatch.chdir(ROOT)
    stages = dag.pipeline()
    written = (ROOT / "docs/pipeline.md").read_text()
    assert written == dag.page(stages, dag.diagram()), "run `make dag`"
    assert all(f"| `{name}` |" in written for name in stages)
    # The control: a stage more, or another file, is another page.
    more = stages | {"polish": {"outs": ["reports/index.html"]}}
    assert dag.page(more, "") != dag.page(stages, "")


def test_the_table_of_files_in_the_architecture_is_the_one_of_the_pipeline():
    """Every file of data/<dataset>/ that a stage writes stands there, with the stages that write it, and no other."""
    text = (ROOT / "docs/architecture.md").read_text()
    head = text[: text.index("## Modules")]
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in head.splitlines() if line.startswith("| `")
    ]
    told: dict[str, set[str]] = {}
    for row in rows:
        for name in re.findall(r"`([^`]+)`", row[0]):
            told[top(name)] = set(re.findall(r"`([^`]+)`", row[1]))
    writers: dict[str, set[str]] = {}
    for stage, content in dag.pipeline().items():
        for out in content.get("outs", ()):
            parts = next(iter(out) if isinstance(out, dict) else iter([out])).split("/")
            if parts[0] == "data" and parts[1] in ("${item.dataset}", "ur10e", "wam"):
                writers.setdefault(top("/".join(parts[2:])), set()).add(stage)
    assert told.keys() == writers.keys()
    for name, stages in told.items():
        kinds = [re.sub(r"@.*", "", stage).replace("<method>", ".+").replace("<dataset>", ".+") for stage in stages]
        for stage in writers[name]:
            assert any(re.fullmatch(kind, stage) for kind in kinds), f"{name}: written by {stage}, told {stages}"
        for kind in kinds:
            assert any(re.fullmatch(kind, stage) for stage in writers[name]), f"{name}: {kind} does not write it"


def top(path: str) -> str:
    """The file or folder beside the robot's."""
    return path.split("/")[0]


def told_overrides() -> list[str]:
    """Every value that a page, a comment or a message says can be given to ``dvc exp run -S``, sweeps one by one."""
    places = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "conf").rglob("*.yaml")]
    places += [*(ROOT / "src").rglob("*.py"), *(ROOT / "stages").rglob("*.py")]
    words = {w for p in places for w in re.findall(r"""-S '?([a-z][\w@.]*=[^\s`'")]+)""", p.read_text("utf-8"))}
    out = {f"{key}={one}" for key, _, value in (w.partition("=") for w in words) for one in value.split(",")}
    return sorted(out)


def test_every_override_that_is_told_can_be_given(tmp_path):
    told = told_overrides()
    assert {"source=twin", "source=recorded", "scale=small", "sindy.threshold=0.005"} <= set(told)
    for override in told:
        compose(tmp_path / "params.yaml", [override])
        key, _, value = override.partition("=")
        if key == "source":
            assert yaml.safe_load((tmp_path / "params.yaml").read_text())["source"] == value
    # The control: what is not there is refused.
    with pytest.raises(ConfigError):
        compose(tmp_path / "params.yaml", ["sources=twin"])


@pytest.mark.parametrize("overrides", [[], ["study=custom"], ["scale=small"], ["blind=full"], SMALL], ids=str)
def test_every_study_is_closed(tmp_path, overrides):
    """What a stage reads from data/ or reports/, another stage of the same study writes."""
    folder = clone(tmp_path)
    compose(folder / "params.yaml", overrides)
    assert dvc(folder, "init", "--no-scm", "--force").returncode == 0
    with Repo(str(folder)) as repo:
        stages = [stage for stage in repo.index.stages if stage.cmd]
        written = {out.def_path for stage in stages for out in stage.outs}
        for stage in stages:
            for needed in (dep.def_path for dep in stage.deps):
                if needed.startswith(("data/", "reports/")):
                    known = any(needed == out or needed.startswith(out + "/") for out in written)
                    assert known, f"{stage.name} reads {needed}; no stage of this study writes it"
    names = {stage.name for stage in stages}
    assert {"fetch@custom", "close_loop@custom"} & names == (
        {"fetch@custom", "close_loop@custom"} if "study=custom" in overrides else set()
    )


def clone(folder: Path) -> Path:
    """The tracked and new files of this checkout as a repository of its own, with a small study."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, check=True)
    for name in filter(None, listed.stdout.decode().split("\0")):
        if name == "dvc.lock" or not (ROOT / name).is_file():
            continue
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, folder / name)
    compose(folder / "params.yaml", SMALL)
    for command in (["init", "-q"], ["add", "-A"], ["commit", "-q", "-m", "start"]):
        identity = ["-c", "user.name=test", "-c", "user.email=test@example.org"]
        subprocess.run(["git", *identity, *command], cwd=folder, check=True)
    return folder


def dvc(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return run(folder, "dvc", *arguments)


def run(folder: Path, module: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if k not in ("HYBRID_DYNAMICS_MIRROR", "DVC_ROOT")}
    environment |= {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "OMP_NUM_THREADS": "1",
        "GIT_AUTHOR_NAME": "test",
        "GIT_AUTHOR_EMAIL": "test@example.org",
        "GIT_COMMITTER_NAME": "test",
        "GIT_COMMITTER_EMAIL": "test@example.org",
    }
    command = [sys.executable, "-m", module, *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=3000)


def test_the_simulated_arm_of_the_paper_is_written_with_what_it_is(tmp_path, monkeypatch):
    """The one stage that the pass below does without; its numbers are tested where it is simulated."""
    monkeypatch.chdir(tmp_path)
    compose(tmp_path / "params.yaml", ["scale=small"])
    monkeypatch.setattr(sys, "argv", ["generate_sim", "panda"])
    generate_sim.main()
    file = tmp_path / "data/panda/trajectories.parquet"
    runs, metadata = read_trajectories(file), read_metadata(file)
    assert [run.split for run in runs] == ["train", "train", "test"]
    assert {run.signals["tau"].shape[1] for run in runs} == {7}
    assert metadata["provenance"] == SIMULATED
    assert len(metadata["damping"]) == 7


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = clone(tmp_path_factory.mktemp("study"))
    done = dvc(folder, "repro")
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return folder, done.stdout


def test_one_pass_writes_every_report(study):
    folder, output = study
    assert "SIMULATED TWIN" in output, "a twin must be announced"
    errors = pd.read_csv(folder / "reports/rmse.csv")
    assert set(errors["dataset"]) == {"ur10e"}
    assert set(errors["provenance"]) == {"simulated twin"}
    methods = set(errors["method"])
    assert {"rigid_body", "least_squares", "sr", "sindy", "r_sr", "r_sindy", "r_sindy_sr", "nn", "r_nn"} <= methods
    assert {"sindy_scaled", "r_sindy_scaled", "r_sindy_sr_published", "loop"} <= methods
    page = (folder / "reports/index.html").read_text()
    assert "simulated twin" in page
    assert "<script src" not in page
    assert (folder / "mlflow.db").is_file()


def test_second_pass_runs_source_checks_only(study):
    folder, _ = study
    done = dvc(folder, "repro")
    assert done.returncode == 0, done.stderr
    ran = [line for line in done.stdout.splitlines() if line.startswith("Running stage")]
    names = {line.split("'")[1] for line in ran}
    fetching = {name for name in names if name.startswith("fetch")}
    assert {"fetch_ur10e", "fetch_wam"} <= fetching
    assert names - fetching == {"track"}
    assert "0 of" in done.stdout, "nothing new may be logged to MLflow"


def test_experiment_overrides_one_value_and_re_runs_what_depends_on_it(study):
    folder, _ = study
    done = dvc(folder, "exp", "run", *(part for o in SMALL for part in ("-S", o)), "-S", "sindy.threshold=0.02")
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-3000:]
    assert yaml.safe_load((folder / "params.yaml").read_text())["sindy"]["threshold"] == 0.02
    ran = {line.split("'")[1].split("@")[0] for line in done.stdout.splitlines() if line.startswith("Running stage")}
    assert {"train_sindy", "train_r_sindy", "evaluate", "report"} <= ran
    assert not ran & {"trajectories", "featurize", "train_sindy_scaled", "train_nn", "train_sr", "close_loop"}


@pytest.mark.parametrize(
    ("override", "message", "command"),
    [
        ("sindy.threshold=abc", "sindy.threshold is 'abc'", ("dvc", "repro", "--single-item", "train_sindy@ur10e")),
        ("sindy.threshold=-1", "sindy.threshold is -1", ("stages.train", "sindy", "ur10e")),
        ("nn.epochs=0", "nn.epochs is 0", ("stages.train", "nn", "ur10e")),
    ],
)
def test_wrong_parameter_is_one_line(study, override, message, command):
    folder, _ = study
    compose(folder / "params.yaml", [*SMALL, override])
    done = run(folder, *command)
    compose(folder / "params.yaml", SMALL)
    assert done.returncode != 0
    lines = [line for line in done.stderr.splitlines() if line.startswith("error:")]
    assert len(lines) == 1, done.stderr
    assert message in lines[0]
    assert "Traceback" not in done.stderr


def test_unknown_parameter_is_refused(study):
    folder, _ = study
    done = dvc(folder, "exp", "run", "-S", "sindy.treshold=0.1")
    assert done.returncode != 0
    assert "treshold" in done.stderr
