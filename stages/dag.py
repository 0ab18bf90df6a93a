"""Write docs/pipeline.md: the stages as DVC sees them, a matrix over datasets as one box (`make dag`)."""

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from hybrid_dynamics.errors import ConfigError, run_main
from hybrid_dynamics.files import write_text

PAGE, PIPELINE = Path("docs/pipeline.md"), Path("dvc.yaml")
HEAD = """# The stages

Written by `make dag` from `dvc.yaml`; a test compares. What the files hold: [architecture](architecture.md#data-flow).

"""
DIAGRAM = """
`dvc dag --mermaid --collapse-foreach-matrix`. A matrix over datasets is one box.

```mermaid
"""


def table(stages: Mapping[str, Mapping[str, Any]]) -> str:
    """One row a stage of ``dvc.yaml``: what it does, for which datasets, which files it reads and writes."""
    rows = ["| stage | what it does | for each of | reads | writes |", "|---|---|---|---|---|"]
    for name, stage in stages.items():
        each = ", ".join(f"`{_plain(values)}`" for values in (stage.get("matrix") or {}).values())
        # Code and stages are dependencies too (make deps); what a reader looks for are files.
        reads = [path for path in map(_path, stage.get("deps", ())) if path.startswith(("data", "reports"))]
        writes = [_path(out) for out in stage.get("outs", ())]
        cells = (f"`{name}`", str(stage.get("desc", "")), each, _listed(reads), _listed(writes))
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows) + "\n"


def page(stages: Mapping[str, Mapping[str, Any]], diagram: str) -> str:
    """The whole of ``docs/pipeline.md``."""
    return HEAD + table(stages) + DIAGRAM + diagram.rstrip() + "\n```\n"


def diagram() -> str:
    """The picture that DVC draws."""
    command = [sys.executable, "-m", "dvc", "dag", "--mermaid", "--collapse-foreach-matrix"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        reason = " ".join(done.stderr.split()) or "no reason given"
        raise ConfigError(f"dvc dag failed ({reason}); mend dvc.yaml")
    return done.stdout


def pipeline() -> dict[str, dict[str, Any]]:
    """The stages of ``dvc.yaml``, its variables as they stand there."""
    content: Any = OmegaConf.to_container(OmegaConf.load(PIPELINE), resolve=False)
    return dict(content["stages"])


def main() -> None:
    stages, drawn = pipeline(), diagram()
    write_text(PAGE, page(stages, drawn))
    print(f"{PAGE}: {len(stages)} stages, {drawn.count('-->')} arrows")


def _path(entry: Any) -> str:
    """A dependency or output, whatever options it has, with ``<dataset>`` for the matrix's variable."""
    return _plain(next(iter(entry)) if isinstance(entry, Mapping) else entry)


def _plain(value: Any) -> str:
    return str(value).replace("${item.dataset}", "<dataset>").removeprefix("${").removesuffix("}")


def _listed(paths: list[str]) -> str:
    return ", ".join(f"`{path}`" for path in paths)


if __name__ == "__main__":
    run_main(main)
