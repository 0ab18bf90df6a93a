"""What names a data source: repository, commit, and per file its path, size and digest."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import PurePosixPath
from typing import Any

from hybrid_dynamics.errors import ConfigError, require

RECORDING = "recording"
SUPPORT = "support"


@dataclass(frozen=True)
class SourceFile:
    """One pinned file.

    ``path`` is relative to the repository. A file is pinned by ``sha256`` (hex) and ``size`` [bytes], or by
    ``git_blob``, the SHA-1 that git gives to its content. ``role`` is ``recording`` (measured data, replaced by the
    twin when it cannot be had) or ``support`` (a URDF, reference trajectories: of use to the twin as well). An
    ``optional`` file may be missing.
    """

    path: str
    size: int | None = None
    sha256: str | None = None
    git_blob: str | None = None
    role: str = RECORDING
    optional: bool = False

    def __post_init__(self) -> None:
        pure = PurePosixPath(self.path)
        inside = bool(self.path) and not pure.is_absolute() and ".." not in pure.parts and "\\" not in self.path
        require(inside, f"source file {self.path!r}: expected a relative path inside the repository")
        require(
            self.sha256 is None or re.fullmatch(r"[0-9a-f]{64}", self.sha256) is not None,
            f"source file {self.path}: sha256 is {self.sha256!r}; expected 64 lower-case hexadecimal digits",
        )
        require(
            self.git_blob is None or re.fullmatch(r"[0-9a-f]{40}", self.git_blob) is not None,
            f"source file {self.path}: git_blob is {self.git_blob!r}; expected 40 lower-case hexadecimal digits",
        )
        require(
            self.sha256 is not None or self.git_blob is not None,
            f"source file {self.path}: no digest; pin it by sha256 or git_blob",
        )
        require(
            self.size is None or self.size >= 0, f"source file {self.path}: size is {self.size}; expected bytes >= 0"
        )
        require(
            self.role in (RECORDING, SUPPORT),
            f"source file {self.path}: role is {self.role!r}; expected '{RECORDING}' or '{SUPPORT}'",
        )


@dataclass(frozen=True)
class SourceSettings:
    """A repository at one commit and the files wanted from it, with the licence that is shown when they are used."""

    dataset: str
    repository: str
    commit: str
    licence: str
    files: tuple[SourceFile, ...]
    notice: str = ""

    def __post_init__(self) -> None:
        require(
            re.fullmatch(r"[A-Za-z0-9_.-]+/[A-Za-z0-9_.-]+", self.repository) is not None,
            f"source {self.dataset}: repository is {self.repository!r}; expected 'owner/name'",
        )
        require(
            re.fullmatch(r"[0-9a-f]{40}", self.commit) is not None,
            f"source {self.dataset}: commit is {self.commit!r}; expected 40 lower-case hexadecimal digits",
        )
        require(len(self.files) > 0, f"source {self.dataset}: no files; list at least one")
        paths = [file.path for file in self.files]
        twice = sorted({path for path in paths if paths.count(path) > 1})
        require(not twice, f"source {self.dataset}: file {twice[0] if twice else ''} is listed twice; keep one")

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> SourceSettings:
        """Settings from plain configuration values (``files`` a list of mappings); unknown keys are refused."""
        plain = dict(values)
        _refuse_unknown(plain, cls, f"source {plain.get('dataset', '')}")
        files = []
        for entry in plain.pop("files", ()):
            if isinstance(entry, SourceFile):
                files.append(entry)
                continue
            _refuse_unknown(entry, SourceFile, f"source file {entry.get('path', '')}")
            files.append(SourceFile(**entry))
        try:
            return cls(files=tuple(files), **plain)
        except TypeError as error:
            raise ConfigError(f"source {plain.get('dataset', '')}: {error}") from None


def _refuse_unknown(values: Mapping[str, Any], kind: Any, what: str) -> None:
    known = [field.name for field in fields(kind)]
    for key in values:
        require(key in known, f"{what}: unknown key {key!r}; known are {', '.join(known)}")
