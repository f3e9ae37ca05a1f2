"""A dataset over a table: an item is what reading its files gives, and batches are their items."""

import multiprocessing
import pickle
import subprocess
import sys

import pytest
import torch
from determinism import same_bits
from folders import cloud, motion, table_folder
from refusals import refuses
from torch.utils.data import DataLoader

import torchreg as tr
from torchreg.datasets import ScanPairs, pack_pairs


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    return table_folder(tmp_path_factory.mktemp("table"))


@pytest.fixture(scope="module")
def batches(table):
    """What every loader over the table must give, two pairs a batch."""
    items = list(ScanPairs(table, voxel_size=0.3))
    return pack_pairs(items[:2]), pack_pairs(items[2:])


def test_an_item_is_what_its_files_hold(table):
    dataset = ScanPairs(table)
    assert len(dataset) == 3
    for k, pair in enumerate(dataset):
        assert pair.name == f"{k}__{k + 1}"
        assert same_bits(pair.source, tr.read_cloud(table.parent / f"{k}.npz"))
        assert same_bits(pair.target, tr.read_cloud(table.parent / f"{k + 1}.npz"))
        assert pair.has_truth == (k < 2)
        assert not pair.has_truth or same_bits(pair.T_target_source, motion(k))
        assert pair.information is None
    assert same_bits(dataset[-1], dataset[2])
    with pytest.raises(IndexError):
        dataset[3]


def test_options_are_those_of_reading(table):
    pair = ScanPairs(table, voxel_size=0.4, viewpoint=None, dtype=torch.float64, colors=False)[1]
    read = tr.read_cloud(table.parent / "1.npz", viewpoint=None, dtype=torch.float64)
    expected = tr.voxel_downsample(read, 0.4)
    assert pair.source.colors is None
    assert pair.source.viewpoint is None
    assert torch.equal(pair.source.points, expected.points)
    assert pair.source.points.dtype == torch.float64
    assert 0 < sum(pair.source.lengths) < sum(read.lengths)


def test_root(table, tmp_path):
    elsewhere = tmp_path / "pairs.csv"
    elsewhere.write_bytes(table.read_bytes())
    assert same_bits(ScanPairs(elsewhere, root=table.parent)[0], ScanPairs(table)[0])


def test_clouds_are_the_distinct_ones(table):
    clouds = ScanPairs(table).clouds()
    assert [path.name for path in clouds.paths] == ["0.npz", "1.npz", "2.npz", "3.npz"]
    (batch,) = DataLoader(clouds, batch_size=4, collate_fn=tr.Clouds.pack)
    assert batch.lengths == [200, 201, 202, 203]
    assert same_bits(tuple(batch.unpack()), tuple(clouds))


def test_changing_an_item_leaves_the_dataset_alone(table):
    dataset = ScanPairs(table)
    dataset[0].T_target_source.zero_()
    assert same_bits(dataset[0].T_target_source, motion(0))


def test_dataset_goes_through_pickle(table):
    dataset = ScanPairs(table, voxel_size=0.3)
    assert same_bits(tuple(pickle.loads(pickle.dumps(dataset))), tuple(dataset))


def test_reading_needs_no_open3d(table):
    code = "import sys; sys.modules['open3d'] = None; from torchreg.datasets import *; "
    code += "print(pack_pairs(list(ScanPairs(sys.argv[1], voxel_size=0.3))).names)"
    run = subprocess.run([sys.executable, "-c", code, str(table)], capture_output=True, text=True, check=False)
    assert run.stdout.strip() == "('0__1', '1__2', '2__3')", run.stderr


@pytest.mark.parametrize("context", [None, *multiprocessing.get_all_start_methods()])
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded, use of fork:DeprecationWarning")
def test_workers_change_no_bit(table, batches, context):
    workers = 0 if context is None else 2
    dataset = ScanPairs(table, voxel_size=0.3)
    loader = DataLoader(
        dataset, batch_size=2, collate_fn=pack_pairs, num_workers=workers, multiprocessing_context=context
    )
    assert same_bits(tuple(loader), batches)


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded, use of fork:DeprecationWarning")
def test_workers_refuse_a_gpu(table):
    dataset = ScanPairs(table, device="cuda:0")
    first = multiprocessing.get_all_start_methods()[0]
    loader = DataLoader(dataset, collate_fn=pack_pairs, num_workers=1, multiprocessing_context=first)
    with pytest.raises(ValueError, match=r"(?s)device: expected the CPU in workers .*batch.to\('cuda:0'\)"):
        next(iter(loader))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded, use of fork:DeprecationWarning")
def test_gpu(table, batches):
    loader = DataLoader(
        ScanPairs(table, voxel_size=0.3), batch_size=2, collate_fn=pack_pairs, num_workers=1, pin_memory=True
    )
    for batch, expected in zip(loader, batches, strict=True):
        assert batch.source.points.is_pinned()
        assert batch.T_target_source.is_pinned()
        moved = batch.to("cuda")
        assert moved.source.device.type == moved.T_target_source.device.type == "cuda"
        assert same_bits(moved.to("cpu"), expected)
    item = ScanPairs(table, device="cuda")[0]
    assert item.source.device.type == item.target.device.type == item.T_target_source.device.type == "cuda"


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
@pytest.mark.filterwarnings("ignore:'pin_memory' argument is set as true but no accelerator:UserWarning")
def test_pinned_memory_without_a_gpu_is_ordinary_memory(table, batches):
    loader = DataLoader(ScanPairs(table, voxel_size=0.3), batch_size=2, collate_fn=pack_pairs, pin_memory=True)
    assert same_bits(tuple(loader), batches)


def test_mixed_colors(tmp_path):
    table = table_folder(tmp_path, colored=(0, 2))
    mixed = DataLoader(ScanPairs(table), batch_size=3, collate_fn=pack_pairs)
    with refuses("source", "colors for all clouds of a batch", "them for 0__1 and none for 1__2", "colors=False"):
        next(iter(mixed))
    (plain,) = DataLoader(ScanPairs(table, colors=False), batch_size=3, collate_fn=pack_pairs)
    assert plain.source.colors is None
    with refuses(str(tmp_path / "1.npz"), "a cloud with colors, as colors=True asks for"):
        ScanPairs(table, colors=True)[0]
    assert ScanPairs(table)[0].target.colors is None
    with refuses("colors"):
        next(iter(DataLoader(ScanPairs(table).clouds(), batch_size=4, collate_fn=tr.Clouds.pack)))


def test_mixed_normals(tmp_path):
    table = table_folder(tmp_path)
    tr.write_cloud(tmp_path / "1.npz", cloud(1, normals=True))
    with refuses("source", "normals for all clouds", "them for 1__2 and none for 0__1", "normals=False"):
        pack_pairs(list(ScanPairs(table)))
    assert pack_pairs(list(ScanPairs(table, normals=False))).target.normals is None
    with refuses(str(tmp_path / "0.npz"), "a cloud with normals"):
        ScanPairs(table, normals=True)[0]


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"voxel_size": 0.0}, "voxel_size"),
        ({"voxel_size": "fine"}, "voxel_size"),
        ({"viewpoint": "here"}, "viewpoint"),
        ({"dtype": torch.float16}, "dtype"),
        ({"colors": "yes"}, "colors"),
        ({"normals": 1}, "normals"),
        ({"device": "gpu"}, "device"),
        ({"device": 1.5}, "device"),
        ({"root": "no such folder"}, "root"),
    ],
)
def test_bad_options(table, options, name):
    with refuses(name):
        ScanPairs(table, **options)


def test_a_cloud_that_is_not_there(tmp_path):
    table = table_folder(tmp_path)
    (tmp_path / "2.npz").unlink()
    with refuses(f"{table}, line 3", "a target cloud that is there", str(tmp_path / "2.npz")):
        ScanPairs(table)


def test_a_cloud_that_cannot_be_read_is_named(tmp_path):
    dataset = ScanPairs(table_folder(tmp_path))
    (tmp_path / "1.npz").write_bytes(b"nothing of the kind")
    with refuses(str(tmp_path / "1.npz")):
        dataset[0]
