"""The command ``torchreg``, which says what it begins before it loads PyTorch.

Whatever is imported from ``torchreg`` loads PyTorch, and that takes seconds, the first time many. So this module
stands beside the package.
"""

from __future__ import annotations

import sys

_WELCOME = (
    "torchreg: two scans of a simulated mall will be registered in four ways, in about a minute; loading PyTorch\n"
)


def main() -> None:
    """Run the command line of this process and exit."""
    words = sys.argv[1:]
    if words[:1] == ["demo"] and "--help" not in words:
        sys.stderr.write(_WELCOME)
        sys.stderr.flush()
    from torchreg.cli import main as run

    run()
