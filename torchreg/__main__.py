"""``python -m torchreg`` is the command ``torchreg``."""

from torchreg.cli import main

main()
