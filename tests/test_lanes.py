"""Two lanes of ``dvc repro``: which stages share one, that both end what they began, that Ctrl-C ends both."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from dvc.lock import Lock
from stages.lanes import Lanes, graph, groups, title

ROOT = Path(__file__).parents[1]
DOT = """strict digraph {
"data/raw.dvc" -> "read@a";
"fetch_b" -> "read@b";
"read@a" -> "train@a";
"read@b" -> "train@b";
"shared" -> "read@c";
"shared" -> "read@d";
"train@a" -> "report";
"train@b" -> "report";
"report" -> "track";
"alone";
}"""
PIPELINE = """
stages:
  read:
    matrix: {data: [a, b]}
    cmd: echo ${item.data} > read_${item.data}
    outs: ["read_${item.data}"]
  train:
    matrix: {data: [a, b]}
    cmd: cat read_${item.data} > train_${item.data}
    deps: ["read_${item.data}"]
    outs: ["train_${item.data}"]
  report:
    cmd: cat train_a train_b > report
    deps: [train_a, train_b]
    outs: [report]
"""
ALWAYS = """
  fetch:
    cmd: cp source fetched
    always_changed: true
    outs: [fetched]
  used:
    cmd: cp fetched used
    deps: [fetched]
    outs: [used]
"""


def test_groups_share_no_stage_and_what_sees_several_data_sets_waits():
    found = groups(graph(DOT))
    assert found == [
        ["data/raw.dvc", "read@a", "train@a"],
        ["fetch_b", "read@b", "train@b"],
        ["read@c", "read@d", "shared"],
        ["alone"],
    ]
    assert [title(names) for names in found] == ["a", "b", "c", "alone"]


def python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def test_after_a_failure_nothing_new_is_begun(tmp_path, capfd):
    lanes = Lanes(1)
    lanes.run(
        {"bad": python("raise SystemExit('no such file')"), "later": python(f"open({str(tmp_path / 'x')!r}, 'w')")}
    )
    assert lanes.failed == ["bad"]
    assert not (tmp_path / "x").exists()
    assert "bad: no such file" in capfd.readouterr().out


def test_two_lanes_run_at_once(tmp_path):
    """Each waits for the other's file: one after the other, both would fail."""
    wait = (
        "import pathlib, sys, time; a, b = map(pathlib.Path, {!r}); a.touch()\n"
        "for _ in range(600):\n    if b.exists(): sys.exit(0)\n    time.sleep(0.1)\nsys.exit(1)"
    )
    one, two = str(tmp_path / "one"), str(tmp_path / "two")
    lanes = Lanes(2)
    lanes.run({"one": python(wait.format((one, two))), "two": python(wait.format((two, one)))})
    assert lanes.failed == []


def pipeline(folder: Path) -> dict[str, str]:
    (folder / "dvc.yaml").write_text(PIPELINE)
    environment = {k: v for k, v in os.environ.items() if not k.startswith("DVC")}
    environment |= {"PYTHONPATH": os.pathsep.join([str(ROOT / "src"), str(ROOT)]), "DVC_NO_ANALYTICS": "1"}
    subprocess.run([sys.executable, "-m", "dvc", "init", "--no-scm", "-q"], cwd=folder, env=environment, check=True)
    return environment


@pytest.mark.slow
def test_a_project_of_two_data_sets_is_built_and_plain_repro_agrees(tmp_path):
    environment = pipeline(tmp_path)
    done = subprocess.run(
        [sys.executable, "-m", "stages.lanes", "--lanes", "2"],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "report").read_text().split() == ["a", "b"]
    assert "a: Running stage 'train@a'" in done.stdout
    assert "Running stage 'report'" in done.stdout
    again = subprocess.run(
        [sys.executable, "-m", "dvc", "status"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert "up to date" in again.stdout


@pytest.mark.slow
def test_a_lane_waits_for_the_lock_of_another_process(tmp_path):
    """DVC alone gives up after three seconds; on a busy machine another one holds the lock for longer."""
    environment = pipeline(tmp_path)
    lock = Lock(str(tmp_path / ".dvc/tmp/lock"))
    lock.lock()
    # The control: this is the lock that DVC asks for.
    command = [sys.executable, "-m", "dvc", "repro"]
    alone = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert alone.returncode != 0
    assert "Unable to acquire lock" in alone.stderr
    with subprocess.Popen([sys.executable, "-m", "stages.lanes"], cwd=tmp_path, env=environment) as waiting:
        time.sleep(6.0)
        lock.unlock()
        assert waiting.wait(120) == 0
    assert (tmp_path / "report").read_text() == "a\nb\n"


@pytest.mark.slow
def test_where_nothing_has_changed_only_what_always_runs_is_run(tmp_path):
    environment = pipeline(tmp_path)
    (tmp_path / "dvc.yaml").write_text(PIPELINE + ALWAYS)
    source = tmp_path / "source"

    def lanes() -> str:
        command = [sys.executable, "-m", "stages.lanes"]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    source.write_text("old")
    assert "Running stage 'used'" in lanes()
    said = lanes()
    assert "only what always runs has been run" in said
    assert "Running stage" not in said
    # What it finds changed begins the lanes.
    source.write_text("new")
    assert "Running stage 'used'" in lanes()
    assert (tmp_path / "used").read_text() == "new"


def test_ctrl_c_ends_all_lanes(tmp_path):
    """Both write their process number and sleep; after the interruption neither is there."""
    sleeper = "import os, pathlib, time; pathlib.Path({!r}).write_text(str(os.getpid())); time.sleep(600)"
    code = (
        # A test runner in the background hands down an ignored SIGINT; a person's terminal does not.
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from stages.lanes import Lanes; import sys\n"
        f"Lanes(2).run({{name: [sys.executable, '-c', {sleeper!r}.format(str({str(tmp_path)!r} + '/' + name))]"
        " for name in ('one', 'two')})"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT / "src"), str(ROOT)])}
    process = subprocess.Popen(python(code), env=environment, stderr=subprocess.DEVNULL)
    files = [tmp_path / "one", tmp_path / "two"]
    while not all(file.exists() and file.read_text() for file in files):
        assert process.poll() is None
        time.sleep(0.05)
    numbers = [int(file.read_text()) for file in files]
    process.send_signal(signal.SIGINT)
    assert process.wait() != 0
    for number in numbers:
        stat = Path(f"/proc/{number}/stat")
        assert not stat.exists() or stat.read_text().rsplit(")", 1)[1].split()[0] == "Z"
