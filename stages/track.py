"""Stage track: log results to MLflow, one run per dataset and method; what is logged already is left alone."""

from pathlib import Path

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.models import METHODS
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.layout import REPORTS
from hybrid_dynamics.study.tracking import collect, store, upsert

#: The section of params.yaml that shapes a method; those not listed have one of their own name.
SECTIONS = {
    "r_sr": "sr",
    "r_sindy_sr": "sr",
    "r_sindy_sr_published": "sr",
    "r_sindy": "sindy",
    "r_sindy_scaled": "sindy_scaled",
    "r_nn": "nn",
}


def main() -> None:
    params = load_params()
    methods = {m: params.get(SECTIONS.get(m, m), {}) for m in (*METHODS, "least_squares", "loop")}
    records = collect(Path("data"), section(params, "datasets", list[str]), methods, REPORTS / "loop.csv")
    logged = upsert(records, store())
    print(f"mlflow: {len(logged)} of {len(records)} results are new; compare them with `make ui`")


if __name__ == "__main__":
    run_main(main)
