"""The study of methods on sites."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.study import Cell, Study
from torchreg.benchmark.site.document import csv_text, document, narrow_tables
from torchreg.benchmark.site.judge import judged_site
from torchreg.benchmark.site.method import SiteMethod, SiteTask
from torchreg.benchmark.site.registry import chosen_site_methods
from torchreg.benchmark.site.sources import read_sites, simulated_sites
from torchreg.benchmark.site.true_site import Readings, TrueSite
from torchreg.errors import expect, expect_in_words

_QUICK_SCANS, _QUICK_FLOORS, _QUICK_STEP = 5, 1, 2.0  # the step is degrees between rays


@dataclass(frozen=True, kw_only=True)
class SiteBenchOptions:
    """Which methods are compared on which sites, and how they run."""

    methods: Sequence[str] | None = None  # their names; ``None`` takes all
    seeds: int = 3  # buildings of every number of scans; 0 leaves them out
    scans: Sequence[int] = (15, 30, 60)  # of the buildings
    data: Sequence[Path] = ()  # real sites, as ``read_sites`` takes them
    sites: Sequence[str] | None = None  # names of sites to take; ``None`` takes all
    quick: bool = False  # one small floor, scanned coarsely, and the smallest real site; no slow methods
    seed: int = 0  # of every random draw of the methods


def site_study(options: SiteBenchOptions) -> Study:
    """The study of methods on simulated buildings and real sites.

    Raises:
        CloudFileError: data that hold no sites.
        ValueError: a name that no method or no site has, two sites of one name, or none at all.
    """
    methods, sites = chosen_site_methods(options.methods, quick=options.quick), _sites(options)
    measure = _measurement(sites, options.seed)
    return Study(
        name="site",
        cells=[
            Cell(f"{site.name}/{method.name}", f"{site.name}, {method.title}", partial(measure, number, method))
            for number, site in enumerate(sites)
            for method in methods
        ],
        settings={"seed": options.seed, "quick": options.quick},
        run={"methods": [method.name for method in methods], "sites": [site.name for site in sites]},
        document=lambda rows, _, machine: document(rows, methods, machine),
        csv=lambda rows: {"site.csv": csv_text(rows)},
        shown=lambda rows: narrow_tables(rows, methods),
    )


def _sites(options: SiteBenchOptions) -> list[TrueSite]:
    real = [site for path in options.data for site in read_sites(path)]
    if options.quick:
        made = simulated_sites(
            range(min(options.seeds, 1)), [_QUICK_SCANS], floors=_QUICK_FLOORS, angular_step=_QUICK_STEP
        )
        real = sorted(real, key=lambda site: site.scans)[:1]
    else:
        made = simulated_sites(range(options.seeds), options.scans)
    names = [site.name for site in (*made, *real)]
    twice = next((name for name in names if names.count(name) > 1), None)
    expect_in_words(twice is None, "data", "sites of different names", f"{twice} twice")
    wanted = names if options.sites is None else options.sites
    expect(len(wanted) > 0, "sites", "at least one", wanted)
    for name in wanted:
        expect(name in names, "sites", "names out of " + ", ".join(names), name)
    return [site for site in (*made, *real) if site.name in wanted]


def _measurement(sites: Sequence[TrueSite], seed: int) -> Callable[[int, SiteMethod], Row]:
    """Measures a method on the site of a number; the scans of one site are kept until the next."""

    @lru_cache(maxsize=1)
    def read(number: int) -> Readings:
        return sites[number].read()

    def measure(number: int, method: SiteMethod) -> Row:
        site, truth = sites[number], read(number)
        task = SiteTask(scans=truth.scans, voxel=site.voxel, seed=seed)
        return {
            "site": site.name,
            "family": site.family,
            "scans": site.scans,
            "voxel_m": site.voxel,
            "points": sum(len(scan.points) for scan in truth.scans),
            "method": method.name,
            **judged_site(method, task, truth),
        }

    return measure
