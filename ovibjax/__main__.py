"""`python -m ovibjax`: the same program as the console script."""

from ovibjax.cli.main import main

if __name__ == "__main__":
    main()
