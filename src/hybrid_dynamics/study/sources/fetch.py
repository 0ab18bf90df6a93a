"""Bring a source's files into one folder, and decide whether the dataset is a recording or its simulated twin."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hybrid_dynamics.errors import InputError, SourceError, require
from hybrid_dynamics.files import write_json
from hybrid_dynamics.study.sources.settings import SUPPORT, SourceFile, SourceSettings
from hybrid_dynamics.study.sources.source import MIRROR_VARIABLE, DataSource, Located
from hybrid_dynamics.study.sources.verify import copy_and_digest
from hybrid_dynamics.trajectory import ABSENT, RECORDED, SIMULATED_TWIN
from hybrid_dynamics.types import Notify

MODES = ("auto", "recorded", "twin")
SOURCE_FILE = "source.json"


@dataclass(frozen=True)
class SourceReport:
    """What :func:`fetch` did.

    ``provenance`` is ``recorded``, ``simulated twin`` or ``absent``; ``files`` maps each path that was copied to
    ``size``, ``sha256`` and ``where`` (raw, mirror, network); ``missing`` lists paths that could not be had;
    ``tried`` says, one line a place, why.
    """

    provenance: str
    files: Mapping[str, Mapping[str, Any]]
    missing: tuple[str, ...]
    tried: tuple[str, ...]


def say(message: str) -> None:
    """Print one line at once (stages run with buffered output)."""
    print(message, file=sys.stdout, flush=True)


def fetch(
    source: DataSource,
    target_dir: str | os.PathLike[str],
    mode: str = "auto",
    notify: Notify = say,
    was_recorded: bool = False,
) -> SourceReport:
    """Copy the verified files of ``source`` into ``target_dir`` (replaced as a whole) with a ``source.json``.

    ``mode``: ``recorded`` raises :class:`SourceError` where a file that is not optional is missing; ``auto`` falls back
    to provenance ``simulated twin`` then, and copies the support files that could be had; ``twin`` looks for support
    files only. A source without a twin is ``absent`` instead, and no file is copied. What is written depends on content
    alone, not on where or when it was found.

    A recording never turns into its twin in silence: where ``auto`` has to fall back, but ``target_dir`` holds a
    recording or ``was_recorded`` says that one was used, :class:`SourceError` says how to go on either way.
    """
    require(mode in MODES, f"source is {mode!r}; expected one of {', '.join(MODES)}")
    settings = source.settings
    wanted = [file for file in settings.files if mode != "twin" or file.role == SUPPORT]
    target = Path(target_dir)
    earlier = _earlier(target, settings)
    tried: list[str] = []
    found: dict[str, tuple[SourceFile, Located]] = {}
    for file in wanted:
        located = source.locate(file, tried, target if earlier else None)
        if located is not None:
            found[file.path] = (file, located)
    if mode == "twin" and earlier:
        # What is asked for replaces the folder; a recording that lies nowhere else must not go with it.
        for file in settings.files:
            if file not in wanted:
                source.keep(file, target)
    missing = [file for file in wanted if file.path not in found]
    needed = [file for file in missing if not file.optional]
    if needed and mode == "recorded":
        raise SourceError(_cannot_be_had(source, needed, tried))
    if needed and mode == "auto" and (was_recorded or earlier == RECORDED):
        raise SourceError(_would_turn(source, needed, tried))
    provenance = (SIMULATED_TWIN if settings.twin else ABSENT) if needed or mode == "twin" else RECORDED
    if provenance == ABSENT:
        found = {}
    elif provenance == SIMULATED_TWIN:
        found = {path: entry for path, entry in found.items() if entry[0].role == SUPPORT}
    files = {
        path: {"size": located.digest.size, "sha256": located.digest.sha256, "where": located.where}
        for path, (_, located) in sorted(found.items())
    }
    report = SourceReport(provenance, files, tuple(file.path for file in missing), tuple(tried))
    _write(source, target, {path: located for path, (_, located) in found.items()}, report)
    notify(_summary(source, report, needed, mode))
    if files:
        notify(f"{settings.dataset}: {settings.repository}: licence {settings.licence}. {settings.notice}".rstrip(". "))
    return report


def read_source(target_dir: str | os.PathLike[str]) -> dict[str, Any]:
    """The ``source.json`` that :func:`fetch` wrote into ``target_dir``."""
    path = Path(target_dir) / SOURCE_FILE
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; run the fetch stage (dvc repro)") from None
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON ({error}); run the fetch stage again") from None


def _earlier(target: Path, settings: SourceSettings) -> str | None:
    """Provenance of what an earlier run put into ``target`` from the same source; None where there is none."""
    try:
        value = json.loads((target / SOURCE_FILE).read_text(encoding="utf-8"))
        same = (value["repository"], value["commit"]) == (settings.repository, settings.commit)
        return str(value["provenance"]) if same else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _write(source: DataSource, target: Path, found: Mapping[str, Located], report: SourceReport) -> None:
    if target.exists() and any(target.iterdir()) and not (target / SOURCE_FILE).exists():
        raise SourceError(f"{target}: holds files but no {SOURCE_FILE}; give an empty folder, nothing was changed")
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    try:
        temporary.mkdir(parents=True)
        for path, located in found.items():
            copy = temporary / path
            copy.parent.mkdir(parents=True, exist_ok=True)
            if copy_and_digest(located.path, copy) != located.digest:
                raise SourceError(f"{located.path}: changed while it was copied; run again")
        settings = source.settings
        write_json(
            temporary / SOURCE_FILE,
            {
                "dataset": settings.dataset,
                "provenance": report.provenance,
                "repository": settings.repository,
                "commit": settings.commit,
                "licence": settings.licence,
                "notice": settings.notice,
                "files": {p: {"size": f["size"], "sha256": f["sha256"]} for p, f in report.files.items()},
            },
        )
        if target.exists():
            shutil.rmtree(target)
        os.replace(temporary, target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _summary(source: DataSource, report: SourceReport, needed: list[SourceFile], mode: str) -> str:
    name, count = source.settings.dataset, len(report.files)
    if report.provenance == RECORDED:
        places = sorted({str(entry["where"]) for entry in report.files.values()})
        line = f"{name}: RECORDED data, {count} files verified (from {', '.join(places)})"
        return line + (f", {len(report.missing)} optional ones missing" if report.missing else "")
    if report.provenance == ABSENT:
        why = "source=twin and it has none" if mode == "twin" else "its recording cannot be had"
        reason = f" ({needed[0].path}: {_reasons(needed[0], report.tried)})" if needed and mode != "twin" else ""
        return f"{name}: LEFT OUT, because {why}{reason}"
    if mode == "twin":
        return f"{name}: SIMULATED TWIN, as asked for (source=twin); {count} support files of the recording used"
    reason = _reasons(needed[0], report.tried)
    return (
        f"{name}: SIMULATED TWIN, because {len(needed)} files of the recording cannot be had "
        f"({needed[0].path}: {reason}); {count} support files used"
    )


def _reasons(file: SourceFile, tried: tuple[str, ...] | list[str]) -> str:
    prefix = f"{file.path}: "
    return "; ".join(line.removeprefix(prefix) for line in tried if line.startswith(prefix))


def _would_turn(source: DataSource, needed: list[SourceFile], tried: list[str]) -> str:
    """One line: the recording used so far is gone, and how to go on with it or without."""
    settings = source.settings
    return (
        f"{settings.dataset}: so far a RECORDING was used, and now {len(needed)} of its files cannot be had "
        f"({needed[0].path}: {_reasons(needed[0], tried)}); it is not replaced by its simulated twin in silence: set "
        f"{MIRROR_VARIABLE}=<folder> or put the files under {source.raw_dir}/{settings.repository}, or say source=twin "
        "(dvc exp run -S source=twin)"
    )


def _cannot_be_had(source: DataSource, needed: list[SourceFile], tried: list[str]) -> str:
    """One line: what is missing, what was tried, how to provide it."""
    settings = source.settings
    by_reason: dict[str, list[str]] = {}
    for file in needed:
        reason = _reasons(file, tried)
        by_reason.setdefault(reason, []).append(file.path)
    what = " / ".join(f"{', '.join(paths)} [tried: {reason}]" for reason, paths in by_reason.items())
    where = f"{settings.repository}/<path>"
    return (
        f"{settings.dataset}: recorded data asked for, but missing: {what}. "
        f"Provide them as {source.raw_dir}/{where}, or as <folder>/{where} with {MIRROR_VARIABLE}=<folder>, "
        f"or give this machine access to {source.url(needed[0])}; or use source=auto (simulated twin)"
    )
