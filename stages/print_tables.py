"""Print the tables that the stage report wrote, and where the report is."""

from hybrid_dynamics.errors import InputError, run_main
from hybrid_dynamics.study.layout import REPORTS


def main() -> None:
    tables = REPORTS / "tables.txt"
    if not tables.is_file():
        raise InputError(f"{tables}: no such file; run make repro")
    print(tables.read_text(encoding="utf-8"))
    print(f"report: {(REPORTS / 'index.html').resolve()}")


if __name__ == "__main__":
    run_main(main)
