"""``python -m hybrid_dynamics``: the command line where the environment's programs are not on the path."""

from hybrid_dynamics.cli import main

if __name__ == "__main__":
    main()
