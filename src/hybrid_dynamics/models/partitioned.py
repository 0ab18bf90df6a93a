"""Features that do not fit into memory: the row groups of Parquet files, read by whoever works on them."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.features import feature_names
from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class RowGroup:
    """One row group of a features file: what ``factorize_chunks`` sums over. Of ``joints`` joints; SI units."""

    path: str
    group: int
    joints: int

    def read(self) -> tuple[Array, Array]:
        """Features (m, 7n) and torque (m, n) [N m]; raises :class:`InputError` for a value that is not finite."""
        names = feature_names(self.joints)
        torque = [f"tau{j + 1}" for j in range(self.joints)]
        with pq.ParquetFile(self.path) as file:
            table = file.read_row_group(self.group, columns=[*names, *torque])
        X, y = (np.column_stack([table[c].to_numpy() for c in columns]) for columns in (names, torque))
        if not (np.isfinite(X.sum()) and np.isfinite(y.sum())):
            raise InputError(
                f"{self.path}: row group {self.group + 1} holds NaN or infinity; remove or repair the rows"
            )
        return X, y


def row_groups(paths: Iterable[str | os.PathLike[str]], split: str | None = "train") -> list[RowGroup]:
    """The row groups of features files, in the order given; of those with a column ``split`` only ``split``'s.

    They are the chunks that the moments are summed over: written once, they fix the last digits of the result, and the
    largest one the memory of a worker (about 500 bytes a row and joint). Raises :class:`InputError` naming the file.
    """
    out: list[RowGroup] = []
    joints: int | None = None
    for path in (os.fspath(p) for p in paths):
        try:
            with pq.ParquetFile(path) as file:
                names = set(file.schema_arrow.names)
                n = sum(f"tau{j}" in names for j in range(1, len(names) + 1))
                missing = [c for c in feature_names(n) if c not in names] if n else ["tau1"]
                if missing:
                    raise InputError(f"{path}: has no column {missing[0]}; expected a features file")
                if joints not in (None, n):
                    raise InputError(f"{path}: has {n} joints, the files before it {joints}; expected one robot")
                joints = n
                for group in range(file.num_row_groups):
                    if split is None or "split" not in names or _is_split(file, group, split, path):
                        out.append(RowGroup(path, group, n))
        except (OSError, pa.ArrowInvalid) as error:
            raise InputError(f"{path}: not a readable Parquet file ({error})") from None
    if not out:
        raise InputError(f"no row group with split {split!r} in the files given; expected at least one")
    return out


def _is_split(file: pq.ParquetFile, group: int, split: str, path: str) -> bool:
    found = file.read_row_group(group, columns=["split"])["split"].unique().to_pylist()
    if len(found) > 1:
        raise InputError(f"{path}: row group {group + 1} mixes the splits {sorted(found)}; expected one a row group")
    return bool(found == [split])
