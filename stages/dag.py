"""Write docs/pipeline.md: the stages as DVC sees them, a matrix over datasets as one box (`make dag`)."""

import subprocess
import sys
from pathlib import Path

from hybrid_dynamics.errors import ConfigError, run_main
from hybrid_dynamics.files import write_text

PAGE = Path("docs/pipeline.md")
HEAD = """# The stages

`dvc dag --mermaid --collapse-foreach-matrix` (`make dag` writes this page). A matrix over datasets is one box.

```mermaid
"""


def main() -> None:
    command = [sys.executable, "-m", "dvc", "dag", "--mermaid", "--collapse-foreach-matrix"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        reason = " ".join(done.stderr.split()) or "no reason given"
        raise ConfigError(f"dvc dag failed ({reason}); mend dvc.yaml")
    write_text(PAGE, HEAD + done.stdout.rstrip() + "\n```\n")
    print(f"{PAGE}: {done.stdout.count('-->')} arrows")


if __name__ == "__main__":
    run_main(main)
