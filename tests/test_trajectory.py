"""Trajectory tables: what is written is what is read, units travel, and faults are named."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.trajectory import (
    Trajectory,
    TrajectoryWriter,
    instant,
    iter_trajectories,
    read_metadata,
    read_trajectories,
    write_trajectories,
)


def make(name="run", split="train", rows=20, n=2, seed=0):
    rng = np.random.default_rng(seed)
    return Trajectory(
        name, split, np.arange(rows) * 0.01, {"q": rng.normal(size=(rows, n)), "tau": rng.normal(size=(rows, n))}
    )


def test_round_trip_keeps_values_units_and_metadata(tmp_path):
    path = tmp_path / "t.parquet"
    runs = [make("a"), make("b", "test", rows=30, seed=1)]
    write_trajectories(path, runs, {"provenance": "recorded"})
    back = read_trajectories(path)
    assert [t.name for t in back] == ["a", "b"]
    np.testing.assert_array_equal(back[1]["tau"], runs[1]["tau"])
    assert read_metadata(path) == {"provenance": "recorded"}
    field = pq.read_schema(path).field("tau2")
    assert field.metadata[b"unit"] == b"N m"
    assert [t.name for t in read_trajectories(path, split="test")] == ["b"]


def test_same_input_same_bytes(tmp_path):
    for name in ("one", "two"):
        write_trajectories(tmp_path / name, [make("a"), make("b")], {"x": 1})
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


def test_one_row_group_a_trajectory_bounds_the_memory(tmp_path):
    write_trajectories(tmp_path / "t", [make("a"), make("b"), make("c")], {})
    assert pq.ParquetFile(tmp_path / "t").num_row_groups == 3


def test_nan_is_refused_with_file_column_and_row(tmp_path):
    run = make()
    run["q"][7, 1] = np.nan
    write_trajectories(tmp_path / "t", [run], {})
    with pytest.raises(InputError, match=r"t: column 'q2' holds nan in trajectory run, row 8"):
        read_trajectories(tmp_path / "t")


def test_missing_column_is_named(tmp_path):
    path = tmp_path / "t.parquet"
    write_trajectories(path, [make()], {})
    with pytest.raises(InputError, match="column 'dq1' is missing"):
        list(iter_trajectories(path, require=("dq",)))
    table = pq.read_table(path).drop_columns(["tau2"])
    pq.write_table(table, path)
    with pytest.raises(InputError, match="column 'tau2' is missing"):
        read_trajectories(path)


@pytest.mark.parametrize("content", [b"", b"not parquet at all"])
def test_unreadable_file_is_one_line(tmp_path, content):
    (tmp_path / "t").write_bytes(content)
    with pytest.raises(InputError, match="not a readable Parquet file"):
        read_trajectories(tmp_path / "t")


def test_nothing_is_left_when_writing_fails(tmp_path):
    def interrupted():
        with TrajectoryWriter(tmp_path / "t.parquet", {}) as writer:
            writer.write(make())
            raise RuntimeError("power cut")

    with pytest.raises(RuntimeError):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_old_file_survives_a_failed_rewrite(tmp_path):
    path = tmp_path / "t.parquet"
    write_trajectories(path, [make("old")], {})
    with pytest.raises(InputError, match="no trajectory to write"):
        write_trajectories(path, [], {})
    assert read_trajectories(path)[0].name == "old"


def test_wrong_shape_and_split_are_refused():
    with pytest.raises(InputError, match="tau has shape"):
        Trajectory("x", "train", np.arange(3.0), {"q": np.zeros((3, 2)), "tau": np.zeros((3, 1))})
    with pytest.raises(InputError, match="split is 'validation'"):
        Trajectory("x", "validation", np.arange(3.0), {})


@pytest.mark.parametrize(
    ("seconds", "said"), [(0.0123, "0.012"), (3274.02, "3274.02"), (1763900000.25, "1763900000.25"), (5.0, "5")]
)
def test_an_instant_is_told_as_it_stands_in_the_log(seconds: float, said: str) -> None:
    assert instant(seconds) == said
