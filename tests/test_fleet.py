"""A fleet: what changed where is found again, what is done is not done again, one bad row stops no other."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.two_links import URDF, two_links

from hybrid_dynamics.cli import main
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.engine import Local
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.fleet import read_manifest, run_fleet
from hybrid_dynamics.fleet import run as fleet_run
from hybrid_dynamics.fleet.tables import CHANGE_COLUMNS, trends
from hybrid_dynamics.readers import write_log
from hybrid_dynamics.simulation.excitation import excitation

#: Viscous friction of the shoulder on four days [N m s/rad].
GREASE = (1.0, 1.5, 2.0, 2.5)


@pytest.fixture(scope="module")
def yard(tmp_path_factory) -> Path:
    """Logs of one arm over four days, its friction rising, and a manifest of them with one bad row."""
    folder = tmp_path_factory.mktemp("yard")
    (folder / "robot.urdf").write_text(URDF)
    rows = []
    for day, viscous in enumerate(GREASE, 1):
        effect = Effect("viscous_friction", ("shoulder",), {"viscous_coefficient": viscous})
        for split in ("train", "test"):
            run = excitation(two_links(), [effect], name=f"{split}{day}", seed=day, duration=6.0, rate=200.0)
            write_log(folder / f"{split}{day}.parquet", run, two_links().joint_names)
        rows.append(
            {
                "name": f"day{day}",
                "robot": "robot.urdf",
                "train": [f"train{day}.parquet"],
                "test": f"test{day}.parquet",
                "time": f"2026-05-0{day}",
            }
        )
    (folder / "bad.csv").write_text("time,q1,q2,tau1,tau2\n0,0,0,0\n")
    rows.append({"name": "broken", "robot": "robot.urdf", "train": ["bad.csv"], "time": "2026-05-09"})
    pd.DataFrame(rows).to_parquet(folder / "runs.parquet")
    return folder


@pytest.fixture(scope="module")
def done(yard) -> Path:
    result = run_fleet(read_manifest(yard / "runs.parquet"), yard / "fleet")
    assert [o.state for o in result.outcomes] == ["done"] * 4 + ["refused"]
    return yard / "fleet"


def test_the_tables_say_what_changed_where(done):
    runs, changes, trend = (pd.read_csv(done / f"{name}.csv") for name in ("runs", "changes", "trends"))
    assert list(runs["name"]) == ["day1", "day2", "day3", "day4", "broken"]
    assert set(runs["verdict"].dropna()) == {"explained"}
    assert "bad.csv" in runs["refused"].iloc[-1]
    assert (runs["error_after"] < 0.2 * runs["error_before"])[:4].all()
    found = changes[changes["effect"] == "viscous_friction"]
    np.testing.assert_allclose(found["value"], GREASE, rtol=0.02)
    assert set(found["joint"]) == {"shoulder"}
    (line,) = trend[trend["effect"] == "viscous_friction"].to_dict("records")
    assert line["trend"] == "rising"
    assert line["slope"] == pytest.approx(0.5, rel=0.05)  # N m s/rad a day
    assert line["runs"] == 4


def test_what_is_done_is_kept_and_what_changed_is_done_again(yard, done, monkeypatch):
    before = {p: p.read_bytes() for p in done.rglob("*") if p.is_file()}
    entries = read_manifest(yard / "runs.parquet")
    result = run_fleet(entries, done)
    assert [o.state for o in result.outcomes] == ["kept"] * 4 + ["refused"]
    assert {p: p.read_bytes() for p in done.rglob("*") if p.is_file()} == before
    # A loop that was stopped, and one whose log is another now.
    (done / "runs/day2/diagnosis.json").unlink()
    for name in ("model.json", "report.html"):
        (done / "runs/day2" / name).unlink()
    other = excitation(two_links(), [], name="other", seed=9, duration=6.0, rate=200.0)
    kept = (yard / "train3.parquet").read_bytes()
    write_log(yard / "train3.parquet", other, two_links().joint_names)
    again = run_fleet(entries, done)
    assert [o.state for o in again.outcomes] == ["kept", "done", "done", "kept", "refused"]
    (yard / "train3.parquet").write_bytes(kept)
    run_fleet(entries, done)
    assert {p: p.read_bytes() for p in done.rglob("*") if p.is_file()} == before, "the same inputs, the same bytes"


def test_two_processes_give_the_same_bytes(yard, done, tmp_path):
    entries = read_manifest(yard / "runs.parquet")[:2]
    run_fleet(entries, tmp_path / "fleet", engine=Local(2))
    for entry in entries:
        name = f"runs/{entry.name}/diagnosis.json"
        assert (tmp_path / "fleet" / name).read_bytes() == (done / name).read_bytes()


def test_parts_done_by_several_machines_make_the_whole(yard, done, tmp_path):
    """As the tasks of a batch system's array do it; the run over all entries finds everything done."""
    entries = read_manifest(yard / "runs.parquet")[:3]
    for k in (1, 2):
        part = run_fleet(entries, tmp_path / "fleet", part=(k, 2))
        assert [o.name for o in part.outcomes] == [e.name for e in entries[k - 1 :: 2]]
        assert part.tables == ()
    whole = run_fleet(entries, tmp_path / "fleet")
    assert [o.state for o in whole.outcomes] == ["kept"] * 3
    assert all(path.is_file() for path in whole.tables)
    with pytest.raises(InputError, match="part is 3/2"):
        run_fleet(entries, tmp_path / "fleet", part=(3, 2))


def _end(item: int) -> int:
    import os

    if item == 1:
        os._exit(9)
    return item


def test_a_killed_worker_is_one_line():
    with pytest.raises(InputError, match="a worker process was killed"):
        list(Local(2).unordered(_end, [0, 1, 2]))


def test_the_command_tells_and_the_exit_code_says_that_one_was_refused(yard, done, capsys, monkeypatch):
    monkeypatch.chdir(yard)
    with pytest.raises(SystemExit) as stop:
        main(["fleet", "--manifest", "runs.parquet", "--out", "fleet", "--json", "--quiet"])
    assert stop.value.code == 2
    value = json.loads(capsys.readouterr().out)
    assert (value["kept"], list(value["refused"])) == (4, ["broken"])
    assert value["trends"][0]["trend"] == "rising"
    with pytest.raises(SystemExit):
        main(["fleet", "--manifest", "runs.parquet", "--out", "fleet"])
    assert capsys.readouterr().out.splitlines()[0] == "5 runs: 4 explained, 1 refused"
    good = pd.read_parquet("runs.parquet").iloc[:4]
    good.assign(train=good["train"].str[0]).to_csv("good.csv", index=False)
    with pytest.raises(SystemExit) as stop:
        main(["fleet", "--manifest", "good.csv", "--out", "fleet"])
    assert stop.value.code == 0
    shown = capsys.readouterr().out.splitlines()
    assert shown[0] == "4 runs: 4 explained"
    assert "rising: viscous_coefficient of viscous_friction on shoulder" in shown[1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,robot\na,robot.urdf\n", "column 'train' is missing"),
        ("name,robot,train,colour\na,robot.urdf,bad.csv,red\n", "column 'colour' is unknown"),
        ("name,robot,train\n", "holds no rows"),
        ("name,robot,train\n../a,robot.urdf,bad.csv\n", r"row 1: name is '../a'; expected letters"),
        ("name,robot,train\na,none.urdf,bad.csv\n", r"row 1: robot names .*none.urdf, which is not there"),
        ("name,robot,train\na,robot.urdf,\n", "row 1: train is empty"),
        ("name,robot,train\na,robot.urdf,bad.csv\nA,robot.urdf,bad.csv\n", "row 2: name 'A' stands also in row 1"),
        ("name,robot,train,time\na,robot.urdf,bad.csv,noon\n", "row 1: time is 'noon'; expected a number or a date"),
        ("name,robot,train,time\na,robot.urdf,bad.csv,inf\n", "row 1: time is inf"),
        ("name,robot,train\na,robot.urdf;robot.urdf,bad.csv\n", "expected one robot"),
    ],
)
def test_a_faulty_manifest_is_refused_before_any_work(yard, tmp_path, text, message):
    for name in ("robot.urdf", "bad.csv"):
        (tmp_path / name).write_bytes((yard / name).read_bytes())
    (tmp_path / "runs.csv").write_text(text)
    with pytest.raises(InputError, match=message) as error:
        read_manifest(tmp_path / "runs.csv")
    assert str(tmp_path / "runs.csv") in str(error.value)


def test_a_folder_that_is_no_fleet_is_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(InputError, match=r"holds thesis.tex, and no results of a fleet"):
        fleet_run.check_out(tmp_path, force=False)
    fleet_run.check_out(tmp_path, force=True)


def test_days_that_scatter_are_no_trend():
    """Values differ from day to day by ten times their standard errors, without direction; a slope of noise is none."""
    rng = np.random.default_rng(0)
    called = 0
    for _ in range(60):
        value = 2.0 + 0.1 * rng.normal(size=8)
        row = {"robot": "a", "effect": "e", "joint": "j", "parameter": "p", "unit": "N m", "confirmed": True}
        rows = [{**row, "name": f"{k}", "time": k, "value": v, "std_error": 0.01} for k, v in enumerate(value)]
        (line,) = trends(pd.DataFrame(rows, columns=list(CHANGE_COLUMNS))).to_dict("records")
        called += line["trend"] != "steady"
    # Three standard errors with six degrees of freedom: 2.4 % of pure chance.
    assert called <= 5
