"""Stage track: log results to MLflow, a run per dataset and method and per arm of the park; none that is there."""

from pathlib import Path

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.models.methods import METHODS
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.layout import REPORTS
from hybrid_dynamics.study.tracking import collect, park_records, store, upsert


def main() -> None:
    params = load_params()
    methods = {name: params.get(method.section, {}) for name, method in METHODS.items()}
    records = collect(Path("data"), section(params, "datasets", list[str]), methods, REPORTS / "loop.csv")
    records += park_records(Path(), section(params, "park", list[str]), params.get("loop", {}))
    logged = upsert(records, store())
    print(f"mlflow: {len(logged)} of {len(records)} results are new; compare them with `make ui`")


if __name__ == "__main__":
    run_main(main)
