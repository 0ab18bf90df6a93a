"""The program as a citizen of the shell: words for people and programs, files of options, pipes, signals, codes."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from tests.two_links import write_recordings

from hybrid_dynamics.cli import build_parser, main
from hybrid_dynamics.errors import run_main
from hybrid_dynamics.loop.process import ProcessSettings

_LOGS = ("--train", "train_1.parquet", "train_2.parquet", "--test", "test_1.parquet")
CLOSE = ("close-loop", "--robot", "robot.urdf", *_LOGS, "--out", "out")
PREDICT = ("predict", "--robot", "robot.urdf", "--model", "out/model.json", "--data", "test_1.parquet", "--out")
PROGRAM = (sys.executable, "-c", "from hybrid_dynamics.cli import main; main()")


@pytest.fixture(scope="module")
def closed(tmp_path_factory) -> Path:
    """Logs of a small arm, and what close-loop says of them, in ``out``."""
    folder = tmp_path_factory.mktemp("closed")
    write_recordings(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert run(*CLOSE, "--quiet") == 0
    return folder


@pytest.fixture
def here(closed, monkeypatch) -> Path:
    monkeypatch.chdir(closed)
    return closed


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return int(stop.value.code or 0)


def test_the_package_runs_as_a_module_where_the_program_is_not_on_the_path():
    def said(*command: str) -> tuple[int, str]:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return done.returncode, done.stdout + done.stderr

    module, program = (sys.executable, "-m", "hybrid_dynamics"), str(Path(sys.executable).parent / "hybrid-dynamics")
    for arguments in (("--version",), ("check", "--robot", "missing.urdf", "--data", "missing.csv")):
        assert said(*module, *arguments) == said(program, *arguments)
    assert said(*module, "check", "--robot", "missing.urdf", "--data", "missing.csv")[0] == 2


def test_help_and_version_come_without_the_libraries():
    """What answers at once must not load what takes seconds."""
    code = "import sys; from hybrid_dynamics.cli import build_parser; build_parser(); print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    heavy = {
        "numpy",
        "scipy",
        "pinocchio",
        "pyarrow",
        "pandas",
        "rich",
        "yaml",
        "omegaconf",
        "sympy",
        "torch",
        "sklearn",
    }
    assert not heavy & set(loaded)
    assert "argparse" in loaded


def test_every_command_has_the_common_options_and_an_example(capsys):
    (commands,) = (a for a in build_parser()._actions if hasattr(a, "choices") and a.choices)
    assert len(commands.choices) >= 4
    for name, parser in commands.choices.items():  # type: ignore[union-attr]
        text = parser.format_help()
        for option in ("--json", "--quiet", "--version", "--config"):
            assert option in text, (name, option)
        assert f"hybrid-dynamics {name}" in text.split("Example:")[1]
        # The command can be copied as it stands, and is not run together with what comes after it.
        example, codes = text.split("Example:\n")[1].strip("\n").split("\n\n")
        assert "\n" not in example
        assert codes.startswith("Exit codes: 0")
        assert "130" in codes
        with pytest.raises(SystemExit) as stop:
            main([name, "--version"])
        assert stop.value.code in (0, None)
        assert capsys.readouterr().out.startswith("hybrid-dynamics ")


def test_the_help_of_export_names_the_endings(capsys):
    with pytest.raises(SystemExit):
        main(["export", "--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert "ends in .urdf for urdf, .xml or .mjcf for mjcf, .c for c, .py for python, .casadi for casadi" in said


def test_the_console_names_the_effect_in_words_first(here, capsys):
    assert run(*CLOSE, "--force") == 0
    shown = capsys.readouterr()
    lines = shown.out.splitlines()
    assert lines[0].startswith("two_links: explained: what the model lacked has been found and added;")
    assert lines[1].startswith("missing: ")
    assert "viscous friction 2 N m s/rad on shoulder; " in lines[1]
    assert "torque offset 0.8 N m on elbow; " in lines[1]
    assert "held-out error" in lines[1]
    assert " → " in lines[1]
    stages = shown.err.splitlines()
    assert len(stages) == len(set(stages)) > 5, "one line a stage"


def test_json_is_one_object_and_quiet_is_silent(here, capsys):
    assert run(*PREDICT, "p.parquet", "--json") == 0
    shown = capsys.readouterr()
    value = json.loads(shown.out)
    assert value["status"] == "ok"
    assert value["rows"] == pq.read_metadata("p.parquet").num_rows
    assert len(value["error"]["rmse"]) == 2
    assert "rows of predicted torque" in shown.err
    assert run(*PREDICT, "p.parquet", "--json", "--quiet") == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out) == value
    assert shown.err == ""
    assert run(*PREDICT, "p.parquet", "--quiet") == 0
    assert capsys.readouterr() == ("", "")
    assert run(*PREDICT[:-3], "--data", "none.csv", "--out", "p.parquet", "--json", "--quiet") == 2
    shown = capsys.readouterr()
    assert json.loads(shown.out)["exit_code"] == 2
    assert "none.csv" in json.loads(shown.out)["error"]
    assert shown.err.startswith("error: none.csv: no such file")


def test_the_result_says_where_it_comes_from(here):
    diagnosis, model = (json.loads(Path(f"out/{name}.json").read_text()) for name in ("diagnosis", "model"))
    origin = diagnosis["provenance"]
    assert model["provenance"] == origin
    assert origin["command"]["train"] == ["train_1.parquet", "train_2.parquet"]
    assert origin["settings"]["process"]["cutoff"] == ProcessSettings().cutoff
    assert len({log["sha256"] for logs in origin["logs"].values() for log in logs}) == 3
    assert origin["robot"]["dynamics_sha256"] == model["robot_digest"]
    assert str(here) not in json.dumps(diagnosis), "a result must not depend on where it was made"


def test_predict_writes_by_name_with_parts_band_and_error(here):
    assert run(*PREDICT, "p.csv", "--effects", "--band", "--quiet") == 0
    assert run(*PREDICT, "p.parquet", "--effects", "--band", "--quiet") == 0
    table, log = pd.read_csv("p.csv"), pd.read_parquet("test_1.parquet")
    pd.testing.assert_frame_equal(table, pd.read_parquet("p.parquet"))
    np.testing.assert_allclose(table["time"], log["time"], atol=1e-12)
    parts = [name for name in table if name.startswith("tau1_")]  # type: ignore[attr-defined]
    assert parts == ["tau1_rigid_body", "tau1_viscous_friction"]
    np.testing.assert_allclose(table[parts].sum(axis=1), table["tau1"], atol=1e-9)
    inside = np.abs(table["error1"]) < 3 * table["tau_std1"]
    assert inside.mean() > 0.9
    assert pq.read_schema("p.parquet").field("tau1").metadata[b"unit"] == b"N m"


def spoilt(frame: pd.DataFrame, columns: list[str], share: float, times: float, seed: int = 0) -> pd.DataFrame:
    """``frame`` with ``share`` of the samples of ``columns`` off by ``times`` their spread."""
    rng, out = np.random.default_rng(seed), frame.copy()
    for name in columns:
        rows = rng.choice(np.arange(5, len(out) - 5), max(round(share * len(out)), 1), replace=False)
        out.loc[rows, name] += times * out[name].std() * rng.choice([-1.0, 1.0], len(rows))
    return out


@pytest.mark.parametrize("uneven", [False, True])
def test_glitches_in_a_log_do_not_ruin_its_prediction(here, tmp_path, capsys, uneven):
    """1 % of all samples at 1000 times the signal: error, parts and band of the clean log; number and size told."""
    log = pd.read_parquet("test_1.parquet")
    if uneven:
        log = log.drop(index=np.random.default_rng(3).choice(len(log), 40, replace=False)).reset_index(drop=True)  # type: ignore[call-overload]
    bad = spoilt(log, ["q1", "q2", "tau1", "tau2"], 0.01, 1000.0)
    found = {}
    for name, frame in (("clean", log), ("bad", bad)):
        frame.to_csv(tmp_path / f"{name}.csv", index=False)
        asked = (*PREDICT[:-3], "--data", tmp_path / f"{name}.csv", "--effects", "--band", "--json")
        assert run(*asked, "--out", tmp_path / f"{name}.parquet") == 0
        shown = capsys.readouterr()
        found[name] = json.loads(shown.out), pd.read_parquet(tmp_path / f"{name}.parquet"), shown.err
    clean, mended = found["clean"][0], found["bad"][0]
    np.testing.assert_allclose(mended["error"]["rmse"], clean["error"]["rmse"], rtol=0.1)
    np.testing.assert_allclose(mended["error"]["rmse_as_recorded"], clean["error"]["rmse_as_recorded"], rtol=0.1)
    assert mended["columns"] == clean["columns"]
    difference = np.sqrt(np.mean((found["bad"][1] - found["clean"][1]) ** 2, axis=0))
    # N m; the torque itself is of the order of ten.
    assert difference.max() < 0.05, difference
    count = round(0.01 * len(log))
    for name in ("q", "tau"):
        said = f"{2 * count} samples of {name} (shoulder {count}, elbow {count}; of {len(log)} each)"
        assert said in found["bad"][2]
    assert "stand alone" not in found["clean"][2]


def test_a_motion_that_cannot_be_is_not_predicted_along(here, tmp_path, capsys):
    log = pd.read_parquet("test_1.parquet")
    for j in (1, 2):
        log[f"dq{j}"] = np.rad2deg(np.gradient(log[f"q{j}"], 0.005))
    log.to_csv(tmp_path / "deg.csv", index=False)
    assert run(*PREDICT[:-3], "--data", tmp_path / "deg.csv", "--out", tmp_path / "p.csv") == 2
    assert "dq is in deg/s" in capsys.readouterr().err
    assert not (tmp_path / "p.csv").exists()
    # A velocity of zero throughout is none: left out and told.
    log.assign(dq1=0.0, dq2=0.0).to_csv(tmp_path / "zero.csv", index=False)
    assert run(*PREDICT[:-3], "--data", tmp_path / "zero.csv", "--out", tmp_path / "p.csv") == 0
    assert "zero throughout while the joints move" in capsys.readouterr().err
    assert run(*PREDICT, tmp_path / "without.csv", "--quiet") == 0
    zero, without = (pd.read_csv(tmp_path / name) for name in ("p.csv", "without.csv"))
    pd.testing.assert_frame_equal(zero, without)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("robot: robot.urdf\ncolour: red", "option 'colour' is unknown; known are"),
        ("robot: a.urdf\nrobot: b.urdf", "option 'robot' stands twice"),
        ("robot: [a.urdf, b.urdf]", "robot holds 2 values; expected one"),
        ("effects: perhaps", "effects is 'perhaps'; expected true or false"),
        ("robot:", "robot is ''; expected text"),
        ("lock: [-j]", "a value cannot begin with '-'"),
        ("- robot", "holds no options"),
        ("robot: [unclosed", "not readable as YAML"),
        ("a: &a [*a]", "nested too deeply"),
    ],
)
def test_a_faulty_file_of_options_is_one_line(here, capsys, tmp_path, text, message):
    file = tmp_path / "options.yaml"
    file.write_text(text)
    assert run("predict", "--config", file) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1
    assert str(file) in error


def test_options_from_a_file_and_the_command_line_wins(here, capsys):
    Path("options.yaml").write_text(
        "robot: robot.urdf\nmodel: out/model.json\ndata: none.csv\nout: p.csv\nquiet: true\neffects: yes\nband: false\n"
    )
    assert run("predict", "--config", "options.yaml", "--data", "test_1.parquet") == 0
    assert capsys.readouterr() == ("", "")
    assert "tau1_rigid_body" in pd.read_csv("p.csv")
    assert run("predict", "--config=options.yaml") == 2
    assert "none.csv: no such file" in capsys.readouterr().err
    Path("settings.yaml").write_text("train: [train_1.parquet]\nset: {block: long, sign_widths: [0, 0.05]}\n")
    assert run("close-loop", "--config", "settings.yaml", "--robot", "robot.urdf", "--out", "new") == 2
    assert "block is 'long'; expected a number" in capsys.readouterr().err


def test_an_option_that_stands_twice_loses_nothing(here, capsys):
    """Several values add up; of one value one of the two would be lost without a word."""
    learnt = ("close-loop", "--robot", "robot.urdf", "--test", "test_1.parquet", "--json")
    twice = (*learnt, "--train", "train_1.parquet", "--train", "train_2.parquet", "--out", "twice")
    assert run(*twice, "--set", "effects=[viscous_friction]", "--set", "block=1.0") == 0
    capsys.readouterr()
    provenance = json.loads(Path("twice/diagnosis.json").read_text())["provenance"]
    assert provenance["command"]["train"] == ["train_1.parquet", "train_2.parquet"]
    assert provenance["command"]["set"] == ["effects=[viscous_friction]", "block=1.0"]
    assert run(*learnt, "--train", "train_1.parquet", "--out", "a", "--out", "b") == 2
    assert "--out stands twice; keep one" in capsys.readouterr().err
    assert not Path("a").exists()
    assert not Path("b").exists()
    # Several values of a file give way to those of the command line, all of them.
    Path("more.yaml").write_text("train: [train_1.parquet, none.parquet]\n")
    assert run(*learnt, "--config", "more.yaml", "--train", "train_2.parquet", "--out", "c") == 0
    assert json.loads(Path("c/diagnosis.json").read_text())["provenance"]["command"]["train"] == ["train_2.parquet"]


def program(*arguments: str, **options: Any) -> "subprocess.Popen[Any]":
    environment = {**os.environ, "OMP_NUM_THREADS": "1", **options.pop("env", {})}
    return subprocess.Popen([*PROGRAM, *arguments], env=environment, **options)


def test_a_closed_pipe_ends_nothing(here):
    """The reader goes away before the first line: the file is written all the same, and nobody is alarmed."""
    Path("p.parquet").unlink(missing_ok=True)
    process = program(*PREDICT, "p.parquet", stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    error = process.stderr.read()
    assert process.wait(60) == 0, error
    assert error == ""
    assert Path("p.parquet").exists()


@pytest.mark.slow
def test_an_ascii_terminal_and_names_with_brackets(here, tmp_path):
    text = (
        Path("robot.urdf").read_text().replace('name="shoulder"', 'name="[red]schulter ü\x1b"'.replace("\x1b", "&#9;"))
    )
    (tmp_path / "robot.urdf").write_text(text)
    logs = [str(here / name) for name in ("train_1.parquet", "train_2.parquet")]
    for log in logs:
        # Without the metadata that names the joints.
        pd.DataFrame(pd.read_parquet(log).to_dict("list")).to_parquet(tmp_path / Path(log).name)
    arguments = (
        "close-loop",
        "--robot",
        "robot.urdf",
        "--train",
        "train_1.parquet",
        "train_2.parquet",
        "--out",
        "[out]",
    )
    process = program(
        *arguments, cwd=tmp_path, env={"PYTHONIOENCODING": "ascii", "LC_ALL": "C"}, stdout=-1, stderr=-1, text=True
    )
    out, error = process.communicate(timeout=900)
    assert process.returncode == 0, error
    assert "[red]schulter ?" in out
    assert "->" in out.splitlines()[1]
    assert (tmp_path / "[out]" / "report.html").exists()


@pytest.mark.slow
def test_a_termination_is_an_interruption(here):
    """As Ctrl-C: code 130, one word, the old results untouched."""
    before = {p.name: p.read_bytes() for p in Path("out").iterdir()}
    process = program(*CLOSE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    process.stderr.readline()  # the first stage of the loop is announced
    process.send_signal(signal.SIGTERM)
    rest = process.communicate(timeout=900)[1]
    assert process.returncode == 130, rest
    assert rest.splitlines()[-1] == "interrupted"
    assert {p.name: p.read_bytes() for p in Path("out").iterdir()} == before
    assert not [p for p in here.iterdir() if p.name.startswith(".out")]


@pytest.mark.slow
def test_a_full_disk_leaves_the_old_results(here):
    """A limit on the size of files stands for the full disk: both are errors of the operating system while writing."""
    before = {p.name: p.read_bytes() for p in Path("out").iterdir()}
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))"
    code = f"{limit}; from hybrid_dynamics.cli import main; main()"
    process = subprocess.run(
        [sys.executable, "-c", code, *CLOSE, "--quiet"], capture_output=True, text=True, timeout=900, check=False
    )
    assert process.returncode == 2, process.stderr
    assert len(process.stderr.splitlines()) == 1
    assert "File too large" in process.stderr
    assert {p.name: p.read_bytes() for p in Path("out").iterdir()} == before
    assert not [p for p in here.iterdir() if p.name.startswith(".out")]


def test_a_full_disk_below_a_writer_without_names_is_one_line(capsys):
    """Some libraries do not say which file it was."""

    def full() -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(SystemExit) as stop:
        run_main(full)
    assert stop.value.code == 2
    assert "No space left on device; nothing was changed" in capsys.readouterr().err


def test_a_folder_of_somebody_else_is_refused_before_any_work(here, tmp_path, capsys):
    (tmp_path / "thesis.tex").write_text("years of work")
    assert run(*CLOSE[:-1], tmp_path) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: {tmp_path}: holds thesis.tex")
    assert len(error.splitlines()) == 1, "refused before any stage is told"


def test_completion_is_a_script(capsys):
    assert run("completion", "bash") == 0
    script = capsys.readouterr().out
    assert "close-loop" in script
    assert "--robot" in script
    checked = subprocess.run(["bash", "-n"], input=script, text=True, capture_output=True, check=False)
    assert checked.returncode == 0, checked.stderr
