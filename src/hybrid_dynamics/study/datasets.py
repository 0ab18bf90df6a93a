"""What a dataset of the study is, as configured in ``conf/dataset/``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from hybrid_dynamics.errors import InputError, require
from hybrid_dynamics.readers import (
    LogDescription,
    Notify,
    Ur10eSettings,
    read_pieces,
    read_ur10e,
    read_wam,
    read_wam_reference,
)
from hybrid_dynamics.robots import Robot, find_description, lock_joints
from hybrid_dynamics.robots.dh import DHLimit, DHLink, DHRow, dh_to_urdf
from hybrid_dynamics.simulation import (
    ControllerSettings,
    Reference,
    ReferenceSettings,
    SimulationSettings,
    reference_from_positions,
)
from hybrid_dynamics.simulation.sensors import SensorSettings
from hybrid_dynamics.simulation.twin import DriveFriction, Recording, simulate_twin, with_armature
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array, Progress

PACKAGE = "package:"
SOURCE = "source:"


@dataclass(frozen=True)
class DHSettings:
    """A robot as a standard Denavit-Hartenberg table with link inertials, one entry a joint."""

    name: str
    joint_names: tuple[str, ...]
    rows: tuple[DHRow, ...]
    links: tuple[DHLink, ...]
    limits: tuple[DHLimit, ...]


@dataclass(frozen=True)
class RobotSettings:
    """Where the robot's description is and which joints are fixed.

    ``urdf``: a path, ``package:<end of path>`` (a file of example-robot-data) or ``source:<path>`` (a file of the
    dataset's source); ``fallback``: the same, for a source that cannot be had. ``without``: joints taken off with all
    that hangs on them (a hand that was not mounted). Or ``dh``: a Denavit-Hartenberg table.
    """

    urdf: str = ""
    fallback: str = ""
    lock: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    dh: DHSettings | None = None


@dataclass(frozen=True)
class StudySimulation:
    """The simulated study: rollouts per split, viscous ``damping`` (n,) [N m s/rad], and how they are made."""

    damping: tuple[float, ...]
    n_train: int = 10
    n_test: int = 10
    rollout: SimulationSettings = field(default_factory=SimulationSettings)
    reference: ReferenceSettings = field(default_factory=ReferenceSettings)
    controller: ControllerSettings = field(default_factory=ControllerSettings)

    def __post_init__(self) -> None:
        require(all(d >= 0 for d in self.damping), f"simulation.damping is {list(self.damping)}; expected values >= 0")
        for name in ("n_train", "n_test"):
            require(getattr(self, name) >= 1, f"simulation.{name} is {getattr(self, name)}; expected 1 or more")


@dataclass(frozen=True)
class CarriedBody:
    """A body on the last moving link: ``mass`` [kg], ``com`` (3) [m] in the last moving joint's frame, and principal
    moments ``inertia`` (3) [kg m^2] about its centre of mass, along that frame's axes."""

    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float]

    def added_to(self, robot: Robot) -> Robot:
        """A copy of ``robot`` that carries it."""
        out = robot.copy()
        last = max(out.joint_ids)
        body = pin.Inertia(self.mass, np.array(self.com), np.diag(self.inertia))
        out.model.inertias[last] = out.model.inertias[last] + body
        return out


@dataclass(frozen=True)
class RecordedRun:
    """One recorded run: its ``file`` in the source, its ``split``, and the usable ``rows`` (1-based; empty: found).

    ``payload``: what the run's simulated twin carries.
    """

    name: str
    split: str
    file: str
    rows: tuple[int, ...] = ()
    payload: CarriedBody | None = None

    def __post_init__(self) -> None:
        require(self.split in ("train", "test"), f"run {self.name}: split is {self.split!r}; expected train or test")
        require(
            len(self.rows) in (0, 2), f"run {self.name}: rows is {list(self.rows)}; expected [first, last] or nothing"
        )


def robot_description(settings: RobotSettings, source: Path | None = None) -> str:
    """The dataset's robot as URDF text, joints locked, geometry left out.

    Raises :class:`InputError` where neither the description nor its fallback is there.
    """
    if settings.dh is not None:
        table = settings.dh
        return dh_to_urdf(table.name, table.joint_names, table.rows, table.links, table.limits)
    for place in filter(None, (settings.urdf, settings.fallback)):
        path = _resolve(place, source)
        if path is not None and path.is_file():
            return lock_joints(path, settings.lock, settings.without)
    raise InputError(f"robot description {settings.urdf!r} cannot be found; give the path of a URDF in robot.urdf")


def _resolve(place: str, source: Path | None) -> Path | None:
    if place.startswith(PACKAGE):
        return find_description(place.removeprefix(PACKAGE))
    if place.startswith(SOURCE):
        return source / place.removeprefix(SOURCE) if source is not None else None
    copy = source / taken_in(place) if source is not None else None
    return copy if copy is not None and copy.is_file() else Path(place)


def taken_in(path: str) -> str:
    """Where a file given by ``path`` lies below the dataset's source folder."""
    return Path(path).as_posix().lstrip("/.")


@dataclass(frozen=True)
class TwinSettings:
    """The simulated twin of a recorded dataset: drive losses, sensors, and what it follows.

    ``follow``: files of the source with reference positions (one per run), sampled every ``follow_period`` [s]; where
    they cannot be had, and where none are named, multi-sines drawn with ``reference`` are followed.
    """

    friction: DriveFriction
    sensors: SensorSettings
    rollout: SimulationSettings = field(default_factory=SimulationSettings)
    reference: ReferenceSettings = field(default_factory=ReferenceSettings)
    controller: ControllerSettings = field(default_factory=ControllerSettings)
    follow: tuple[str, ...] = ()
    follow_period: float = 1e-3


def twin_runs(
    robot: Robot,
    settings: TwinSettings,
    runs: Sequence[RecordedRun],
    source: Path,
    seed: int,
    progress: Progress | None = None,
) -> list[Recording]:
    """Log and noise-free truth of every run of the twin, named and split like the recording's ``runs``, training first.

    Raises :class:`InputError` where a reference cannot be followed.
    """
    ordered = sorted(runs, key=lambda run: run.split != "train")
    n_train = sum(run.split == "train" for run in runs)
    files = [source / path for path in settings.follow]
    references: ReferenceSettings | list[Reference] = settings.reference
    if files and all(file.is_file() for file in files):
        rate = 1 / settings.rollout.control_period
        references = [
            reference_from_positions(read_wam_reference(file), settings.follow_period, name=file.name, rate=rate)
            for file in files
        ]
    return simulate_twin(
        robot,
        settings.rollout,
        settings.friction,
        settings.sensors,
        references,
        control=settings.controller,
        n_train=n_train,
        n_test=len(runs) - n_train,
        seed=seed,
        names=[run.name for run in ordered],
        progress=progress,
    )


def true_torque(robot: Robot, friction: DriveFriction, run: Trajectory) -> Array:
    """Torque (T, n) [N m] of the twin's own law at the states ``q dq ddq`` of ``run``: no method can know better."""
    zero = (0.0,) * robot.n_joints
    dq = run["dq"]
    rigid = with_armature(robot, friction.armature or zero).inverse_dynamics(run["q"], dq, run["ddq"])
    losses = np.array(friction.viscous or zero) * dq + np.array(friction.coulomb or zero) * np.sign(dq)
    return np.asarray(rigid + losses + np.array(friction.offset or zero))


@dataclass(frozen=True)
class ReaderSettings:
    """How the files of a recorded dataset are read: ``format`` is ``ur10e``, ``wam`` or ``log``.

    ``log``: what a ``log.yaml`` says of logs that are not in the layout of a user's log.
    """

    format: str
    ur10e: Ur10eSettings = field(default_factory=Ur10eSettings)
    dt: float = 0.0
    log: LogDescription | None = None

    def __post_init__(self) -> None:
        require(
            self.log is None or self.format == "log",
            f"reader.log is given for reader.format {self.format!r}; expected format log",
        )
        require(
            self.format in ("ur10e", "wam", "log"),
            f"reader.format is {self.format!r}; expected ur10e, wam or log",
        )


def read_run(
    settings: ReaderSettings, run: RecordedRun, folder: Path, robot: Robot, notify: Notify
) -> list[Trajectory]:
    """One recorded run of ``folder`` on a uniform grid; several parts where a user's log has long gaps."""
    path = folder / taken_in(run.file)
    if settings.format == "ur10e":
        window = (run.rows[0], run.rows[1]) if run.rows else None
        return [read_ur10e(path, run.name, run.split, settings.ur10e, window, notify)]
    if settings.format == "wam":
        return [read_wam(path, run.name, run.split, settings.dt, notify)]
    log = settings.log
    if run.rows:
        log = replace(log or LogDescription(), rows=run.rows)
    return read_pieces(path, robot, run.name, run.split, notify=notify, log=log)


def picture_of(settings: RobotSettings) -> Path | None:
    """The URDF with meshes the report draws the arm from; None where the description has none to draw."""
    return _resolve(settings.urdf, None) if settings.urdf.startswith(PACKAGE) else None
