"""Digests: of a file, of a copy while it is made, of a download while it streams."""

from __future__ import annotations

import hashlib
import os
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from hybrid_dynamics.study.sources.settings import SourceFile

CHUNK = 1 << 18


@dataclass(frozen=True)
class Digest:
    """Size [bytes], SHA-256 and git blob id of some content."""

    size: int
    sha256: str
    git_blob: str


def copy_and_digest(path: Path, copy: Path | None = None) -> Digest:
    """Digest the file ``path``; where ``copy`` is given, write exactly the bytes that were digested to it."""
    size = os.stat(path).st_size
    sha256 = hashlib.sha256()
    # Git names content by SHA-1 over a header that holds the size.
    blob = hashlib.sha1(f"blob {size}\0".encode(), usedforsecurity=False)
    count = 0
    with open(path, "rb") as stream, open(copy, "wb") if copy is not None else nullcontext() as sink:
        while chunk := stream.read(CHUNK):
            sha256.update(chunk)
            blob.update(chunk)
            count += len(chunk)
            if sink is not None:
                sink.write(chunk)
    return Digest(count, sha256.hexdigest(), blob.hexdigest())


def mismatch(digest: Digest, file: SourceFile) -> str | None:
    """What differs between ``digest`` and the pin of ``file``, in words; None when all agrees."""
    if file.size is not None and digest.size != file.size:
        return f"size is {digest.size} bytes; expected {file.size}"
    if file.sha256 is not None and digest.sha256 != file.sha256:
        return f"sha256 is {digest.sha256}; expected {file.sha256}"
    if file.git_blob is not None and digest.git_blob != file.git_blob:
        return f"git blob id is {digest.git_blob}; expected {file.git_blob}"
    return None
