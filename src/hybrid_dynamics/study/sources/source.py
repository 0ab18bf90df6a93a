"""A data source: for each pinned file, the first of four places that has it, verified.

Order: ``raw_dir/<owner>/<repo>/<path>`` (what the user supplied or an earlier run kept), the mirror folder
``<mirror>/<owner>/<repo>/<path>``, the copy an earlier run made in the dataset's own folder (``dvc pull`` brings it
too), the network. Whatever was verified is kept under ``raw_dir``: a recording stays usable after the mirror has gone.
Nothing that already exists there is ever changed or removed.
"""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from hybrid_dynamics.errors import SourceError
from hybrid_dynamics.study.sources.download import Downloader, DownloadError, DownloadSettings, check_url
from hybrid_dynamics.study.sources.settings import SourceFile, SourceSettings
from hybrid_dynamics.study.sources.verify import Digest, copy_and_digest, mismatch

MIRROR_VARIABLE = "HYBRID_DYNAMICS_MIRROR"
BASE_URL = "https://raw.githubusercontent.com/{repository}/{commit}/{path}"


@dataclass(frozen=True)
class Located:
    """A verified file: where it lies, its digest, and which of ``raw``, ``mirror``, ``kept``, ``network`` had it."""

    path: Path
    digest: Digest
    where: str


class DataSource:
    """The files of ``settings``, from ``raw_dir``, ``mirror`` or the network.

    ``mirror`` defaults to the environment variable ``HYBRID_DYNAMICS_MIRROR``; ``base_url`` is a template with
    ``{repository}``, ``{commit}`` and ``{path}``. ``network=False`` never leaves this machine.
    """

    def __init__(
        self,
        settings: SourceSettings,
        raw_dir: str | os.PathLike[str],
        mirror: str | os.PathLike[str] | None = None,
        base_url: str = BASE_URL,
        download: DownloadSettings | None = None,
        network: bool = True,
    ) -> None:
        self.settings = settings
        self.raw_dir = Path(raw_dir)
        chosen = mirror if mirror is not None else os.environ.get(MIRROR_VARIABLE, "")
        self.mirror = Path(chosen).expanduser() if str(chosen) else None
        self.base_url = base_url
        self.network = network
        self._downloader = Downloader(download or DownloadSettings())
        self._offline: str | None = None
        check_url(self.url(settings.files[0]))

    def url(self, file: SourceFile) -> str:
        """Where the file is on the network."""
        repository, commit = self.place(file)
        return self.base_url.format(repository=repository, commit=commit, path=quote(file.path))

    def place(self, file: SourceFile) -> tuple[str, str]:
        """Repository and commit of ``file``: the source's, unless the file names its own."""
        return file.repository or self.settings.repository, file.commit or self.settings.commit

    def raw_path(self, file: SourceFile) -> Path:
        """Where the file is looked for first."""
        return self.raw_dir / self.place(file)[0] / file.path

    def locate(self, file: SourceFile, tried: list[str], kept: Path | None = None) -> Located | None:
        """The verified ``file``, or None where no place has it; ``tried`` gains one line per place without it.

        ``kept`` is the folder an earlier run copied the files to.
        Raises :class:`SourceError` where a place has a file of that name with other content.
        """
        raw = self.raw_path(file)
        if raw.is_file():
            return self._verified(raw, file, "raw")
        tried.append(f"{file.path}: not in {self.raw_dir}")
        if self.mirror is None:
            tried.append(f"{file.path}: {MIRROR_VARIABLE} is not set")
        else:
            path = self.mirror / self.place(file)[0] / file.path
            if path.is_file():
                located = self._verified(path, file, "mirror")
                self._keep(located, file)
                return located
            absent = "" if self.mirror.is_dir() else " (no such folder)"
            tried.append(f"{file.path}: not in {MIRROR_VARIABLE}={self.mirror}{absent}")
        if kept is not None and (kept / file.path).is_file():
            digest = copy_and_digest(kept / file.path)
            difference = mismatch(digest, file)
            if difference is None:
                located = Located(kept / file.path, digest, "kept")
                self._keep(located, file)
                return located
            # That folder is the pipeline's own: what is wrong there is fetched anew, not complained about.
            tried.append(f"{file.path}: the copy in {kept} is another ({difference})")
        if not self.network:
            tried.append(f"{file.path}: network switched off")
        elif self._offline is not None:
            tried.append(f"{file.path}: {self._offline}")
        else:
            return self._fetch(file, raw, tried)
        return None

    def keep(self, file: SourceFile, folder: Path) -> None:
        """Keep ``folder``'s copy of ``file`` under ``raw_dir``, where it is the right one and there is none yet."""
        path = folder / file.path
        if path.is_file() and not self.raw_path(file).exists():
            digest = copy_and_digest(path)
            if mismatch(digest, file) is None:
                self._keep(Located(path, digest, "kept"), file)

    def _keep(self, located: Located, file: SourceFile) -> None:
        """The file also under ``raw_dir``, linked where possible; that a place takes no files is no error."""
        raw = self.raw_path(file)
        temporary = raw.with_name(f".{raw.name}.{os.getpid()}.part")
        try:
            raw.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(located.path, temporary)
            except OSError:
                if copy_and_digest(located.path, temporary) != located.digest:
                    return
            if not raw.exists():
                os.replace(temporary, raw)
        except OSError:
            return
        finally:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
                _remove_empty(raw.parent, self.raw_dir)

    def _verified(self, path: Path, file: SourceFile, where: str) -> Located:
        try:
            digest = copy_and_digest(path)
        except OSError as error:
            raise SourceError(f"{path}: cannot be read ({error.strerror}); check its permissions") from None
        difference = mismatch(digest, file)
        if difference is not None:
            raise SourceError(
                f"{path}: {difference} (commit {self.place(file)[1][:10]} of {self.place(file)[0]}); "
                "the file was left as it is: replace it by the right one or move it away"
            )
        return Located(path, digest, where)

    def _fetch(self, file: SourceFile, raw: Path, tried: list[str]) -> Located | None:
        temporary = raw.with_name(f".{raw.name}.{os.getpid()}.part")
        try:
            raw.parent.mkdir(parents=True, exist_ok=True)
            self._downloader.download(self.url(file), temporary, file.size)
            digest = copy_and_digest(temporary)
            difference = mismatch(digest, file)
            if difference is None:
                os.replace(temporary, raw)
                return Located(raw, digest, "network")
            rejected = raw.with_name(raw.name + ".rejected")
            os.replace(temporary, rejected)
        except DownloadError as error:
            if error.offline:
                self._offline = str(error)
            tried.append(f"{file.path}: {error}" if error.offline else f"{file.path}: {self.url(file)}: {error}")
            return None
        except OSError as error:
            raise SourceError(f"{raw}: cannot be written ({error.strerror}); make {self.raw_dir} writable") from None
        finally:
            temporary.unlink(missing_ok=True)
            _remove_empty(raw.parent, self.raw_dir)
        raise SourceError(
            f"{self.url(file)}: {difference}; refused and kept as {rejected}: "
            f"try again later, or put the right file at {raw}"
        )


def _remove_empty(folder: Path, top: Path) -> None:
    """Remove the folders that a failed download made, from ``folder`` up to ``top``, as far as they are empty."""
    while folder != top and folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
        folder = folder.parent
