"""Logs that NumPy and MATLAB saved: the samples of the CSV, whatever the arrays look like; nothing is unpickled."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat
from tests.test_readers_tables import JOINTS, csv_text, motion, write

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.readers import read_log
from hybrid_dynamics.readers.description import LogDescription
from hybrid_dynamics.trajectory import Trajectory

TIME = np.arange(400) / 200.0
Q, DQ, TAU = motion(TIME)
Save = Callable[[Path, dict[str, Any]], Path]


def npz(folder: Path, arrays: dict[str, Any]) -> Path:
    np.savez(folder / "run.npz", **arrays)
    return folder / "run.npz"


def mat(folder: Path, arrays: dict[str, Any]) -> Path:
    savemat(folder / "run.mat", arrays)
    return folder / "run.mat"


def packed_mat(folder: Path, arrays: dict[str, Any]) -> Path:
    savemat(folder / "run.mat", arrays, do_compression=True)
    return folder / "run.mat"


SAVED = pytest.mark.parametrize("save", [npz, mat, packed_mat])


def same(run: Trajectory, velocity: bool = True) -> None:
    assert np.allclose(run.time, TIME, atol=1e-9)
    assert np.allclose(run["q"], Q, atol=1e-9)
    assert np.allclose(run["tau"], TAU, atol=1e-9)
    assert ("dq" in run) is velocity
    if velocity:
        assert np.allclose(run["dq"], DQ, atol=1e-9)


@SAVED
def test_arrays_of_these_names_are_the_log(tmp_path: Path, save: Save) -> None:
    # What else a workspace holds is no part of the log: a rate, a text, an array of another size.
    rest = {"fs": 200.0, "name": "arm", "gains": np.ones((2, 2)), "limits": np.ones(2), "reference": np.ones(900)}
    rest |= {"t": np.arange(4000.0), "x": np.ones((400, 3)), "x1": np.ones(400), "v": np.ones(400), "v1": np.zeros(400)}
    run = read_log(save(tmp_path, {"time": TIME, "q": Q, "dq": DQ, "tau": TAU, **rest}), JOINTS)
    same(run)
    as_text = read_log(write(tmp_path, csv_text(TIME)), JOINTS)
    assert np.allclose(run["tau"], as_text["tau"], atol=1e-8)


@SAVED
def test_samples_may_stand_in_columns(tmp_path: Path, save: Save) -> None:
    same(read_log(save(tmp_path, {"time": TIME[None], "q": Q.T, "tau": TAU.T}), JOINTS), velocity=False)


@SAVED
def test_a_vector_a_joint(tmp_path: Path, save: Save) -> None:
    own = {f"{name}{j + 1}": a[:, j] for name, a in (("q", Q), ("dq", DQ), ("tau", TAU)) for j in (0, 1)}
    same(read_log(save(tmp_path, {"time": TIME, **own}), JOINTS))


@SAVED
def test_a_robot_of_one_joint(tmp_path: Path, save: Save) -> None:
    run = read_log(save(tmp_path, {"time": TIME, "q": Q[:, 0], "tau": TAU[:, :1]}), ["hinge"])
    assert np.allclose(run["tau"], TAU[:, :1])


@SAVED
def test_other_names_and_units_are_described(tmp_path: Path, save: Save) -> None:
    log = LogDescription(columns={"time": "t", "q": "pos{i}", "tau": "eff{i}"}, units={"q": "deg", "time": "ms"})
    path = save(tmp_path, {"t": 1e3 * TIME, "pos": np.rad2deg(Q), "eff": TAU})
    same(read_log(path, JOINTS, log=log), velocity=False)
    with pytest.raises(InputError, match=r"column 'q1' is missing"):
        read_log(path, JOINTS)


@SAVED
def test_one_matrix_without_names_is_a_table_without_a_header(tmp_path: Path, save: Save) -> None:
    log = LogDescription(columns={"q": "1-2", "tau": "3-4"}, rate=200.0)
    same(read_log(save(tmp_path, {"data": np.hstack([Q, TAU])}), JOINTS, log=log), velocity=False)


def test_a_struct_is_opened_and_two_are_told_apart(tmp_path: Path) -> None:
    fields = {"time": TIME, "q": Q, "dq": DQ, "tau": TAU}
    same(read_log(mat(tmp_path, {"log": fields, "fs": 200.0}), JOINTS))
    both = mat(tmp_path, {"a": fields, "b": {**fields, "tau": 2 * TAU}})
    log = LogDescription(columns={"time": "b.time", "q": "b.q{i}", "dq": "b.dq{i}", "tau": "b.tau{i}"})
    assert np.allclose(read_log(both, JOINTS, log=log)["tau"], 2 * TAU)


def test_two_runs_in_one_file_are_not_taken_for_one(tmp_path: Path) -> None:
    fields = {"time": TIME, "q": Q, "tau": TAU}
    longer = {name: np.concatenate([a, a]) for name, a in fields.items()}
    with pytest.raises(InputError, match="column 'time' is missing"):
        read_log(mat(tmp_path, {"first": fields, "second": longer}), JOINTS)


def test_a_cell_of_this_and_that_is_no_part_of_the_log(tmp_path: Path) -> None:
    cell = np.empty(3, object)
    cell[:] = [{"a": 1}, np.arange(2.0), np.arange(3.0)]
    same(read_log(mat(tmp_path, {"time": TIME, "q": Q, "dq": DQ, "tau": TAU, "cell": cell}), JOINTS))


def test_nothing_is_unpickled(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[Any, tuple[str]]:
            return Path.touch, (tmp_path / "sprung",)  # type: ignore[return-value]

    trap = np.array([Trap()], dtype=object)
    same(read_log(npz(tmp_path, {"time": TIME, "q": Q, "dq": DQ, "tau": TAU, "note": trap}), JOINTS))
    with pytest.raises(InputError, match="missing"):
        read_log(npz(tmp_path, {"time": TIME, "q": Q, "tau": trap}), JOINTS)
    assert not (tmp_path / "sprung").exists()


@SAVED
def test_what_is_no_log_is_told(tmp_path: Path, save: Save) -> None:
    with pytest.raises(InputError, match="no arrays of numbers"):
        read_log(save(tmp_path, {"fs": 200.0, "name": "arm"}), JOINTS)
    with pytest.raises(InputError, match=r"column 'q1' stands in it twice"):
        read_log(save(tmp_path, {"time": TIME, "q": Q, "q1": Q[:, 0], "tau": TAU}), JOINTS)
    hole = np.where(np.arange(400)[:, None] == 7, np.nan, Q)
    with pytest.raises(InputError, match="column 'q1', row 8 holds nan"):
        read_log(save(tmp_path, {"time": TIME, "q": hole, "tau": TAU}), JOINTS)
    with pytest.raises(InputError, match="the robot has 3 joints"):
        read_log(save(tmp_path, {"time": TIME, "q": Q, "tau": TAU}), ["a", "b", "c"])
    path = save(tmp_path, {"time": TIME, "q": Q, "tau": TAU})
    whole = path.read_bytes()
    for part in (0, 10, 100, 200, len(whole) // 2, len(whole) - 30):
        path.write_bytes(whole[:part])
        with pytest.raises(InputError, match=f"{path.name}: "):
            read_log(path, JOINTS)


def test_a_later_matlab_file_and_a_nameless_array_have_their_remedy(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + bytes([0, 2]) + b"IM"
    path.write_bytes(head + bytes(400))
    with pytest.raises(InputError, match=r"version 7\.3; save it with save\('run\.mat', '-v7'\)"):
        read_log(path, JOINTS)
    np.save(tmp_path / "run.npy", Q)
    (tmp_path / "run.npy").rename(tmp_path / "run.npz")
    with pytest.raises(InputError, match="one array without a name"):
        read_log(tmp_path / "run.npz", JOINTS)
