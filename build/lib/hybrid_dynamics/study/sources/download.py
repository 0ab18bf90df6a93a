"""One file over HTTP: to a temporary file, with progress, again after a broken transfer."""

from __future__ import annotations

import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

import requests
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

from hybrid_dynamics.errors import ConfigError, require
from hybrid_dynamics.study.sources.verify import CHUNK

LOOPBACK = ("localhost", "127.0.0.1", "::1")


class DownloadError(Exception):
    """A file that could not be downloaded, and why; ``offline`` when that holds for every file."""

    def __init__(self, message: str, offline: bool = False) -> None:
        super().__init__(message)
        self.offline = offline


@dataclass(frozen=True)
class DownloadSettings:
    """Patience: ``connect_timeout`` and ``read_timeout`` [s], ``attempts`` a file, first ``back_off`` [s] (doubles)."""

    connect_timeout: float = 4.0
    read_timeout: float = 30.0
    attempts: int = 4
    back_off: float = 0.5

    def __post_init__(self) -> None:
        require(self.connect_timeout > 0, f"connect_timeout is {self.connect_timeout}; expected seconds > 0")
        require(self.read_timeout > 0, f"read_timeout is {self.read_timeout}; expected seconds > 0")
        require(self.attempts >= 1, f"attempts is {self.attempts}; expected at least 1")
        require(self.back_off >= 0, f"back_off is {self.back_off}; expected seconds >= 0")


def check_url(url: str) -> None:
    """Raise :class:`ConfigError` unless ``url`` is https, or http to this machine."""
    parts = urlsplit(url)
    if parts.scheme == "https" or (parts.scheme == "http" and parts.hostname in LOOPBACK):
        return
    raise ConfigError(f"{url}: refused; expected an https address (plain http only on the loopback interface)")


class Downloader:
    """Downloads files from one server. Environment proxies are respected, except on the loopback interface."""

    def __init__(self, settings: DownloadSettings) -> None:
        self.settings = settings
        self._session = requests.Session()

    def download(self, url: str, target: Path, size: int | None) -> None:
        """Stream ``url`` into ``target`` (``size`` bytes when known). Raises :class:`DownloadError`."""
        check_url(url)
        self._session.trust_env = urlsplit(url).hostname not in LOOPBACK
        self._reach(url)
        settings, reason = self.settings, ""
        for attempt in range(settings.attempts):
            if attempt:
                time.sleep(settings.back_off * 2 ** (attempt - 1))
            try:
                self._transfer(url, target, size)
                return
            except requests.exceptions.ProxyError:
                raise DownloadError("the proxy of this environment refuses the connection", offline=True) from None
            except requests.exceptions.SSLError as error:
                raise DownloadError(f"the server's certificate is not accepted ({error})", offline=True) from None
            except (requests.exceptions.RequestException, _BrokenTransferError) as error:
                reason = _plain(error)
        raise DownloadError(f"broken transfer ({reason}), {settings.attempts} attempts")

    def _transfer(self, url: str, target: Path, size: int | None) -> None:
        timeout = (self.settings.connect_timeout, self.settings.read_timeout)
        # Compressed transfers would make the stated length useless; a redirect could leave https.
        headers = {"Accept-Encoding": "identity"}
        with self._session.get(url, stream=True, timeout=timeout, headers=headers, allow_redirects=False) as response:
            status = response.status_code
            if status == 429 or status >= 500:
                raise _BrokenTransferError(f"HTTP {status} {response.reason}")
            if status != 200:
                raise DownloadError(f"HTTP {status} {response.reason}")
            stated = response.headers.get("Content-Length")
            expected = int(stated) if stated and stated.isdigit() else size
            received = 0
            with open(target, "wb") as sink, _progress(unquote(url.rsplit("/", 1)[-1]), expected) as advance:
                for chunk in response.iter_content(CHUNK):
                    sink.write(chunk)
                    received += len(chunk)
                    advance(len(chunk))
            if expected is not None and received < expected:
                raise _BrokenTransferError(f"connection closed after {received} of {expected} bytes")

    def _reach(self, url: str) -> None:
        """Fail within ``connect_timeout`` where there is no network: name look-up has no time limit of its own."""
        proxy = requests.utils.select_proxy(url, requests.utils.get_environ_proxies(url)) if self._trusts() else None
        where = urlsplit(proxy if proxy and "://" in proxy else f"http://{proxy}") if proxy else urlsplit(url)
        port = where.port or (443 if where.scheme == "https" else 80)
        failure = ["no answer"]

        def connect() -> None:
            try:
                socket.create_connection((where.hostname or "", port), self.settings.connect_timeout).close()
                failure.clear()
            except OSError as error:
                failure[0] = error.strerror or str(error)

        thread = threading.Thread(target=connect, daemon=True)
        thread.start()
        thread.join(self.settings.connect_timeout)
        if failure:
            raise DownloadError(f"no network: {where.hostname} cannot be reached ({failure[0]})", offline=True)

    def _trusts(self) -> bool:
        return bool(self._session.trust_env)


class _BrokenTransferError(Exception):
    """A transfer that may succeed when repeated."""


def _plain(error: Exception) -> str:
    """The innermost reason of a nest of library errors, in one line."""
    reason: BaseException = error
    while reason.args and isinstance(reason.args[-1], BaseException):
        reason = reason.args[-1]
    return " ".join(str(reason).split()) or type(error).__name__


@contextmanager
def _progress(name: str, total: int | None) -> Iterator[_Advance]:
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    console = Console(stderr=True)
    if not console.is_terminal:
        print(f"downloading {name}" + (f" ({total / 1e6:.1f} MB)" if total else ""), file=sys.stderr, flush=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(name, total=total)
        yield _Advance(progress, task)


class _Advance:
    def __init__(self, progress: Progress, task: object) -> None:
        self._progress, self._task = progress, task

    def __call__(self, count: int) -> None:
        self._progress.advance(self._task, count)  # type: ignore[arg-type]
