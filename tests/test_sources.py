"""Sources: the three places, verification, and what a bad server, folder or digest leads to."""

from __future__ import annotations

import hashlib
import json
import shutil
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hybrid_dynamics.errors import ConfigError, HybridDynamicsError, SourceError
from hybrid_dynamics.readers import read_wam
from hybrid_dynamics.study.sources import DataSource, SourceFile, SourceSettings, fetch, read_source
from hybrid_dynamics.study.sources.download import DownloadSettings
from hybrid_dynamics.trajectory import ABSENT, RECORDED, SIMULATED_TWIN

COMMIT = "0123456789abcdef0123456789abcdef01234567"
REPOSITORY = "owner/data"
FAST = DownloadSettings(connect_timeout=2.0, read_timeout=2.0, attempts=3, back_off=0.01)
BLOB = bytes(range(256)) * 2000


class Server:
    """A web server on loopback; ``files`` maps a path to its content, ``faults`` to how its next answers go wrong."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.faults: dict[str, list[str]] = {}
        self.asked: list[str] = []
        owner = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                path = self.path.lstrip("/")
                owner.asked.append(path)
                faults = owner.faults.get(path, [])
                fault = faults.pop(0) if faults else ""
                if fault.isdigit() or path not in owner.files:
                    self.send_error(int(fault or 404))
                    return
                content = owner.files[path]
                self.send_response(200)
                self.send_header("Content-Length", str(len(content)))
                self.end_headers()
                self.wfile.write(content[: len(content) // 2] if fault == "drop" else content)

            def log_message(self, format: str, *args: Any) -> None:
                """Keep the test's output clean."""

        self._http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.base_url = f"http://127.0.0.1:{self._http.server_port}/{{path}}"
        self._thread = threading.Thread(target=self._http.serve_forever, args=(0.02,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._http.shutdown()
        self._http.server_close()
        self._thread.join()


@pytest.fixture
def server() -> Iterator[Server]:
    running = Server()
    yield running
    running.close()


@pytest.fixture(autouse=True)
def _no_mirror(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HYBRID_DYNAMICS_MIRROR", raising=False)


def pinned(path: str, content: bytes, **more: Any) -> SourceFile:
    return SourceFile(path, len(content), hashlib.sha256(content).hexdigest(), **more)


def settings(*files: SourceFile) -> SourceSettings:
    return SourceSettings("robot", REPOSITORY, COMMIT, "CC BY 4.0", files, "Cite the authors")


def source(server: Server | None, tmp_path: Path, *files: SourceFile, **more: Any) -> DataSource:
    base = server.base_url if server else "http://127.0.0.1:9/{path}"
    return DataSource(settings(*files), tmp_path / "raw", base_url=base, download=FAST, **more)


def everything_below(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def put(folder: Path, path: str, content: bytes) -> Path:
    file = folder / REPOSITORY / path
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content)
    return file


def one_line(error: pytest.ExceptionInfo[HybridDynamicsError]) -> str:
    text = str(error.value)
    assert "\n" not in text
    return text


def test_download_is_verified_kept_and_not_repeated(server: Server, tmp_path: Path) -> None:
    server.files["a/run.csv"] = BLOB
    said: list[str] = []
    report = fetch(source(server, tmp_path, pinned("a/run.csv", BLOB)), tmp_path / "out", notify=said.append)
    assert report.provenance == RECORDED
    assert report.files["a/run.csv"]["where"] == "network"
    assert (tmp_path / "out/a/run.csv").read_bytes() == BLOB
    assert "RECORDED" in said[0]
    assert any("CC BY 4.0" in line for line in said)
    again = fetch(source(server, tmp_path, pinned("a/run.csv", BLOB)), tmp_path / "out", notify=said.append)
    assert again.files["a/run.csv"]["where"] == "raw"
    assert server.asked == ["a/run.csv"]


def test_outputs_depend_on_content_only(server: Server, tmp_path: Path) -> None:
    server.files["run.csv"] = BLOB
    put(tmp_path / "mirror", "run.csv", BLOB)
    file = pinned("run.csv", BLOB)
    fetch(source(server, tmp_path / "1", file), tmp_path / "one", notify=lambda _: None)
    fetch(source(None, tmp_path / "2", file, mirror=tmp_path / "mirror"), tmp_path / "two", notify=lambda _: None)
    assert everything_below(tmp_path / "one") == everything_below(tmp_path / "two")
    assert "network" not in (tmp_path / "one/source.json").read_text()


def test_order_is_raw_mirror_network(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = {name: name.encode() * 10 for name in ("raw.csv", "mirror.csv", "net.csv")}
    server.files.update(files)
    put(tmp_path / "raw", "raw.csv", files["raw.csv"])
    for name in ("raw.csv", "mirror.csv"):
        put(tmp_path / "mirror", name, files[name])
    monkeypatch.setenv("HYBRID_DYNAMICS_MIRROR", str(tmp_path / "mirror"))
    pins = [pinned(name, content) for name, content in files.items()]
    report = fetch(source(server, tmp_path, *pins), tmp_path / "out", notify=lambda _: None)
    assert [report.files[name]["where"] for name in files] == ["raw", "mirror", "network"]
    assert server.asked == ["net.csv"]


@pytest.mark.parametrize("fault", ["drop", "500", "503"])
def test_broken_transfer_is_repeated(server: Server, tmp_path: Path, fault: str) -> None:
    server.files["run.csv"] = BLOB
    server.faults["run.csv"] = [fault, fault]
    report = fetch(source(server, tmp_path, pinned("run.csv", BLOB)), tmp_path / "out", notify=lambda _: None)
    assert report.provenance == RECORDED
    assert len(server.asked) == 3
    assert (tmp_path / "out/run.csv").read_bytes() == BLOB


def test_server_that_always_drops(server: Server, tmp_path: Path) -> None:
    server.files["run.csv"] = BLOB
    server.faults["run.csv"] = ["drop"] * 10
    with pytest.raises(SourceError) as error:
        fetch(source(server, tmp_path, pinned("run.csv", BLOB)), tmp_path / "out", "recorded")
    assert "broken transfer" in one_line(error)
    assert "3 attempts" in one_line(error)
    assert everything_below(tmp_path) == {}


@pytest.mark.parametrize(("status", "attempts"), [("404", 1), ("403", 1), ("302", 1), ("500", 3)])
def test_http_errors(server: Server, tmp_path: Path, status: str, attempts: int) -> None:
    server.files["run.csv"] = BLOB
    server.faults["run.csv"] = [status] * 10
    with pytest.raises(SourceError) as error:
        fetch(source(server, tmp_path, pinned("run.csv", BLOB)), tmp_path / "out", "recorded")
    assert f"HTTP {status}" in one_line(error)
    assert len(server.asked) == attempts
    assert everything_below(tmp_path) == {}


@pytest.mark.parametrize("mode", ["auto", "recorded"])
def test_wrong_digest_from_the_network_is_kept_aside(server: Server, tmp_path: Path, mode: str) -> None:
    other = BLOB[:-1] + b"x"
    server.files["run.csv"] = other
    with pytest.raises(SourceError) as error:
        fetch(source(server, tmp_path, pinned("run.csv", BLOB)), tmp_path / "out", mode)
    assert "sha256" in one_line(error)
    assert "run.csv.rejected" in one_line(error)
    assert everything_below(tmp_path) == {f"raw/{REPOSITORY}/run.csv.rejected": other}


@pytest.mark.parametrize("place", ["raw", "mirror"])
@pytest.mark.parametrize("content", [BLOB[:-1] + b"x", BLOB[:1000]], ids=["digest", "truncated"])
def test_wrong_file_of_the_user_is_named_and_left_alone(
    server: Server, tmp_path: Path, place: str, content: bytes
) -> None:
    server.files["run.csv"] = BLOB
    file = put(tmp_path / place, "run.csv", content)
    with pytest.raises(SourceError) as error:
        fetch(source(server, tmp_path, pinned("run.csv", BLOB), mirror=tmp_path / "mirror"), tmp_path / "out")
    assert str(file) in one_line(error)
    assert file.read_bytes() == content
    assert server.asked == []
    assert not (tmp_path / "out").exists()


def test_git_blob_id() -> None:
    # The id that git gives to a file holding "hello\n".
    file = SourceFile("hello", git_blob="ce013625030ba8dba906f756967f9e9ca394464a")
    assert file.sha256 is None


def test_git_blob_verifies(server: Server, tmp_path: Path) -> None:
    file = SourceFile("hello", git_blob="ce013625030ba8dba906f756967f9e9ca394464a")
    server.files["hello"] = b"hello\n"
    assert fetch(source(server, tmp_path, file), tmp_path / "out", notify=lambda _: None).provenance == RECORDED
    server.files["hello"] = b"hallo\n"
    with pytest.raises(SourceError, match="git blob id"):
        fetch(source(server, tmp_path / "b", file), tmp_path / "out2")


def test_without_a_network_the_twin_is_named_with_the_reason(tmp_path: Path) -> None:
    urdf = b"<robot/>"
    put(tmp_path / "raw", "robot.urdf", urdf)
    files = [pinned("run1.csv", BLOB), pinned("run2.csv", BLOB), pinned("robot.urdf", urdf, role="support")]
    said: list[str] = []
    report = fetch(source(None, tmp_path, *files), tmp_path / "out", notify=said.append)
    assert report.provenance == SIMULATED_TWIN
    assert report.missing == ("run1.csv", "run2.csv")
    assert list(report.files) == ["robot.urdf"]
    assert "SIMULATED TWIN" in said[0]
    assert "no network" in said[0]
    assert "\n" not in said[0]
    assert read_source(tmp_path / "out")["provenance"] == SIMULATED_TWIN
    assert (tmp_path / "out/robot.urdf").read_bytes() == urdf
    assert not (tmp_path / "out/run1.csv").exists()


def test_recorded_without_data_says_what_was_tried_and_how_to_provide_it(tmp_path: Path) -> None:
    with pytest.raises(SourceError) as error:
        fetch(source(None, tmp_path, pinned("run.csv", BLOB), mirror=tmp_path / "m"), tmp_path / "out", "recorded")
    text = one_line(error)
    for part in ("run.csv", "not in", "HYBRID_DYNAMICS_MIRROR", "no network", f"raw/{REPOSITORY}/", "source=auto"):
        assert part in text
    assert everything_below(tmp_path) == {}


def test_missing_network_is_found_once(tmp_path: Path) -> None:
    data = source(None, tmp_path, *[pinned(f"run{i}.csv", BLOB) for i in range(5)])
    calls: list[str] = []
    download = data._downloader.download
    data._downloader.download = lambda url, *a: (calls.append(url), download(url, *a))[1]  # type: ignore[func-returns-value,method-assign]
    report = fetch(data, tmp_path / "out", notify=lambda _: None)
    assert len(report.missing) == 5
    assert len(calls) == 1


def test_proxy_that_refuses_is_named(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("no_proxy", "NO_PROXY"):
        monkeypatch.delenv(name, raising=False)
    # The server answers CONNECT with an error, like a proxy that does not let the host through.
    monkeypatch.setenv("https_proxy", server.base_url.removesuffix("/{path}"))
    file = pinned("run.csv", BLOB)
    data = DataSource(settings(file), tmp_path / "raw", base_url="https://data.invalid/{path}", download=FAST)
    with pytest.raises(SourceError) as error:
        fetch(data, tmp_path / "out", "recorded")
    assert "the proxy of this environment refuses the connection" in one_line(error)


def test_silent_name_lookup_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Name look-up knows no time limit; the search for a network must end all the same."""
    release = threading.Event()

    def hang(*_: object) -> None:
        release.wait(30)
        raise OSError("gave up")

    monkeypatch.setattr("socket.create_connection", hang)
    patience = DownloadSettings(connect_timeout=0.1)
    data = DataSource(settings(pinned("run.csv", BLOB)), tmp_path / "raw", download=patience)
    said: list[str] = []
    report = fetch(data, tmp_path / "out", notify=said.append)
    release.set()
    assert report.provenance == SIMULATED_TWIN
    assert "no network: raw.githubusercontent.com cannot be reached (no answer)" in said[0]


def test_recording_arrives_later_and_replaces_the_twin(tmp_path: Path) -> None:
    file = pinned("run.csv", BLOB)
    assert fetch(source(None, tmp_path, file), tmp_path / "out", notify=lambda _: None).provenance == SIMULATED_TWIN
    put(tmp_path / "mirror", "run.csv", BLOB)
    data = source(None, tmp_path, file, mirror=tmp_path / "mirror")
    assert fetch(data, tmp_path / "out", notify=lambda _: None).provenance == RECORDED
    assert fetch(data, tmp_path / "out", "twin", notify=lambda _: None).provenance == SIMULATED_TWIN
    assert not (tmp_path / "out/run.csv").exists()


def test_a_verified_recording_stays_usable_after_the_mirror_has_gone(tmp_path: Path) -> None:
    file = pinned("deep/run.csv", BLOB)
    mirrored = put(tmp_path / "mirror", "deep/run.csv", BLOB)
    with_mirror = source(None, tmp_path, file, mirror=tmp_path / "mirror")
    assert fetch(with_mirror, tmp_path / "out", notify=lambda _: None).files["deep/run.csv"]["where"] == "mirror"
    before = everything_below(tmp_path / "out")
    mirrored.unlink()
    # DVC may have removed the dataset's folder, as in a new working copy ...
    elsewhere = fetch(source(None, tmp_path, file), tmp_path / "other", notify=lambda _: None)
    assert (elsewhere.provenance, elsewhere.files["deep/run.csv"]["where"]) == (RECORDED, "raw")
    # ... or that folder is all there is (`dvc pull` on another machine).
    shutil.rmtree(tmp_path / "raw")
    pulled = fetch(source(None, tmp_path, file), tmp_path / "out", notify=lambda _: None)
    assert (pulled.provenance, pulled.files["deep/run.csv"]["where"]) == (RECORDED, "kept")
    assert everything_below(tmp_path / "out") == before, "what is written depends on content alone"
    # The twin, asked for, replaces that folder, but the recording is not lost with it.
    shutil.rmtree(tmp_path / "raw")
    assert fetch(source(None, tmp_path, file), tmp_path / "out", "twin", lambda _: None).provenance == SIMULATED_TWIN
    assert fetch(source(None, tmp_path, file), tmp_path / "out", notify=lambda _: None).provenance == RECORDED


def test_a_recording_never_turns_into_its_twin_in_silence(tmp_path: Path) -> None:
    file = pinned("run.csv", BLOB)
    put(tmp_path / "raw", "run.csv", BLOB)
    fetch(source(None, tmp_path, file), tmp_path / "out", notify=lambda _: None)
    shutil.rmtree(tmp_path / "raw")
    (tmp_path / "out/run.csv").write_bytes(b"damaged")
    before = everything_below(tmp_path / "out")
    for target, was_recorded in ((tmp_path / "out", False), (tmp_path / "gone", True)):
        with pytest.raises(SourceError) as error:
            fetch(source(None, tmp_path, file), target, notify=lambda _: None, was_recorded=was_recorded)
        for part in ("so far a RECORDING was used", "HYBRID_DYNAMICS_MIRROR", "source=twin"):
            assert part in one_line(error)
    assert everything_below(tmp_path / "out") == before
    assert fetch(source(None, tmp_path, file), tmp_path / "out", "twin", lambda _: None).provenance == SIMULATED_TWIN
    # The control: where no recording was ever used, the twin stands in as before.
    assert fetch(source(None, tmp_path, file), tmp_path / "new", notify=lambda _: None).provenance == SIMULATED_TWIN


def test_a_place_for_copies_that_takes_none_is_no_error(tmp_path: Path) -> None:
    put(tmp_path / "mirror", "run.csv", BLOB)
    (tmp_path / "raw").write_text("a file where a folder should be")
    data = source(None, tmp_path, pinned("run.csv", BLOB), mirror=tmp_path / "mirror")
    assert fetch(data, tmp_path / "out", notify=lambda _: None).provenance == RECORDED


def test_optional_file_may_be_missing(tmp_path: Path) -> None:
    put(tmp_path / "raw", "run.csv", BLOB)
    data = source(None, tmp_path, pinned("run.csv", BLOB), pinned("more.csv", b"x", optional=True))
    report = fetch(data, tmp_path / "out", "recorded", notify=lambda _: None)
    assert report.provenance == RECORDED
    assert report.missing == ("more.csv",)


def test_a_folder_with_other_files_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/mine.txt").write_text("keep me")
    with pytest.raises(SourceError, match="nothing was changed"):
        fetch(source(None, tmp_path, pinned("run.csv", BLOB)), tmp_path / "out")
    assert (tmp_path / "out/mine.txt").read_text() == "keep me"


@pytest.mark.parametrize("url", ["http://example.org/{path}", "ftp://127.0.0.1/{path}", "file:///etc/{path}"])
def test_only_https_or_loopback(tmp_path: Path, url: str) -> None:
    with pytest.raises(ConfigError, match="https"):
        DataSource(settings(pinned("run.csv", BLOB)), tmp_path, base_url=url)


def test_settings_refuse_what_cannot_be_meant() -> None:
    good = {"path": "a.csv", "sha256": "0" * 64, "size": 1}
    base = {"dataset": "d", "repository": "o/r", "commit": COMMIT, "licence": "x", "files": [good]}
    assert SourceSettings.from_mapping(base).files[0].path == "a.csv"
    cases: list[tuple[dict[str, Any], str]] = [
        ({"files": [{**good, "path": "../a.csv"}]}, "relative path"),
        ({"files": [{**good, "path": "/a.csv"}]}, "relative path"),
        ({"files": [{**good, "sha256": "12"}]}, "64 lower-case"),
        ({"files": [{"path": "a.csv"}]}, "no digest"),
        ({"files": [{**good, "role": "other"}]}, "role"),
        ({"files": [{**good, "colour": "red"}]}, "unknown key 'colour'"),
        ({"files": [good, good]}, "listed twice"),
        ({"files": []}, "no files"),
        ({"commit": "main"}, "commit"),
        ({"repository": "a/b/c"}, "owner/name"),
        ({"nonsense": 1}, "unknown key 'nonsense'"),
    ]
    for change, message in cases:
        with pytest.raises(ConfigError, match=message):
            SourceSettings.from_mapping({**base, **change})
    with pytest.raises(ConfigError, match="source is 'always'"):
        fetch(DataSource(SourceSettings.from_mapping(base), "raw"), "out", "always")


def wam_text(seed: int, rows: int = 400) -> bytes:
    rng = np.random.default_rng(seed)
    time = 1e-3 * np.arange(rows)
    q = np.sin(time[:, None] * np.arange(1, 8) + rng.uniform(0, 6, 7))
    table = np.column_stack([time, q, 10 * np.cos(q)])
    return "\n".join(" ".join(f"{x:.6f}" for x in row) for row in table).encode() + b"\n"


@pytest.mark.parametrize("way", ["network", "mirror"])
def test_recorded_wam_from_server_to_trajectory(server: Server, tmp_path: Path, way: str) -> None:
    files = []
    for i in range(1, 5):
        content = wam_text(i)
        path = f"data/recdata/rbtlog_traj{i}.dat"
        if way == "network":
            server.files[path] = content
        else:
            put(tmp_path / "mirror", path, content)
        header = f"blob {len(content)}\0".encode()
        files.append(SourceFile(path, git_blob=hashlib.sha1(header + content).hexdigest()))
    server.faults["data/recdata/rbtlog_traj2.dat"] = ["drop"]
    files.append(pinned("data/robotparams/wam7_cad.json", b"{}", role="support", optional=True))
    data = source(server, tmp_path, *files, mirror=tmp_path / "mirror")
    report = fetch(data, tmp_path / "out", "recorded", notify=lambda _: None)
    assert report.provenance == RECORDED
    assert {entry["where"] for entry in report.files.values()} == {way}
    stored = json.loads((tmp_path / "out/source.json").read_text())
    assert list(stored["files"]) == sorted(stored["files"])
    run = read_wam(tmp_path / "out/data/recdata/rbtlog_traj3.dat", "traj3", "train")
    assert run["q"].shape == (400, 7)
    np.testing.assert_allclose(run["tau"], 10 * np.cos(run["q"]), atol=2e-5)
    assert run.dt == pytest.approx(1e-3, rel=1e-9)


def test_a_source_without_a_twin_is_left_out(tmp_path: Path) -> None:
    """No file of it is copied, not even a description that could be had; one line says so; it may come back."""
    files = (
        SourceFile("run.csv", sha256=hashlib.sha256(BLOB).hexdigest()),
        support := SourceFile("arm.urdf", sha256=hashlib.sha256(b"arm").hexdigest(), role="support"),
    )
    settings = SourceSettings("arm", REPOSITORY, COMMIT, "none", files, twin=False)
    mirror = tmp_path / "mirror" / REPOSITORY
    mirror.mkdir(parents=True)
    (mirror / support.path).write_bytes(b"arm")
    source = DataSource(settings, tmp_path / "raw", mirror=tmp_path / "mirror", network=False)
    said: list[str] = []
    assert fetch(source, tmp_path / "out", notify=said.append).provenance == ABSENT
    assert len(said) == 1
    assert said[0].startswith("arm: LEFT OUT, because its recording cannot be had (run.csv: not in ")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["source.json"]
    assert fetch(source, tmp_path / "out", "twin", notify=said.append).provenance == ABSENT
    with pytest.raises(SourceError, match=r"recorded data asked for, but missing: run\.csv"):
        fetch(source, tmp_path / "out", "recorded", notify=said.append)
    (mirror / "run.csv").write_bytes(BLOB)
    assert fetch(source, tmp_path / "out", notify=said.append).provenance == RECORDED
    assert (tmp_path / "out" / support.path).read_bytes() == b"arm"


def test_a_file_of_another_repository(tmp_path: Path) -> None:
    """A description that another repository publishes is looked for there, and pinned to its commit."""
    file = SourceFile("arm.urdf", sha256=hashlib.sha256(b"arm").hexdigest(), repository="other/robots", commit="f" * 40)
    settings = SourceSettings("arm", REPOSITORY, COMMIT, "none", (file,))
    source = DataSource(settings, tmp_path / "raw", mirror=tmp_path / "mirror", network=False)
    assert source.url(file).endswith(f"other/robots/{'f' * 40}/arm.urdf")
    (tmp_path / "mirror" / REPOSITORY).mkdir(parents=True)
    (tmp_path / "mirror" / REPOSITORY / "arm.urdf").write_bytes(b"arm")
    assert source.locate(file, []) is None
    (tmp_path / "mirror" / "other/robots").mkdir(parents=True)
    (tmp_path / "mirror" / "other/robots/arm.urdf").write_bytes(b"arm")
    found = source.locate(file, [])
    assert found is not None
    assert found.where == "mirror"
    with pytest.raises(ConfigError, match="give both or neither"):
        SourceFile("arm.urdf", sha256="0" * 64, repository="other/robots")
