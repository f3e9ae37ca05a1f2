"""The command line: ``torchreg register``, ``batch``, ``check``, ``info``, ``convert``, ``demo``, ``bench``.

Exit codes: 0 a successful registration, 1 an unexpected error, 2 bad usage or an unreadable file, 3 a registration
that failed, 130 interrupted.
"""

import sys


def main() -> None:
    """Run the command line of this process and exit."""
    try:
        from torchreg.cli.app import app

        app(prog_name="torchreg")
    except KeyboardInterrupt:
        sys.exit(130)
