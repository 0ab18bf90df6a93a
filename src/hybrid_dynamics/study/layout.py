"""Where the files of a dataset are (relative to the project's root)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

REPORTS = Path("reports")
RAW = Path("data/raw")
#: Columns of ``loop.csv`` and of every ``models/loop/steps.csv``.
LOOP_COLUMNS = (
    "dataset",
    "provenance",
    "step",
    "effect",
    "effect_joints",
    "split",
    "trajectory",
    "joint",
    "rmse_before",
    "rmse_after",
)
#: Columns of ``resimulation.csv``: rms state errors [rad, rad/s] over windows [s] of held-out runs, in MuJoCo;
#: no number before where the URDF alone cannot move.
RESIMULATION_COLUMNS = (
    "dataset",
    "provenance",
    "joint",
    "windows",
    "window",
    "position_before",
    "position_after",
    "velocity_before",
    "velocity_after",
)
#: The trajectory name under which errors over all runs of a split stand.
POOL = "all"


@dataclass(frozen=True)
class DatasetFiles:
    """Paths below ``data/<dataset>/``; see docs/architecture.md for who writes what."""

    dataset: str
    root: Path = Path()

    @property
    def folder(self) -> Path:
        """Everything of the data set."""
        return self.root / "data" / self.dataset

    @property
    def source(self) -> Path:
        """Verified copies of the recording."""
        return self.folder / "source"

    @property
    def robot(self) -> Path:
        """The only robot description that later steps read."""
        return self.folder / "robot.urdf"

    @property
    def trajectories(self) -> Path:
        """Runs on a uniform grid."""
        return self.folder / "trajectories.parquet"

    @property
    def derivatives(self) -> Path:
        """Runs with derivatives, all of one bandwidth."""
        return self.folder / "derivatives.parquet"

    @property
    def derivative_errors(self) -> Path:
        """Errors of the differentiators on the twin."""
        return self.folder / "derivative_errors.csv"

    @property
    def features(self) -> Path:
        """Runs with the rigid-body features."""
        return self.folder / "features.parquet"

    @property
    def factor(self) -> Path:
        """Triangular factor of the SINDy library."""
        return self.folder / "factor.safetensors"

    @property
    def errors(self) -> Path:
        """Errors of every method."""
        return self.folder / "errors.parquet"

    @property
    def predictions(self) -> Path:
        """True and predicted torque."""
        return self.folder / "predictions.parquet"

    def model(self, method: str) -> Path:
        """What ``method`` has learned."""
        return self.folder / "models" / method

    def timing(self, method: str) -> Path:
        """Time and memory that ``method`` took."""
        return self.folder / "timing" / f"{method}.json"

    @property
    def resimulation(self) -> Path:
        """State errors in another engine."""
        return self.folder / "resimulation.csv"

    @property
    def park_resimulation(self) -> Path:
        """The same for an arm of the park."""
        return self.folder / "park_resimulation.csv"

    @property
    def park(self) -> Path:
        """What the park says of the arm."""
        return self.folder / "park"

    @property
    def questions(self) -> Path:
        """Answers to what changed."""
        return self.folder / "questions"


@dataclass(frozen=True)
class HiddenFiles:
    """Cases with a hidden answer on the robot of ``dataset``: ``truth`` lies apart, for the stage that scores alone."""

    dataset: str
    root: Path = Path()
    #: Name of the folder below ``data``.
    kind: ClassVar[str]

    @property
    def folder(self) -> Path:
        """Everything of the data set."""
        return self.root / "data" / self.kind / self.dataset

    @property
    def logs(self) -> Path:
        """What the loop may read."""
        return self.folder / "logs"

    @property
    def diagnoses(self) -> Path:
        """What it says of each case."""
        return self.folder / "diagnoses"

    @property
    def scores(self) -> Path:
        """How right it is."""
        return self.folder / "scores.csv"

    @property
    def truth(self) -> Path:
        """What was hidden; read by the scoring alone."""
        return self.root / "data" / f"{self.kind}_truth" / f"{self.dataset}.json"


class AddedFiles(HiddenFiles):
    """Known effects added to recorded runs."""

    kind = "added"


#: Verdict, and key of the reason, where the loop refused the logs of a blind case.
REFUSED = "refused"


class BlindFiles(HiddenFiles):
    """Blind cases."""

    kind = "blind"

    @property
    def timing(self) -> Path:
        """Processor seconds of every case; read by no cached stage but the report."""
        return self.folder / "timing.json"
