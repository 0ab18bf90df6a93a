"""The loop on files: a URDF and logs in, a folder of results out. ``close-loop`` does it once, ``fleet`` often."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from hybrid_dynamics.effects.urdf_dynamics import urdf_dynamics
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.files import check_once
from hybrid_dynamics.loop.close import close_loop
from hybrid_dynamics.loop.described import with_described
from hybrid_dynamics.loop.model import load_model
from hybrid_dynamics.loop.provenance import plain, provenance_of
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.loop_report.output import RESULT_FILES, is_result, write_result
from hybrid_dynamics.readers.description import LogDescription
from hybrid_dynamics.readers.log import read_pieces
from hybrid_dynamics.result_folder import check_result_folder, result_folder
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Notify, Progress


@dataclass(frozen=True)
class LoopFiles:
    """What one loop reads and where its results go.

    ``form`` says how logs in another form are read; ``command`` is noted in the provenance of the result. With
    ``ignore_dynamics`` the friction that the URDF gives is no part of the starting model; with ``model`` it never is.
    """

    robot: Path
    train: tuple[Path, ...]
    out: Path
    test: tuple[Path, ...] = ()
    model: Path | None = None
    lock: tuple[str, ...] = ()
    settings: LoopSettings = field(default_factory=LoopSettings)
    command: Mapping[str, Any] = field(default_factory=dict)
    force: bool = False
    form: LogDescription | None = None
    ignore_dynamics: bool = False

    @property
    def inputs(self) -> tuple[Path, ...]:
        """Every file that is read."""
        return (self.robot, *self.train, *self.test, *([self.model] if self.model else []))

    def check(self) -> None:
        """Raise :class:`InputError` for what is wrong before anything is read."""
        check_result_folder(self.out, RESULT_FILES, self.inputs, force=self.force, ours=is_result)
        check_once(self.train, "--train")
        check_once(self.test, "--test")
        for log in self.test:
            if log.exists() and any(other.exists() and log.samefile(other) for other in self.train):
                raise InputError(f"{log}: is given to --train and to --test; held-out logs must not be learnt from")

    def provenance(self, robot: Robot) -> dict[str, Any]:
        """See :func:`provenance_of`; the same files and settings give the same."""
        form = {} if self.form is None else {"log_form": plain(asdict(self.form))}
        return provenance_of(
            robot,
            self.settings,
            command={**self.command, **form},
            urdf=self.robot,
            train=self.train,
            test=self.test,
            model=self.model,
        )


def close_files(files: LoopFiles, progress: Progress | None = None, note: Notify | None = None) -> dict[str, Any]:
    """Close the loop on ``files`` and write the results; returns the diagnosis.

    ``progress`` hears of the steps, ``note`` what is odd about the logs. Raises :class:`InputError` where no verdict
    can be given; nothing is written then.
    """
    files.check()
    robot = Robot.from_urdf(files.robot, files.lock)
    start = load_model(files.model, robot) if files.model else None
    described = () if files.model or files.ignore_dynamics else urdf_dynamics(files.robot, robot)
    provenance: dict[str, Any] = {}

    def held_out() -> Iterator[Trajectory]:
        yield from read_logs(files.test, robot, "test", note, files.form)
        # The last is read: files as they are now, and copies of training logs are refused before anything is searched.
        provenance.update(files.provenance(robot))

    train = read_logs(files.train, robot, "train", note, files.form)
    result = close_loop(robot, train, held_out(), files.settings, start, progress, described)
    result = with_described(result, described)
    if progress is not None:
        progress(1.0, "writing the report")
    with result_folder(files.out, RESULT_FILES, force=files.force, ours=is_result) as folder:
        diagnosis = write_result(folder, result, provenance)
    return diagnosis.to_json()


def read_logs(
    paths: Sequence[Path],
    robot: Robot,
    split: str,
    note: Notify | None = None,
    log: LogDescription | None = None,
) -> Iterator[Trajectory]:
    """All logs, read as ``log`` says, each when it is asked for; ``note`` hears what is odd about them.

    A log with long gaps gives several runs. Names are file names, made distinct where they repeat.
    """
    stems = [p.stem for p in paths]
    for path in paths:
        name = path.stem if stems.count(path.stem) == 1 else str(path)
        yield from read_pieces(path, robot, f"{split}:{name}", split, notify=note, log=log)
