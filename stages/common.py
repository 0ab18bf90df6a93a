"""What every stage needs from its command line."""

import argparse

from hybrid_dynamics.errors import ConfigError
from hybrid_dynamics.layout import DatasetFiles


def dataset_argument(description: str | None) -> DatasetFiles:
    """Parse ``stage.py DATASET``."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("dataset", help="name of the dataset, a key of 'dataset' in params.yaml")
    return dataset_files(parser.parse_args().dataset)


def dataset_files(name: str) -> DatasetFiles:
    """Files of dataset ``name``; the name becomes a folder, so it must be a plain word."""
    if not name.replace("_", "").replace("-", "").isalnum():
        raise ConfigError(f"dataset {name!r}: expected letters, digits, '-' and '_'")
    return DatasetFiles(name)
