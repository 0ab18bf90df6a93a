"""Stages of `dvc.yaml`: thin adapters between files and the library, imported by each other and the tests alone."""
