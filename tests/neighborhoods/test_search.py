"""Every backend finds what comparing all pairs finds, and nothing of the batch, order or threads shows."""

import pytest
import torch
from determinism import THREADS, same_bits, threads
from hypothesis import given, settings
from hypothesis import strategies as st
from neighborhoods.oracle import all_pairs
from refusals import refuses

from torchreg.native import native_kernels, native_library
from torchreg.neighborhoods import neighbors
from torchreg.types import Clouds, Neighborhoods
from torchreg.types.packing import offsets_of

BACKENDS = ("open3d", "torch", *(["native"] if native_library() else []))
DTYPES = (torch.float32, torch.float64)

every_backend = pytest.mark.parametrize("backend", BACKENDS)
both_dtypes = pytest.mark.parametrize("dtype", DTYPES, ids=str)


def random_cloud(*lengths, seed=0, dtype=torch.float32):
    generator = torch.Generator().manual_seed(seed)
    return Clouds(points=torch.rand(sum(lengths), 3, generator=generator, dtype=dtype), offsets=offsets_of(lengths))


def lattice_cloud(*lengths, seed=0, dtype=torch.float32):
    """Points on a small lattice: duplicates and equal distances everywhere, all of them exact."""
    generator = torch.Generator().manual_seed(seed)
    points = torch.randint(0, 4, (sum(lengths), 3), generator=generator).to(dtype)
    return Clouds(points=points, offsets=offsets_of(lengths))


def expected(cloud, radius, max_neighbors):
    squares = torch.as_tensor(radius, dtype=torch.float64).expand(len(cloud)) ** 2
    return Neighborhoods(
        *all_pairs(cloud.points, cloud.offsets, squares.to(cloud.points.dtype), max_neighbors), radius=radius
    )


@every_backend
@both_dtypes
@settings(max_examples=25)
@given(
    lengths=st.lists(st.integers(0, 60), min_size=1, max_size=4),
    radius=st.floats(0.01, 3.0),
    max_neighbors=st.integers(1, 70),
    seed=st.integers(0, 2**31),
)
def test_it_finds_what_all_pairs_find(backend, dtype, lengths, radius, max_neighbors, seed):
    cloud = random_cloud(*lengths, seed=seed, dtype=dtype)
    found = neighbors(cloud, radius, max_neighbors, backend=backend)
    assert found.sq_distance.dtype == dtype
    assert same_bits(found, expected(cloud, radius, max_neighbors))


@every_backend
@settings(max_examples=25)
@given(
    lengths=st.lists(st.integers(0, 60), min_size=1, max_size=3),
    radius=st.sampled_from([1.0, 1.5, 2.0, 3.0]),
    max_neighbors=st.integers(1, 70),
    seed=st.integers(0, 2**31),
)
def test_ties_are_ordered_by_index(backend, lengths, radius, max_neighbors, seed):
    cloud = lattice_cloud(*lengths, seed=seed)
    found, truth = neighbors(cloud, radius, max_neighbors, backend=backend), expected(cloud, radius, max_neighbors)
    assert same_bits(found.valid, truth.valid)
    assert same_bits(found.sq_distance, truth.sq_distance)
    # The tree may choose among those that tie for the last place, so these may differ.
    last = truth.sq_distance[:, -1:]
    chosen_by_tree = truth.valid[:, -1:] & (truth.sq_distance == last) & (backend == "open3d")
    assert torch.equal(found.index[~chosen_by_tree], truth.index[~chosen_by_tree])
    difference = cloud.points[found.index] - cloud.points[:, None]
    assert torch.equal((difference**2).sum(dim=2)[found.valid], found.sq_distance[found.valid])
    for row, valid in zip(found.index.tolist(), found.valid.tolist(), strict=True):
        kept = [index for index, is_valid in zip(row, valid, strict=True) if is_valid]
        assert len(set(kept)) == len(kept)


@every_backend
def test_a_neighbor_at_the_radius_is_out(backend):
    cloud = Clouds(points=torch.tensor([[0.0, 0, 0], [3, 4, 0], [0, 0, 5], [1, 0, 0]]))
    near = neighbors(cloud, 5.0, 4, backend=backend)
    assert near.index[0].tolist() == [0, 3, 0, 0]
    assert near.valid[0].tolist() == [True, True, False, False]
    assert neighbors(cloud, 5.0001, 4, backend=backend).index[0].tolist() == [0, 3, 1, 2]


@every_backend
def test_duplicates_are_neighbors_at_distance_zero(backend):
    points = torch.tensor([[1.0, 2, 3]] * 5 + [[1.5, 2, 3]])
    near = neighbors(Clouds(points=points), 1.0, 6, backend=backend)
    assert near.index[:5].tolist() == [[0, 1, 2, 3, 4, 5]] * 5
    assert near.index[5].tolist() == [5, 0, 1, 2, 3, 4]
    assert near.sq_distance[:5].tolist() == [[0, 0, 0, 0, 0, 0.25]] * 5


@every_backend
def test_empty_slots_hold_the_point_itself(backend):
    cloud = random_cloud(3, 0, 50, 1)
    near = neighbors(cloud, 0.3, 40, backend=backend)
    empty = ~near.valid
    assert near.index.shape == (54, 40)
    assert empty.any(dim=1).all()
    assert torch.equal(near.index[empty], torch.arange(54)[:, None].expand(54, 40)[empty])
    assert not near.sq_distance[empty].any()
    assert near.valid[:, 0].all()
    assert not (near.valid[:, 1:] & empty[:, :-1]).any()


@every_backend
@pytest.mark.parametrize("lengths", [(0,), (0, 0)])
def test_no_points_have_no_neighbors(backend, lengths):
    near = neighbors(random_cloud(*lengths), 1.0, 7, backend=backend)
    assert near.index.shape == near.valid.shape == near.sq_distance.shape == (0, 7)


@every_backend
def test_a_batch_equals_the_loop_over_its_clouds(backend):
    cloud = Clouds.pack([random_cloud(300, 0, 40, 1), lattice_cloud(200, 150)])
    radii = torch.tensor([0.2, 1.0, 0.5, 0.1, 1.5, 2.5])
    near = neighbors(cloud, radii, 30, backend=backend)
    begin = 0
    for single, radius in zip(cloud.unpack(), radii.tolist(), strict=True):
        alone, rows = neighbors(single, radius, 30, backend=backend), slice(begin, begin + len(single.points))
        assert same_bits(alone.index + begin, near.index[rows])
        assert same_bits(alone.valid, near.valid[rows])
        assert same_bits(alone.sq_distance, near.sq_distance[rows])
        begin = rows.stop


@every_backend
@both_dtypes
def test_the_order_of_points_does_not_matter(backend, dtype):
    cloud = random_cloud(400, dtype=dtype)
    order = torch.randperm(400, generator=torch.Generator().manual_seed(1))
    shuffled = Clouds(points=cloud.points[order])
    near = neighbors(cloud, 0.3, 20, backend=backend)
    moved = neighbors(shuffled, 0.3, 20, backend=backend)
    assert torch.equal(order[moved.index], near.index[order])
    assert same_bits(moved.valid, near.valid[order])
    assert same_bits(moved.sq_distance, near.sq_distance[order])


@every_backend
def test_restrict_finds_what_a_narrower_search_finds(backend):
    cloud = random_cloud(300, 200)
    wide = neighbors(cloud, 0.4, 200, backend=backend)
    assert (wide.counts() < 200).all()
    narrow, searched = wide.restrict(0.25, 12), neighbors(cloud, 0.25, 12, backend=backend)
    assert torch.equal(narrow.valid, searched.valid)
    assert torch.equal(narrow.index[narrow.valid], searched.index[searched.valid])
    assert torch.equal(narrow.sq_distance[narrow.valid], searched.sq_distance[searched.valid])


@every_backend
def test_the_number_of_threads_does_not_show(backend):
    cloud = Clouds.pack([random_cloud(3000, 500), lattice_cloud(500)])
    once = neighbors(cloud, 0.5, 40, backend=backend)
    for number in THREADS:
        with threads(number):
            assert same_bits(neighbors(cloud, 0.5, 40, backend=backend), once), f"{number} threads"


@every_backend
def test_it_leaves_the_cloud_alone_and_carries_no_gradient(backend):
    points = random_cloud(100).points.requires_grad_()
    before = points.detach().clone()
    near = neighbors(Clouds(points=points), 0.3, 10, backend=backend)
    assert not near.sq_distance.requires_grad
    assert torch.equal(points, before)


def test_auto_takes_the_compiled_kernels_or_else_open3d():
    cloud = lattice_cloud(200)  # where Open3D's may differ
    found = neighbors(cloud, 2.0, 10)
    assert same_bits(found, neighbors(cloud, 2.0, 10, backend="torch" if native_library() else "open3d"))
    with native_kernels(False):
        assert same_bits(neighbors(cloud, 2.0, 10), neighbors(cloud, 2.0, 10, backend="open3d"))
        with refuses("backend", "'auto'", "compiled kernels"):
            neighbors(cloud, 2.0, 10, backend="native")


@pytest.mark.skipif(not native_library(), reason="no compiled kernels")
@both_dtypes
@pytest.mark.parametrize(("radius", "max_neighbors"), [(0.05, 30), (0.3, 5), (2.0, 1), (2.0, 40), (1e3, 3000)])
def test_compiled_kernels_find_what_torch_finds_in_large_and_uneven_clouds(dtype, radius, max_neighbors):
    even = random_cloud(2500, dtype=dtype).points
    dense = 0.5 + 1e-3 * random_cloud(1500, seed=1, dtype=dtype).points  # a thousandfold as dense
    line = torch.linspace(0, 1, 700, dtype=dtype)[:, None] * torch.tensor([1.0, 0.0, 0.0], dtype=dtype)
    points = torch.cat([even, dense, line, lattice_cloud(800, dtype=dtype).points, line[:50]])
    cloud = Clouds(points=points, offsets=offsets_of([2500, 0, 2200, 850]))
    found, truth = (neighbors(cloud, radius, max_neighbors, backend=name) for name in ("native", "torch"))
    assert same_bits(found, truth)


@every_backend
@pytest.mark.parametrize("radius", [1e-30, 1.0, 1e15])
def test_copies_of_one_point_are_neighbors_at_any_radius(backend, radius):
    near = neighbors(Clouds(points=torch.ones(100, 3)), radius, 3, backend=backend)
    assert near.counts().tolist() == [3] * 100
    assert not near.sq_distance.any()


@every_backend
def test_a_radius_whose_square_underflows_holds_the_point_itself(backend):
    near = neighbors(random_cloud(20), 1e-30, 3, backend=backend)
    assert near.counts().tolist() == [1] * 20


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -1e30])
@every_backend
def test_points_without_a_distance_are_refused_with_their_number(backend, bad):
    points = random_cloud(10).points
    points[2, 0] = points[2, 1] = points[7, 2] = bad
    with refuses("cloud.points", "finite", "2 points"):
        neighbors(Clouds(points=points), 1.0, 3, backend=backend)


@pytest.mark.parametrize(
    ("changes", "name", "parts"),
    [
        ({"radius": 0.0}, "radius", ["above 0", "0.0"]),
        ({"radius": float("nan")}, "radius", ["above 0"]),
        ({"radius": torch.tensor([1.0, -1.0])}, "radius", ["above 0", "-1.0"]),
        ({"radius": torch.tensor([1.0])}, "radius", ["(2,)", "(1,)"]),
        ({"max_neighbors": 0}, "max_neighbors", ["at least 1", "0"]),
        ({"max_neighbors": 2.5}, "max_neighbors", ["integer", "2.5"]),
        ({"backend": "scipy"}, "backend", ["'open3d'", "'torch'", "'scipy'"]),
        ({"cloud": Clouds(points=torch.zeros(2, 3, dtype=torch.float16))}, "cloud.points", ["float32", "float16"]),
    ],
)
def test_what_does_not_fit_is_refused(changes, name, parts):
    arguments = {"cloud": random_cloud(4, 4), "radius": 1.0, "max_neighbors": 3} | changes
    with refuses(name, *parts):
        neighbors(**arguments)
