"""Where MLflow's database is: at the root of the main repository, wherever the stage happens to run.

DVC runs queued and ``--temp`` experiments in a copy below ``.dvc/tmp/exps`` that is deleted afterwards; a database
beside the code that runs would vanish with it.
"""

from __future__ import annotations

import os
import sqlite3
import subprocess
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

EXPERIMENT = "hybrid_dynamics"


@dataclass(frozen=True)
class Store:
    """The database, the folder of artifacts and the name of the MLflow experiment."""

    database: Path
    artifacts: Path
    experiment: str = EXPERIMENT

    @property
    def uri(self) -> str:
        """Tracking URI."""
        return f"sqlite:///{self.database}"

    @property
    def location(self) -> str:
        """Where MLflow keeps the experiment's artifacts, relative to the root: a project that moves keeps them.

        MLflow resolves it against the working directory; whoever reads artifacts does so in the project's root.
        """
        return (self.artifacts.relative_to(self.database.parent) / self.experiment).as_posix()

    @property
    def lock(self) -> Path:
        """Lock file that lets one writer at a time initialise and write."""
        return self.database.with_name(self.database.name + ".lock")


def root(start: str | os.PathLike[str] = ".") -> Path:
    """Root of the main repository for a process that runs in ``start``.

    In this order: the folder in ``DVC_ROOT`` where ``start`` is inside a DVC experiment (DVC sets it to the main
    repository there); the part of the path before ``.dvc/tmp/exps``; the main checkout of a Git worktree; the nearest
    folder upwards that holds ``.dvc`` or ``.git``; ``start`` itself.
    """
    here = Path(start).resolve()
    copied_from = _before_experiments(here)
    if copied_from is not None:
        named = os.environ.get("DVC_ROOT")
        outside = Path(named).resolve() if named else None
        if outside is not None and (outside / ".dvc").is_dir() and _before_experiments(outside) is None:
            return outside
        return copied_from
    top = next((p for p in (here, *here.parents) if (p / ".dvc").is_dir() or (p / ".git").exists()), here)
    return _main_worktree(top) or top


def _before_experiments(path: Path) -> Path | None:
    parts = path.parts
    for k in range(len(parts) - 2):
        if parts[k : k + 3] == (".dvc", "tmp", "exps"):
            return Path(*parts[:k])
    return None


def _main_worktree(top: Path) -> Path | None:
    """The main checkout of the Git worktree ``top``; None where ``top`` is no linked worktree."""
    if not (top / ".git").is_file():
        return None
    common = _git(top, "rev-parse", "--path-format=absolute", "--git-common-dir")
    return Path(common).parent if common and Path(common).name == ".git" else None


def store(start: str | os.PathLike[str] = ".", experiment: str = EXPERIMENT) -> Store:
    """The store of the project that ``start`` belongs to."""
    anchor = root(start)
    return Store(anchor / "mlflow.db", anchor / "mlartifacts", experiment)


#: Where MLflow keeps locations of artifacts, and the column that says which experiment a row belongs to.
_LOCATIONS = (
    ("experiments", "artifact_location", "experiment_id = :experiment"),
    ("runs", "artifact_uri", "experiment_id = :experiment"),
    ("logged_models", "artifact_location", "experiment_id = :experiment"),
    (
        "model_versions",
        "storage_location",
        "run_id IN (SELECT run_uuid FROM runs WHERE experiment_id = :experiment)",
    ),
)


def make_relative(store: Store, experiment: str, location: str) -> None:
    """Write ``store.location`` in place of the absolute ``location`` of ``experiment`` and of all that lies below it.

    MLflow makes every local location absolute when an experiment is created and offers no call to change it; from the
    experiment's, those of runs and models follow. So it is set in the database, once.
    """
    with closing(sqlite3.connect(store.database)) as connection, connection:
        for table, column, own in _LOCATIONS:
            # Table and column are ours; what comes from the database is bound.
            connection.execute(
                f"UPDATE {table} SET {column} = :new || substr({column}, length(:old) + 1) "
                f"WHERE {own} AND substr({column}, 1, length(:old)) = :old",
                {"new": store.location, "old": location, "experiment": int(experiment)},
            )


def git_revision(start: str | os.PathLike[str] = ".") -> str:
    """Commit of the checkout, ``-dirty`` appended where tracked files differ; ``unknown`` outside a repository."""
    commit = _git(Path(start), "rev-parse", "HEAD")
    if not commit:
        return "unknown"
    return commit + ("-dirty" if _git(Path(start), "status", "--porcelain", "--untracked-files=no") else "")


def _git(folder: Path, *arguments: str) -> str:
    try:
        done = subprocess.run(["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=False)
    except FileNotFoundError:  # no git on this machine
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
