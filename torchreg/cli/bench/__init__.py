"""``torchreg bench``: measurements that anyone can repeat, one study per command.

A new study is a file with its command, and its name here.
"""

from __future__ import annotations

import typer

from torchreg.cli.bench import family, features, field, paper, site, speed, threedmatch
from torchreg.cli.guard import GuardedGroup

bench = typer.Typer(
    cls=GuardedGroup,
    no_args_is_help=True,
    help="Measure torchreg and its peers: on real pairs, on 3DMatch, on sites of many scans, the paper's experiments, "
    "speed. Each command writes a folder with NAME.md (all tables and pictures), CSV, and NAME.json.",
)
bench.command()(field.field)
bench.command("3dmatch")(threedmatch.threedmatch)
bench.command()(features.features)
bench.command()(site.site)
bench.command()(paper.paper)
bench.command()(speed.speed)
bench.command()(family.family)
