"""``hybrid-dynamics check``: one line a finding, the cure as a file, exit code 2 where close-loop would refuse."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from tests.small_arm import HIDDEN, URDF, arm, runs, write_logs

from hybrid_dynamics.check import checked
from hybrid_dynamics.check.clipped import check_clipped
from hybrid_dynamics.check.content import check_content, check_rate
from hybrid_dynamics.check.duplicates import check_duplicates
from hybrid_dynamics.check.excitation import check_excitation
from hybrid_dynamics.check.limits import check_limits
from hybrid_dynamics.check.parameter_names import in_words
from hybrid_dynamics.check.velocity import check_velocity
from hybrid_dynamics.cli import main
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop.model import Model, save_model
from hybrid_dynamics.readers import write_log
from hybrid_dynamics.simulation.excitation import excitation
from hybrid_dynamics.trajectory import Trajectory


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    return write_logs(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def run() -> Trajectory:
    return runs(train=1, test=1)[0][0]


def command(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return int(stop.value.code or 0)


def with_velocity(run: Trajectory) -> Trajectory:
    return run.with_signals(dq=np.gradient(run["q"], run.dt, axis=0))


def codes(findings) -> list[tuple[str, str]]:
    return [(f.severity, f.code) for f in findings]


def test_logs_without_fault_are_told_as_they_are(logs, capsys):
    files = [logs / f"{name}.parquet" for name in ("train_1", "train_2")]
    assert command("check", "--robot", logs / "robot.urdf", "--data", *files, "--json") == 0
    said = capsys.readouterr()
    value = json.loads(said.out)
    assert (value["status"], value["hard"], value["suggestion"]) == ("ok", 0, {})
    found = {f["code"] for f in value["findings"]}
    assert {"summary", "range", "condition"} <= found
    assert not [f for f in value["findings"] if f["severity"] == "hard"]
    assert "run train_1: 3200 samples, 8 s at 400 Hz, signals q, tau" in said.err


def test_against_a_completed_model_a_log_is_looked_at_as_predict_does(logs, tmp_path, capsys, run):
    """What the model holds is no fault; a log that predict refuses is refused here, and every line of it told."""
    model, good, bare = tmp_path / "model.json", tmp_path / "wall.parquet", tmp_path / "bare.parquet"
    wall = Effect("gravity_tilt", (), {"roll": 0.0, "pitch": np.pi / 2})
    write_log(good, excitation(arm(), [wall, *HIDDEN], seed=1, duration=8.0, rate=200.0), arm().joint_names)
    save_model(model, Model(arm(), (wall, *HIDDEN)))
    asked = ("check", "--robot", logs / "robot.urdf", "--model", model, "--json", "--data")
    assert command("check", "--robot", logs / "robot.urdf", "--json", "--data", good) == 0
    assert "mounting" in {f["code"] for f in json.loads(capsys.readouterr().out)["findings"]}, "the control"
    assert command(*asked, good) == 0
    assert "mounting" not in {f["code"] for f in json.loads(capsys.readouterr().out)["findings"]}
    save_model(model, Model(arm(), HIDDEN))
    write_log(bare, replace(run, signals={"q": run["q"]}), arm().joint_names)
    assert command(*asked, bare) == 0, "a model predicts along a log without torque, too"
    assert "no comparison with measured torque" in capsys.readouterr().out

    wrong = tmp_path / "wrong.parquet"
    write_log(wrong, run.with_signals(tau=run["tau"][:, ::-1]), arm().joint_names)
    assert command(*asked, wrong, logs / "test_1.parquet") == 2
    said = capsys.readouterr()
    hard = [f for f in json.loads(said.out)["findings"] if f["severity"] == "hard"]
    assert hard
    assert {f["run"] for f in hard} == {"wrong"}
    assert "predict refuses these logs" in said.err
    out = tmp_path / "out.parquet"
    assert command("predict", *asked[1:5], "--data", wrong, "--out", out) == 2
    assert hard[0]["text"] in capsys.readouterr().err
    assert not out.exists()

    moved = with_velocity(run)
    write_log(wrong, moved.with_signals(dq=moved["dq"] * [-1, 180 / np.pi]), arm().joint_names)
    assert command(*asked, wrong) == 2
    hard = [f for f in json.loads(capsys.readouterr().out)["findings"] if f["severity"] == "hard"]
    assert len(hard) == 2, "a sign and a unit"
    assert command("predict", *asked[1:5], "--data", wrong, "--out", out) == 2
    assert "(1 more: hybrid-dynamics check --model MODEL lists all)" in capsys.readouterr().err


def test_against_a_model_nothing_is_passed_that_predict_refuses(logs, tmp_path, capsys, run):
    model = tmp_path / "model.json"
    save_model(model, Model(arm(), HIDDEN))
    asked = ("check", "--robot", logs / "robot.urdf", "--model", model, "--json", "--data")

    bursts = tmp_path / "bursts.parquet"
    write_log(bursts, run.rows(np.flatnonzero(np.arange(len(run.time)) % 400 < 8)), arm().joint_names)
    assert command(*asked, bursts) == 2
    assert "no stretch without a gap" in capsys.readouterr().out

    # The cure names columns that the log has, and mends it; single wrong samples are told.
    exchanged, cure = tmp_path / "exchanged.parquet", tmp_path / "log.yaml"
    q = run["q"][:, ::-1].copy()
    q[1000, 0] += 2.0
    write_log(exchanged, run.with_signals(q=q), arm().joint_names)
    assert command(*asked, exchanged, "--apply-suggestion", cure) == 0 or cure.exists()
    said = json.loads(capsys.readouterr().out)
    assert "glitch" in {f["code"] for f in said["findings"]}
    assert "dq" not in said["log"].get("columns", {})
    assert said["hard_with_it"] == 0

    for wrong, words in (("--test", "nothing is held out"), ("--apply-suggestion", "would be overwritten")):
        given = logs / "test_1.parquet" if wrong == "--test" else model
        assert command(*asked, logs / "train_1.parquet", wrong, given, "--force") == 2
        assert words in capsys.readouterr().out
    assert json.loads(model.read_text())["schema"] == 2


def test_a_suggestion_mends_what_has_one_clear_cure_and_close_loop_takes_it(logs, tmp_path, capsys, run):
    robot = arm()
    degrees = np.rad2deg(np.gradient(run["q"], run.dt, axis=0))
    spoilt = run.with_signals(tau=run["tau"] * 1000 * np.array([1, -1]), dq=degrees)
    write_log(tmp_path / "a.parquet", spoilt, robot.joint_names)
    fault = ("check", "--robot", logs / "robot.urdf", "--data", tmp_path / "a.parquet")
    assert command(*fault) == 2
    said = capsys.readouterr()
    for words in ("WRONG     torque_sign     joint elbow", "dq is in deg/s", "it looks like N mm"):
        assert words in said.out
    assert said.err.startswith("error: 3 findings for which close-loop refuses these logs")
    # What it found stands below as a log.yaml, the same that is written on demand.
    printed = yaml.safe_load(said.out.split("reads it):\n")[1])
    assert printed == {"sign": {"tau": [1, -1]}, "units": {"dq": "deg/s", "tau": "Nmm"}}
    assert "# mends torque_sign: sign.tau" in said.out
    assert command(*fault, "--apply-suggestion", tmp_path / "log.yaml") == 0
    said = capsys.readouterr()
    assert "log.yaml: mends torque_sign: sign.tau" in said.out
    assert "nothing is wrong" in said.out
    assert yaml.safe_load((tmp_path / "log.yaml").read_text()) == printed
    assert command(*fault, "--log", tmp_path / "log.yaml") == 0
    # Never in silence over a file that is there.
    assert command(*fault, "--apply-suggestion", tmp_path / "log.yaml") == 2
    assert "log.yaml: exists; give another file" in capsys.readouterr().err


@pytest.mark.parametrize("signals", [("q",), ("q", "tau")])
@pytest.mark.parametrize("velocity", [False, True])
def test_columns_that_are_exchanged_are_mended_where_they_are_there(signals, velocity, logs, tmp_path, run, capsys):
    """A log without dq has no columns of it to put in order, one with dq has."""
    turned = with_velocity(run) if velocity else run
    exchanged = [*signals, *(["dq"] if velocity else [])]
    turned = turned.with_signals(**{s: turned[s][:, ::-1] for s in exchanged})
    write_log(tmp_path / "a.parquet", turned, arm().joint_names)
    fault = ("check", "--robot", logs / "robot.urdf", "--data", tmp_path / "a.parquet")
    assert command(*fault) == 2
    assert command(*fault, "--apply-suggestion", tmp_path / "log.yaml") == 0
    assert "nothing is wrong" in capsys.readouterr().out
    written = yaml.safe_load((tmp_path / "log.yaml").read_text())["columns"]
    assert written == {s: [f"{s}2", f"{s}1"] for s in exchanged}


def test_suggestions_come_on_top_of_a_description(tmp_path, logs, run, capsys):
    # The columns are called otherwise and exchanged; the description knows the names only.
    robot = arm()
    write_log(tmp_path / "a.parquet", run.with_signals(tau=run["tau"][:, ::-1]), robot.joint_names)
    import pandas as pd

    frame = pd.read_parquet(tmp_path / "a.parquet").rename(columns={f"tau{j}": f"torque_{j - 1}" for j in (1, 2)})
    frame.to_csv(tmp_path / "a.csv", index=False)
    (tmp_path / "first.yaml").write_text("columns: {tau: 'torque_{i0}'}\n")
    start = ("check", "--robot", logs / "robot.urdf", "--data", tmp_path / "a.csv", "--log", tmp_path / "first.yaml")
    assert command(*start) == 2
    assert "tau2 fits the motion of shoulder; tau1 fits the motion of elbow" in capsys.readouterr().out
    assert command(*start, "--apply-suggestion", tmp_path / "second.yaml") == 0
    assert yaml.safe_load((tmp_path / "second.yaml").read_text()) == {"columns": {"tau": ["torque_1", "torque_0"]}}
    # --columns says the same as the file that only names columns.
    by_name = (*start[:-2], "--columns", "tau=torque_{i0}", "--json", "--quiet")
    capsys.readouterr()
    assert command(*by_name) == 2
    assert json.loads(capsys.readouterr().out)["log"] == {"columns": {"tau": ["torque_1", "torque_0"]}}


def test_described_logs_are_checked_as_they_are_described(tmp_path, logs, run, capsys):
    """Motor current on the motor's side, degrees, milliseconds: refused as it stands, without fault as described."""
    import pandas as pd

    frame = pd.DataFrame({"stamp": 1e3 * run.time})
    ratio, constant = np.array([100.0, 50.0]), np.array([0.1, 0.05])
    for j in range(2):
        frame[f"pos_{j}"] = np.rad2deg(run["q"][:, j])
        frame[f"current_{j}"] = run["tau"][:, j] / ratio[j] / constant[j]
    frame.to_csv(tmp_path / "a.csv", index=False)
    (tmp_path / "log.yaml").write_text(
        "columns: {time: stamp, q: 'pos_{i0}', tau: 'current_{i0}'}\nunits: {time: ms, q: deg, tau: A}\n"
        "torque_constant: [0.1, 0.05]\nmotor_side: [tau]\ngear_ratio: [100, 50]\n"
    )
    start = ("check", "--robot", logs / "robot.urdf", "--data", tmp_path / "a.csv")
    assert command(*start) == 2
    assert command(*start, "--log", tmp_path / "log.yaml", "--json") == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["log"] == {}
    assert "as a log.yaml" not in said.err
    # What the command line says goes before what the file says; the control: now the angles are wrong.
    assert command(*start, "--log", tmp_path / "log.yaml", "--units", "rad") == 2
    assert "expected radians" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "found", "words"),
    [
        (lambda d: np.rad2deg(d), ("hard", "dq_scale"), "dq is in deg/s"),
        (lambda d: d * 60 / (2 * np.pi), ("hard", "dq_scale"), "dq is in rpm"),
        (lambda d: d * [100, 50], ("hard", "dq_scale"), "divide a motor's speed by its gear ratio"),
        (lambda d: -d, ("hard", "dq_sign"), "dq of every joint has the wrong sign"),
        (lambda d: d * [1, -1], ("hard", "dq_sign"), "dq of elbow has the wrong sign"),
        (lambda d: 0 * d, ("warning", "dq_zero"), "zero throughout while the joints move"),
        (lambda d: d[:, ::-1], ("hard", "dq_order"), "dq2 is the derivative of q1; dq1 is the derivative of q2"),
        (lambda d: np.roll(d, 20, axis=0), ("warning", "dq_lag"), "dq is 0.05 s behind"),
        (lambda d: np.roll(d, -80, axis=0), ("hard", "dq_lag"), "dq is 0.2 s ahead"),
        (lambda d: np.random.default_rng(0).normal(size=d.shape), ("hard", "dq_strange"), "not the derivative of q"),
    ],
)
def test_a_velocity_that_is_not_the_derivative_is_measured_and_said(run, change, found, words):
    moved = with_velocity(run)
    assert check_velocity(("shoulder", "elbow"), [moved]) == []
    findings = check_velocity(("shoulder", "elbow"), [moved.with_signals(dq=np.asarray(change(moved["dq"])))])
    assert codes(findings) == [found]
    assert words in findings[0].text


def test_a_velocity_of_zero_is_left_out_and_told(run):
    result = checked(arm(), [run.with_signals(dq=np.zeros_like(run["q"]))], [])
    assert "dq" not in result.train[0]
    assert [f.code for f in result.findings if f.severity == "warning"] == ["dq_zero"]


def test_a_late_velocity_is_left_out_and_told(run):
    """Its derivative would be late, too: a torque that comes early, which there is not."""
    moved = with_velocity(run)
    result = checked(arm(), [moved.with_signals(dq=np.roll(moved["dq"], 8, axis=0))], [])
    assert "dq" not in result.train[0]
    said = [f.text for f in result.findings if f.code == "dq_lag"]
    assert len(said) == 1
    assert "0.02 s behind the derivative of q; the derivative of q is taken instead" in said[0]
    # The control: one that is not late is what was measured.
    assert "dq" in checked(arm(), [moved], []).train[0]


def test_a_velocity_that_close_loop_leaves_out_is_told_beforehand(run, tmp_path, capsys):
    (tmp_path / "robot.urdf").write_text(URDF)
    moved = with_velocity(run)
    noise = np.random.default_rng(0).normal(size=moved["dq"].shape)
    for name, more in (("noisy", 0.05), ("good", 0.0)):
        path = tmp_path / f"{name}.parquet"
        write_log(path, moved.with_signals(dq=moved["dq"] + more * noise), ("shoulder", "elbow"))
        assert command("check", "--robot", tmp_path / "robot.urdf", "--data", path) == 0
        assert ("the derivative of q is taken instead of dq" in capsys.readouterr().out) == (name == "noisy")


@pytest.mark.parametrize(("seconds", "late", "refused"), [(2.0, 0.0, 0), (10.0, 0.12, 20)])
def test_two_seconds_of_steady_motion_do_not_say_when_the_velocity_was_taken(seconds: float, late: float, refused: int):
    """Of 50 Hz, sampled when the bus had time, as a recorded arm was: shifted by a while they look like themselves."""
    found = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        time = np.arange(round(seconds * 50)) / 50
        taken, phase = time + rng.uniform(-0.006, 0.006, len(time)), rng.uniform(0, 2 * np.pi, (3, 4))
        rates = 2 * np.pi * np.array([0.07, 0.1, 0.13])
        q = sum(0.4 * np.sin(w * taken[:, None] + p) for w, p in zip(rates, phase, strict=True))
        dq = sum(0.4 * w * np.cos(w * (taken[:, None] - late) + p) for w, p in zip(rates, phase, strict=True))
        run = Trajectory("run", "train", time, {"q": q, "dq": np.round(dq, 3)})
        found += ("hard", "dq_lag") in codes(check_velocity(tuple("abcd"), [run]))
    assert found == refused


@pytest.mark.parametrize("rests_from", [0.62, 0.7])
def test_a_joint_that_rests_says_nothing_of_when_the_velocity_was_taken(rests_from: float):
    """One joint moves to and fro; the other has ended its only move by then: of its last crawl noise had the say."""
    time = np.arange(7500) / 500.0

    def move(begins: float, ends: float) -> np.ndarray:
        s = np.clip((time - begins) / (ends - begins), 0.0, 1.0)
        return np.asarray(s**3 * (10 - 15 * s + 6 * s**2))

    to_and_fro = sum((-1) ** k * move(1.0 + 1.5 * k, 2.2 + 1.5 * k) for k in range(8))
    q = np.column_stack([to_and_fro, 1.2 * move(-0.6, rests_from)])
    dq = np.gradient(q, 1 / 500.0, axis=0) + 1e-3 * np.random.default_rng(0).normal(size=q.shape)
    step = 2 * np.pi / 2**17
    read = {"q": np.round(q / step) * step, "dq": dq}
    assert check_velocity(("shoulder", "elbow"), [Trajectory("run", "train", time, read)]) == []
    # The control: taken 0.1 s later, it is told.
    late = read | {"dq": np.roll(dq, 50, axis=0)}
    (told,) = check_velocity(("shoulder", "elbow"), [Trajectory("run", "train", time, late)])
    assert "dq is 0.1 s behind" in told.text


def test_a_late_velocity_is_told_from_runs_in_which_one_joint_moves_each():
    """The noise of the joint that rests would count as much as the motion of the other, run by run."""
    time = np.arange(4000) / 500.0
    sway = 0.5 * np.sin(1.3 * time) * np.sin(np.pi * time / 8.0) ** 2

    def runs_with(late: int) -> list[Trajectory]:
        out = []
        for j in range(2):
            q = np.zeros((len(time), 2))
            q[:, j] = sway
            dq = np.zeros_like(q)
            dq[:, j] = np.roll(np.gradient(sway, time), late)
            dq += 1e-3 * np.random.default_rng(j).normal(size=q.shape)
            out.append(Trajectory(f"run{j}", "train", time, {"q": q, "dq": dq}))
        return out

    (told,) = check_velocity(("shoulder", "elbow"), runs_with(50))
    assert "dq is 0.1 s behind" in told.text
    assert check_velocity(("shoulder", "elbow"), runs_with(0)) == []


def test_a_copy_of_a_training_run_is_no_test_run_whatever_it_is_called(run):
    other = runs(train=2, test=1)[1][0]
    copy = Trajectory("copy", "test", run.time + 100.0, {s: np.round(x, 7) for s, x in run.signals.items()})
    part = copy.rows(slice(500, 2500))
    for same in (copy, part):
        assert codes(check_duplicates([run], [same])) == [("hard", "duplicate")]
        with pytest.raises(InputError, match="run copy: holds the same samples as run train_1"):
            checked(arm(), [run], [same])
    assert check_duplicates([run], [other]) == []


def test_a_copy_of_a_training_run_is_no_second_run(run):
    """Hard where noise would repeat; runs that share some samples, and test runs twice, are told only."""
    train, test = runs(train=2, test=1)
    copy = Trajectory("copy", "train", run.time + 100.0, {s: np.round(x, 7) for s, x in run.signals.items()})
    for same in (copy, copy.rows(slice(500, 2500))):
        assert codes(check_duplicates([run, same], [])) == [("hard", "duplicate")]
        with pytest.raises(InputError, match=r"run copy: holds the same samples as run train_1.*leave one out"):
            checked(arm(), [run, same], test)
    half = {s: np.concatenate([x[:1600], train[1][s][1600:]]) for s, x in run.signals.items()}
    assert codes(check_duplicates([run, Trajectory("half", "train", run.time, half)], [])) == [("warning", "duplicate")]
    twice = [test[0], Trajectory("again", "test", test[0].time, dict(test[0].signals))]
    assert codes(check_duplicates([run], twice)) == [("warning", "duplicate")]
    assert check_duplicates(train, test) == []


def test_what_close_loop_refuses_for_its_motion_check_refuses_too(logs, tmp_path, capsys):
    """Ten times a second is read, and at the loop's bandwidth too few rows are left in which a joint moves."""
    for rate, code in ((10.0, 2), (100.0, 0)):
        log = tmp_path / f"{rate:g}.parquet"
        write_log(log, excitation(arm(), HIDDEN, duration=14.0, rate=rate), arm().joint_names)
        told = command("check", "--robot", logs / "robot.urdf", "--data", log)
        said = capsys.readouterr().out
        closed = command("close-loop", "--robot", logs / "robot.urdf", "--train", log, "--out", tmp_path / log.stem)
        assert (told, closed) == (code, code), said
        assert ("WRONG     motion" in said) == (code == 2)
        capsys.readouterr()


def test_logs_too_slow_or_too_short_give_no_verdict(run):
    slow = run.rows(slice(None, None, 80))  # 5 Hz
    assert codes(check_rate([slow])) == [("hard", "too_slow")]
    assert "5 Hz is too slow for dynamics" in check_rate([slow])[0].text
    # 20 Hz would do for many motions, but not for one of 3 Hz.
    time = np.arange(0, 60, 0.05)
    q = np.sin(2 * np.pi * np.outer(time, [3.0, 3.3]))
    assert codes(check_rate([Trajectory("fast", "train", time, {"q": q, "tau": q})])) == [("hard", "too_slow")]
    short = run.rows(slice(0, 360))
    assert codes(check_rate([short])) == [("hard", "too_short")]
    assert codes(check_rate([run.rows(slice(None, None, 4))])) == [("warning", "too_short")]


def test_what_converters_do_to_a_log_is_seen(run):
    names = ("shoulder", "elbow")
    assert [f.code for f in check_content(run, names)] == ["summary"]
    limit = 0.6 * np.abs(run["tau"]).max(axis=0)
    clipped = run.with_signals(tau=np.clip(run["tau"], -limit, limit))
    assert [f.code for f in check_clipped(clipped, arm())] == ["saturation"]
    coarse = run.with_signals(tau=np.round(run["tau"]))
    found = [f.code for f in check_content(coarse, names)]
    assert "coarse" in found
    assert check_clipped(coarse, arm()) == []
    held = run.with_signals(tau=np.repeat(run["tau"][::4], 4, axis=0))
    assert "held" in [f.code for f in check_content(held, names)]
    resting = run.with_signals(q=np.column_stack([run["q"][:, 0], np.full(len(run.time), 0.1)]))
    still = [f for f in check_content(resting, names) if f.code == "still"]
    assert len(still) == 1
    assert still[0].text.startswith("elbow stand")
    gone = np.r_[0:1000, 1100:2000, 2003:3200]
    gaps = [f for f in check_content(run.rows(gone), names) if f.code == "gaps"]
    assert "2 gaps, about 103 samples lost" in gaps[0].text


def test_a_motion_that_shows_little_is_told(run):
    rich = {f.code: f for f in check_excitation(arm(), [run])}
    assert rich["condition"].severity == "note"
    # Both joints move as one and barely: their inertia cannot be told apart.
    time = run.time
    poor = 0.05 * np.sin(0.8 * time)[:, None] * np.ones((1, 2))
    tau = arm().inverse_dynamics(poor, np.gradient(poor, run.dt, axis=0), 0 * poor)
    found = check_excitation(arm(), [Trajectory("poor", "train", time, {"q": poor, "tau": tau})])
    assert ("warning", "range") in codes(found)
    assert ("warning", "condition") in codes(found)


def test_a_fault_in_one_run_of_several_is_found_and_named(run):
    train, test = runs(train=3, test=1)
    turned = [train[0], train[1].with_signals(tau=-train[1]["tau"]), train[2]]
    with pytest.raises(InputError, match=r"run train_2: the measured torque of every joint has the wrong sign"):
        checked(arm(), turned, test)
    with pytest.raises(InputError, match=r"wrong sign"):
        checked(arm(), train, [test[0].with_signals(tau=-test[0]["tau"])])
    assert checked(arm(), train, test).findings == ()


def test_parameters_that_come_out_vague_are_named_in_words(run):
    """What a joint that hardly moves leaves open, by the joint's name."""
    still = run.with_signals(q=run["q"] * [1.0, 0.0] + [0.0, 0.3])
    said = " ".join(f.text for f in check_excitation(arm(), [still]))
    assert "no motion shows rotor inertia of elbow, viscous friction of elbow" in said
    assert not re.search(r"\b([ml]|l[xyz]|L[xyz]{2}|Ia|Fv|Fc|b)[0-9]\b", said)
    assert in_words("Lxz2", ("a", "b")) == "moment of inertia xz of the link of b"
    assert in_words("ly1", ("a", "b")) == "mass times y of the centre of the link of a"
    assert in_words("Fc3", ("a", "b")) == "Fc3"


@pytest.mark.parametrize(("faster", "asked"), [(1.0, None), (1.3, False), (30.0, True)])
def test_the_clock_is_asked_about_only_where_all_joints_are_far_too_fast(run, faster, asked):
    top = np.abs(np.gradient(run["q"], run.dt, axis=0)).max(axis=0)
    slow = run.with_signals(q=run["q"] * 2.7 / top)  # rad/s; the limit is 4
    found = check_limits(arm(), [Trajectory("a", "train", run.time / faster / 1.4, slow.signals)])
    speeds = [f.text for f in found if f.code == "beyond_speed"]
    assert len(speeds) == (asked is not None)
    assert [text.endswith("are the time stamps in seconds?") for text in speeds] == [asked] * len(speeds)
    assert not any(text.endswith(("; ", ";")) for text in speeds)
