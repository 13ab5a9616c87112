"""``python -m phytac_design`` is the command ``phytac``."""

from phytac_design.cli.app import main

if __name__ == "__main__":
    main()
