"""Run a fleet: every loop that is not done yet, then the tables. Stopped at any moment, the next run goes on."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hybrid_dynamics.close_files import LoopFiles, close_files
from hybrid_dynamics.engine import Engine, Local
from hybrid_dynamics.errors import HybridDynamicsError, InputError, one_line
from hybrid_dynamics.files import check_folder, write_json
from hybrid_dynamics.fleet.manifest import Entry
from hybrid_dynamics.fleet.tables import TABLES, write_tables
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.readers.description import LogDescription
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Notify, Progress

RUNS, MARK = "runs", "fleet.json"


@dataclass(frozen=True)
class Outcome:
    """What became of one loop: ``state`` is ``done``, ``kept`` (done before) or ``refused``, with ``why``."""

    name: str
    state: str
    why: str = ""


@dataclass(frozen=True)
class FleetResult:
    """Outcomes in the order of the manifest, and the tables that were written (none by a part of a fleet)."""

    outcomes: tuple[Outcome, ...]
    tables: tuple[Path, ...]

    def count(self, state: str) -> int:
        """Number of runs that ended as ``state``."""
        return sum(outcome.state == state for outcome in self.outcomes)


def check_out(out: Path, *, force: bool) -> None:
    """Raise :class:`InputError` where ``out`` holds something else than a fleet's results."""
    check_folder(out)
    if out.is_dir() and any(out.iterdir()) and not (out / MARK).is_file() and not force:
        name = min(p.name for p in out.iterdir())
        raise InputError(
            f"{out}: holds {name}, and no results of a fleet; give another folder, or --force to put them there"
        )


def run_fleet(
    entries: Sequence[Entry],
    out: Path,
    settings: LoopSettings | None = None,
    engine: Engine | None = None,
    progress: Progress | None = None,
    note: Notify | None = None,
    *,
    form: LogDescription | None = None,
    force: bool = False,
    part: tuple[int, int] = (1, 1),
) -> FleetResult:
    """Close the loop for every entry, each into ``out/runs/<name>`` as a whole, and write the tables.

    A loop whose result is there, from the same files and settings by the same version, is kept. A loop that is refused
    (unusable logs) stops no other. ``part`` (k, m) takes the k-th of every m entries and writes no tables: m machines
    share the work so, and a last run over all entries finds it done and writes them.
    """
    first, step = part
    if not 1 <= first <= step:
        raise InputError(
            f"part is {first}/{step}; expected such as 1/{max(step, 1)}, the first of {max(step, 1)} parts"
        )
    check_out(out, force=force)
    settings = settings or LoopSettings()
    jobs = [
        LoopFiles(
            entry.robot,
            entry.train,
            out / RUNS / entry.name,
            entry.test,
            entry.model,
            entry.lock,
            settings,
            {"command": "fleet", "name": entry.name},
            force,
            form,
        )
        for entry in entries[first - 1 :: step]
    ]
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / MARK, {"schema": 1, "runs": [entry.name for entry in entries]})
    outcomes: dict[int, Outcome] = {}
    for k, outcome in (engine or Local()).unordered(run_one, jobs):
        outcomes[k] = outcome
        if progress is not None:
            progress(len(outcomes) / len(jobs), f"{outcome.name}: {outcome.state}")
        if note is not None and outcome.why:
            note(f"{outcome.name}: {outcome.why}")
    ordered = tuple(outcomes[k] for k in range(len(jobs)))
    if step > 1:
        return FleetResult(ordered, ())
    write_tables(out, entries, {o.name: o.why for o in ordered if o.state == "refused"}, out / RUNS)
    return FleetResult(ordered, tuple(out / name for name in TABLES))


def run_one(files: LoopFiles) -> Outcome:
    """One loop of a fleet, in whichever process."""
    name = files.out.name
    try:
        if _done(files):
            return Outcome(name, "kept")
        close_files(files)
        return Outcome(name, "done")
    except HybridDynamicsError as error:
        return Outcome(name, "refused", one_line(error))


def _done(files: LoopFiles) -> bool:
    """Whether the folder holds the result of these very files and settings."""
    try:
        value: dict[str, Any] = json.loads((files.out / "diagnosis.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    wanted = files.provenance(Robot.from_urdf(files.robot, files.lock))
    # Through JSON, as the stored one has gone.
    return bool(value.get("provenance") == json.loads(json.dumps(wanted)))
