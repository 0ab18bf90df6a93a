"""Files that hold columns rather than lines: Parquet, and the arrays that NumPy and MATLAB save.

An array of T rows and k columns called ``q`` becomes the columns ``q1`` to ``qk``; a vector of T keeps its name, and is
the first column of its name besides, since a robot may have one joint. T is the length of ``time``, or else of ``q``,
or the longest there is; arrays of another size (a rate, a list of names) are no part of the log. The columns of an
array that is alone are called ``1`` to ``k`` as well, as those of a table without a header. Fields of a struct are
called ``struct.field``; where a file holds one struct and nothing else of that length, ``field``.
"""

from __future__ import annotations

import re
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.types import Array

#: Suffixes of Parquet files, in either case.
PARQUET = (".parquet", ".pq")
#: Suffixes of files of named arrays.
ARRAYS = (".npz", ".mat")
#: What others call the time.
TIMES = ("t", "time", "timestamp", "stamp", "time_s", "seconds", "secs")


def read_columns(file: Path) -> pa.Table:
    """The columns of a Parquet, NumPy or MATLAB ``file``. Raises :class:`InputError` where it cannot be read."""
    if not file.is_file():
        raise InputError(f"{file}: no such file; give the path of a log")
    if file.suffix.lower() in PARQUET:
        try:
            return pq.ParquetFile(file).read()
        except (pa.ArrowException, OSError) as error:
            reason = str(error).splitlines()[0]
            raise InputError(
                f"{file}: not a readable Parquet file, or a truncated one ({reason}); write or copy it again"
            ) from None
    return pa.table(_columns(file, _numpy(file) if file.suffix.lower() == ".npz" else _matlab(file)))


def _numpy(file: Path) -> dict[str, Any]:
    if not zipfile.is_zipfile(file):
        with open(file, "rb") as stream:
            nameless = stream.read(6) == b"\x93NUMPY"
        if nameless:
            raise InputError(f"{file}: one array without a name; save it with numpy.savez(file, time=..., q=...)")
        raise InputError(f"{file}: not an .npz file, or a truncated one; save or copy it again")
    try:
        with np.load(file, allow_pickle=False) as content:
            return dict(_readable(content))
    except (OSError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{file}: not a readable .npz file ({reason}); save or copy it again") from None


def _readable(content: Any) -> Iterator[tuple[str, Any]]:
    """The arrays of an archive that are numbers: what is pickled may be code, and stays unread."""
    for name in content.files:
        try:
            yield name, content[name]
        except ValueError as error:
            if "pickle" not in str(error):
                raise


def _matlab(file: Path) -> dict[str, Any]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        content = loadmat(file, simplify_cells=True)
    except NotImplementedError:
        raise InputError(
            f"{file}: a MATLAB file of version 7.3; save it with save('{file.name}', '-v7') or as CSV"
        ) from None
    except (
        MatReadError,
        OSError,
        ValueError,
        TypeError,
        LookupError,
        EOFError,
        UnboundLocalError,
        zlib.error,
    ) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{file}: not a readable MATLAB file ({reason}); save or copy it again") from None
    return {name: value for name, value in content.items() if not name.startswith("__")}


def _columns(file: Path, content: Mapping[str, Any]) -> dict[str, Array]:
    """Columns of the arrays in ``content`` that are as long as the run."""
    arrays = {name: a for name, a in _arrays(content, "") if max(a.shape) > 1}
    rows = _length(arrays)
    taken = {name: a if a.shape[0] == rows else a.T for name, a in arrays.items() if rows in a.shape}
    if not taken:
        raise InputError(
            f"{file}: no arrays of numbers; expected time (T,), q (T, n) and tau (T, n), or arrays of other names "
            "(--columns says which)"
        )
    logs = {_within(name) for name in arrays if _own(name) == "q"}
    alone = len({_within(name) for name in taken}) == 1 and len(logs) <= 1
    if alone:
        taken = {_own(name): values for name, values in taken.items()}
    out: dict[str, Array] = {}
    twice: set[str] = set()
    for name, values in taken.items():
        own = {name: values[:, 0]}
        if values.shape[1] > 1:
            own = {f"{name}{k + 1}": column for k, column in enumerate(values.T)}
        twice |= set(own) & set(out)
        out |= own
    if wanted := sorted(name for name in twice if re.fullmatch(r"(q|dq|tau)\d+", name)):
        raise InputError(f"{file}: column {wanted[0]!r} stands in it twice, once in an array; leave one of them out")
    out = {name: column for name, column in out.items() if name not in twice}
    # A robot may have one joint, and a log one array without a name that says anything.
    for name, values in taken.items():
        if values.shape[1] == 1 and not name[-1:].isdigit():
            out.setdefault(f"{name}1", values[:, 0])
        if len(taken) == 1:
            out |= {str(k + 1): column for k, column in enumerate(values.T)}
    return out


def _length(arrays: Mapping[str, Array]) -> int:
    """T: of the array called ``time``, or else of ``q``, of one that others call the time, of the longest."""
    for names in (("time",), ("q",), TIMES):
        if lengths := [max(a.shape) for name, a in arrays.items() if _own(name).lower() in names]:
            return int(max(lengths))
    return int(max((max(a.shape) for a in arrays.values()), default=0))


def _own(name: str) -> str:
    """The last part of ``struct.field``."""
    return name.rsplit(".", 1)[-1]


def _within(name: str) -> str:
    """The struct that ``struct.field`` is in."""
    return name.rpartition(".")[0]


def _arrays(content: Mapping[str, Any], within: str) -> Iterator[tuple[str, Array]]:
    """Arrays of real numbers, vectors as columns, with the names of the structs they are in."""
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from _arrays(value, f"{within}{name}.")
            continue
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.ndim in (1, 2) and value.size:
            yield f"{within}{name}", np.asarray(value.reshape(-1, 1) if value.ndim == 1 else value, float)
