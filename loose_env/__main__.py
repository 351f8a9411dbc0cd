"""The command ``loose`` as ``python -m loose_env``."""

import sys

from loose_env.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
