"""The inner kernels never make a GPU wait for the host: they read no value back and run on the meta device.

The watch sees operations; reading a tensor as a list is none, but fails on the meta device.
"""

import pytest
import torch
from host_transfers import HostTransfers
from problems import room_pair, uniform

import torchreg as tr
from torchreg.descriptors.histograms import count_votes, inverse_square_weights, weighted_sum
from torchreg.descriptors.pair_features import Oriented, angle_bins, compact_pair_features, pair_features, unit_bins
from torchreg.descriptors.pcfh import difference_bins
from torchreg.geometry.eigen import symmetric_eigen
from torchreg.geometry.numerics.sums import lane_sums
from torchreg.solvers.ransac.edges import edge_marks
from torchreg.solvers.ransac.samples import sample_fits, solve_samples, spans_plane
from torchreg.solvers.scoring import correspondence_vectors, hypothesis_vectors, propose_counts, residuals

ROWS, SLOTS, HYPOTHESES, MATCHES, SAMPLE = 5, 4, 6, 9, 3


def indices(size, *shape):
    return torch.randint(size, shape, generator=torch.Generator().manual_seed(sum(shape)))


def oriented(*shape):
    return [uniform(*shape) for _ in range(6)]


KERNELS = {
    "pair_features": (
        lambda *columns: pair_features(Oriented(*columns[:6]), Oriented(*columns[6:])),
        [*oriented(ROWS, 1), *oriented(ROWS, SLOTS)],
    ),
    "compact_pair_features": (
        lambda *columns: compact_pair_features(Oriented(*columns[:6]), Oriented(*columns[6:])),
        [*oriented(ROWS, 1), *oriented(ROWS, SLOTS)],
    ),
    "angle_bins": (angle_bins, [uniform(ROWS, SLOTS), uniform(ROWS, SLOTS)]),
    "unit_bins": (unit_bins, [uniform(ROWS, SLOTS)]),
    "difference_bins": (
        lambda a, b: (difference_bins(a, b, 11, circular=True), difference_bins(a, b, 11, circular=False)),
        [uniform(ROWS, 1), uniform(ROWS, SLOTS)],
    ),
    "count_votes": (
        lambda bins, votes: count_votes(bins, votes, 11),
        [indices(11, ROWS, SLOTS), indices(2, ROWS, SLOTS).int()],
    ),
    "inverse_square_weights": (inverse_square_weights, [uniform(ROWS, SLOTS), indices(2, ROWS, SLOTS).bool()]),
    "weighted_sum": (weighted_sum, [uniform(ROWS, 11), indices(ROWS, ROWS, SLOTS), uniform(ROWS, SLOTS)]),
    "weighted_sum in float64": (
        weighted_sum,
        [uniform(ROWS, 11).double(), indices(ROWS, ROWS, SLOTS), uniform(ROWS, SLOTS).double()],
    ),
    "symmetric_eigen": (symmetric_eigen, [uniform(ROWS, 3, 3)]),
    "lane_sums": (lambda values: lane_sums(values, dim=0), [uniform(3000, 2)]),
    "edge_marks": (lambda p, q: edge_marks(p, q, 0.9, 0.1), [uniform(3, HYPOTHESES), uniform(3, HYPOTHESES)]),
    "spans_plane": (spans_plane, [uniform(3, SAMPLE, HYPOTHESES)]),
    "solve_samples": (solve_samples, [uniform(3, SAMPLE, HYPOTHESES), uniform(3, SAMPLE, HYPOTHESES)]),
    "sample_fits": (
        lambda p, q, R, t: sample_fits(p, q, R, t, 0.2),
        [
            uniform(3, SAMPLE, HYPOTHESES),
            uniform(3, SAMPLE, HYPOTHESES),
            uniform(3, 3, HYPOTHESES),
            uniform(3, HYPOTHESES),
        ],
    ),
    "correspondence_vectors": (correspondence_vectors, [uniform(3, MATCHES), uniform(3, MATCHES)]),
    "hypothesis_vectors": (hypothesis_vectors, [uniform(3, 3, HYPOTHESES), uniform(3, HYPOTHESES)]),
    "propose_counts": (
        lambda R, t, vectors: propose_counts(R, t, vectors, 0.2),
        [uniform(3, 3, HYPOTHESES), uniform(3, HYPOTHESES), uniform(16, MATCHES)],
    ),
    "residuals": (
        residuals,
        [uniform(3, 3, HYPOTHESES), uniform(3, HYPOTHESES), uniform(3, MATCHES), uniform(3, MATCHES)],
    ),
}


def tensors(result):
    return [result] if isinstance(result, torch.Tensor) else list(result)


@pytest.mark.parametrize("name", KERNELS)
def test_a_kernel_reads_no_value_back(name):
    kernel, inputs = KERNELS[name]
    with HostTransfers() as watch:
        kernel(*inputs)
    assert watch.operations
    assert watch.transfers == []


@pytest.mark.parametrize("name", KERNELS)
def test_a_kernel_runs_on_the_meta_device(name):
    kernel, inputs = KERNELS[name]
    found = tensors(kernel(*(value.to("meta") for value in inputs)))
    for shadow, real in zip(found, tensors(kernel(*inputs)), strict=True):
        assert shadow.device.type == "meta"
        assert shadow.shape == real.shape
        assert shadow.dtype == real.dtype


@pytest.mark.parametrize("name", KERNELS)
def test_a_kernel_leaves_its_inputs_alone(name):
    kernel, inputs = KERNELS[name]
    before = [value.clone() for value in inputs]
    kernel(*inputs)
    assert all(torch.equal(one, other) for one, other in zip(before, inputs, strict=True))


@pytest.mark.parametrize(
    "wait",
    [
        lambda x: x.sum().item(),
        lambda x: bool((x > 0.5).any()),
        lambda x: (x > 0.5).nonzero(),
        lambda x: x[x > 0.5],
        lambda x: x.to("meta"),
        lambda x: torch.empty(5, device="meta").copy_(x),
        lambda x: x.unique(),
    ],
)
def test_the_watch_sees_what_waits(wait):
    with HostTransfers() as watch:
        wait(uniform(5))
    assert watch.transfers


def test_descriptors_read_no_value_back_whatever_the_number_of_points():
    counts = []
    for count in (200, 3000):
        scan = room_pair(count).source
        near = tr.neighbors(scan, 0.8, 50)
        scan = tr.estimate_normals(scan, near)
        with HostTransfers() as watch:
            tr.fpfh(scan, near)
            tr.contrast(scan, near, 0.8)
        counts.append(len(watch.transfers))
    # offsets live on the host; nothing is read once per chunk
    assert counts[0] == counts[1]
