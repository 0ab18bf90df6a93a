"""Compose ``conf/`` into ``params.yaml``, exactly as ``dvc exp run`` does (arguments are Hydra overrides)."""

import sys
from pathlib import Path

from dvc.utils.hydra import compose_and_dump
from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

from hybrid_dynamics.errors import ConfigError, run_main
from hybrid_dynamics.files import atomic_path

ROOT = Path(__file__).resolve().parents[1]


def compose(output: Path, overrides: list[str]) -> None:
    """Write the composition of ``conf/`` with ``overrides`` to ``output``."""
    try:
        with atomic_path(output) as temporary:
            compose_and_dump(temporary, str(ROOT / "conf"), None, "config", str(ROOT), overrides)
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(f"conf/: cannot be composed: {error}") from None


def main() -> None:
    compose(ROOT / "params.yaml", sys.argv[1:])
    print("params.yaml composed from conf/")


if __name__ == "__main__":
    run_main(main)
