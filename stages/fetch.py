"""Stage fetch_<dataset>: verify and copy recorded files, or say that the simulated twin stands in."""

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.layout import RAW
from hybrid_dynamics.study.sources import DataSource, SourceSettings, fetch
from stages.common import dataset_argument


def main() -> None:
    files = dataset_argument(__doc__)
    params = load_params()
    settings = section(params, f"dataset.{files.dataset}.source", SourceSettings)
    fetch(DataSource(settings, raw_dir=RAW), files.source, mode=section(params, "source", str))


if __name__ == "__main__":
    run_main(main)
